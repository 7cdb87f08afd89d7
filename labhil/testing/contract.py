"""The contract of every driver, as a pytest suite to subclass.

::

    class TestMyDriver(DriverContract):
        driver = MyDriver
        excursion = {"servo_angle": 0.1}

        @pytest.fixture
        def driver_address(self):
            with my_simulated_device() as address:
                yield address

The device must be free to make the small ``excursion``. No test depends on the speed of the host.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from labhil.driver import Driver
from labhil.errors import CommandRefusedError, ConnectError
from labhil.signals import Batch, FloatArray, Stream


class DriverContract:
    """The suite; subclass it under a name that begins with ``Test``.

    Attributes:
        driver: The class under test.
        excursion: A harmless value away from the safe one for each command that is tested, SI.
        absent_address: An address without a device.
        patience: How long the device may take for anything, s.
        tolerance: Largest distance of a signal from its command, SI.
    """

    driver: ClassVar[type[Driver]]
    excursion: ClassVar[Mapping[str, float]] = {}
    absent_address: ClassVar[str] = "/dev/labhil-there-is-no-such-port"
    patience: ClassVar[float] = 10.0
    tolerance: ClassVar[float] = 0.01

    @pytest.fixture
    def driver_address(self) -> str:
        """Return the address of a device; every subclass has to define it."""
        pytest.fail(f"{type(self).__name__} must define the fixture driver_address")

    @pytest.fixture
    def connected(self, driver_address: str) -> Iterator[Driver]:
        """Yield a connected driver, which is made safe and closed afterwards."""
        with self.driver(driver_address) as driver:
            driver.connect()
            yield driver

    def test_the_declaration_is_complete(self) -> None:
        """Commands have safe values and are signals of the stream; names are unique."""
        spec = self.driver.spec
        names = spec.stream.names()
        assert len(set(names)) == len(names) > 0
        assert spec.stream.rate > 0.0
        assert spec.command_timeout > 0.0
        assert set(spec.safe) <= {signal.name for signal in spec.commands} <= set(names)
        assert set(self.excursion) <= {column for signal in spec.commands for column in signal.columns()}

    def test_an_unconnected_driver_can_be_made_safe_and_closed(self) -> None:
        """The constructor does no I/O, and ``safe`` and ``close`` are always allowed."""
        driver = self.driver(self.absent_address)
        driver.safe()
        driver.close()
        driver.close()

    def test_connecting_tells_who_is_there(self, driver_address: str) -> None:
        """``connect`` returns the identity of the device."""
        with self.driver(driver_address) as driver:
            info = driver.connect()
        assert info.firmware
        assert info.speed > 0.0
        assert all(math.isfinite(value) for value in info.calibration.values())

    def test_samples_are_numbered_and_timed(self, connected: Driver) -> None:
        """Numbers and times increase, the device's clock at the declared rate, and values are finite."""
        batch = self.samples(connected, 40)
        assert batch.values.shape == (len(batch), connected.spec.stream.width)
        assert np.all(np.isfinite(batch.values))
        assert np.all(np.diff(batch.seq) >= 1)
        assert np.all(np.diff(batch.t_hw_ns) > 0)
        assert np.all(np.diff(batch.t_acq_ns) >= 0)
        periods = 1e-9 * np.diff(batch.t_hw_ns) / np.diff(batch.seq)
        assert np.median(periods) * connected.spec.stream.rate == pytest.approx(1.0, rel=0.05)
        assert connected.counters.frames > 0

    def test_a_command_takes_effect(self, connected: Driver) -> None:
        """A command appears in the signal of that name."""
        self.until(connected, lambda latest: self.near(connected, latest, self.excursion), self.excursion)

    def test_safe_is_reached_and_kept(self, connected: Driver) -> None:
        """After ``safe()`` the device takes its safe values and keeps them."""
        self.until(connected, lambda latest: self.near(connected, latest, self.excursion), self.excursion)
        connected.safe()
        self.until(connected, lambda latest: self.is_safe(connected, latest))
        for row in self.samples(connected, 10).values:
            assert self.is_safe(connected, row)

    def test_a_device_left_alone_goes_safe(self, connected: Driver) -> None:
        """The device has a watchdog of its own; reading does not count as a command."""
        self.until(connected, lambda latest: self.near(connected, latest, self.excursion), self.excursion)
        self.until(connected, lambda latest: self.is_safe(connected, latest))

    def test_an_unknown_command_is_refused(self, connected: Driver) -> None:
        """CommandRefusedError names the command; nothing is sent, and the connection stays open."""
        with pytest.raises(CommandRefusedError, match="no_such_command"):
            connected.command({"no_such_command": 0.0})
        assert len(self.samples(connected, 1)) >= 1

    def test_a_value_that_is_no_number_is_refused(self, connected: Driver) -> None:
        """NaN and infinity never reach a device."""
        for name in self.excursion:
            for value in (math.nan, math.inf):
                with pytest.raises(CommandRefusedError):
                    connected.command({name: value})

    def test_closing_twice_and_reading_after_it(self, driver_address: str) -> None:
        """``close`` may be called twice; a closed driver raises ConnectError."""
        driver = self.driver(driver_address)
        driver.connect()
        driver.close()
        driver.close()
        driver.safe()
        with pytest.raises(ConnectError):
            driver.read(0.1)
        with pytest.raises(ConnectError):
            driver.command(self.excursion)

    def test_connecting_again_after_closing(self, driver_address: str) -> None:
        """The same object can be used again, and begins in the safe state."""
        with self.driver(driver_address) as driver:
            for _ in range(2):
                driver.connect()
                self.until(driver, lambda latest: self.is_safe(driver, latest))
                self.until(driver, lambda latest: self.near(driver, latest, self.excursion), self.excursion)
                driver.close()

    def test_nobody_at_the_address(self) -> None:
        """ConnectError names the address."""
        driver = self.driver(self.absent_address)
        with pytest.raises(ConnectError) as caught:
            driver.connect()
        assert self.absent_address in str(caught.value)

    def test_nothing_is_left_behind(self, driver_address: str) -> None:
        """No thread and no file descriptor outlives ``close``."""
        with self.driver(driver_address) as driver:
            driver.connect()
        before = _open_resources()
        with self.driver(driver_address) as driver:
            driver.connect()
            self.samples(driver, 5)
        assert _open_resources() == before

    def samples(self, driver: Driver, count: int) -> Batch:
        """Read at least ``count`` samples; fails where they do not come."""
        batches = [Batch.empty(driver.spec.stream.width)]
        deadline = time.monotonic() + self.patience
        while sum(len(batch) for batch in batches) < count:
            assert time.monotonic() < deadline, f"expected {count} samples within {self.patience:g} s"
            batches.append(driver.read(0.2))
        return Batch(
            np.concatenate([batch.seq for batch in batches]),
            np.concatenate([batch.t_acq_ns for batch in batches]),
            np.concatenate([batch.t_hw_ns for batch in batches]),
            np.concatenate([batch.values for batch in batches]),
        )

    def until(
        self,
        driver: Driver,
        reached: Callable[[FloatArray], bool],
        command: Mapping[str, float] | None = None,
    ) -> None:
        """Read, sending ``command``, until ``reached(latest values)``; fails where that does not happen."""
        deadline = time.monotonic() + self.patience
        latest: FloatArray | None = None
        while latest is None or not reached(latest):
            assert time.monotonic() < deadline, f"not reached within {self.patience:g} s; last: {latest}"
            if command is not None:
                driver.command(command)
            batch = driver.read(0.2)
            if len(batch):
                latest = batch.values[-1]

    def near(self, driver: Driver, values: FloatArray, wanted: Mapping[str, float]) -> bool:
        """Return whether the signals in ``wanted`` are within ``tolerance`` of their values."""
        stream = driver.spec.stream
        return all(
            bool(np.all(np.abs(values[columns] - value) <= self.tolerance))
            for name, value in wanted.items()
            if (columns := _columns(stream, name)) is not None
        )

    def is_safe(self, driver: Driver, values: FloatArray) -> bool:
        """Return whether the device is in its safe state; override it for a device that holds its value."""
        return self.near(driver, values, driver.spec.safe)


def _columns(stream: Stream, name: str) -> slice | None:
    """Return the columns of a signal, or of one column of a vector, in a stream."""
    if name in stream.names():
        return stream.columns_of(name)
    columns = stream.columns()
    return slice(columns.index(name), columns.index(name) + 1) if name in columns else None


def _open_resources() -> tuple[int, int]:
    """Return the number of threads, and of file descriptors where the system reports it."""
    descriptors = Path("/proc/self/fd")
    return threading.active_count(), len(list(descriptors.iterdir())) if descriptors.is_dir() else 0
