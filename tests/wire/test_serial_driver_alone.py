"""A serial device that hears nothing, and bytes that waited: what the driver makes of them."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from labhil_ball_beam.driver import BallBeamDriver

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "measuring"))
from clocked_device import ClockedDevice


@pytest.fixture
def device() -> Iterator[ClockedDevice]:
    device = ClockedDevice()
    yield device
    device.close()


def read_for(driver: BallBeamDriver, seconds: float, command: float | None = None) -> int:
    deadline, seen = time.monotonic() + seconds, 0
    while time.monotonic() < deadline:
        if command is not None:
            driver.command({"servo_angle": command})
        seen += len(driver.read(0.02))
    return seen


def test_a_device_that_made_itself_safe_is_counted_once_each_time(device: ClockedDevice) -> None:
    with BallBeamDriver(device.address) as driver:
        driver.connect()
        read_for(driver, 0.4)
        assert driver.counters.unheard == 0  # nobody has commanded it
        for times in (1, 2):
            read_for(driver, 0.4, command=0.1)
            assert driver.counters.unheard == times - 1
            read_for(driver, 0.7)  # it hears nothing
            assert driver.counters.unheard == times


def test_a_device_that_is_told_to_be_safe_has_heard(device: ClockedDevice) -> None:
    with BallBeamDriver(device.address) as driver:
        driver.connect()
        for _ in range(3):
            read_for(driver, 0.3, command=0.1)
            driver.safe()
            read_for(driver, 0.1)
        assert driver.counters.unheard == 0


def test_samples_that_waited_together_bear_the_times_at_which_they_came(device: ClockedDevice) -> None:
    with BallBeamDriver(device.address) as driver:
        driver.connect()
        driver.read(0.1)
        time.sleep(0.7)
        batch = driver.read(0.1)
    assert len(batch) > 50
    late_ms = (batch.t_acq_ns - batch.t_hw_ns) * 1e-6
    assert np.ptp(late_ms) < 1.0
    assert (np.diff(batch.t_acq_ns) >= 0).all()
