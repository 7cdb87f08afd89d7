"""What a device is to the rest of the program.

A driver plugin is a class that satisfies :class:`Driver` and is registered under the entry-point
group ``labhil.drivers``. It is a thin thing: it owns the wire and the declaration of the signals,
nothing else. Limits, leases, watchdogs, the bus and the recording belong to its host.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from labhil.signals import Batch, Signal, Stream


@dataclass(frozen=True, slots=True)
class DriverSpec:
    """What is known of a device before anything is connected.

    ``commands`` are the signals that can be set; ``safe`` gives each its value in the safe state
    (ball and beam: level; solenoid: 0 A), unless it is to stay what it is then (an arm stops and
    holds). A vector such as six joints is commanded by its columns, ``target_q_0``, ``target_q_1``, ….
    ``command_timeout`` (s of the device's clock) is how long the device itself waits for any valid
    message before it goes there on its own; ``longest_output`` (s of it) is how long it holds another
    output without a break, infinite where nothing is declared. ``ranges`` are the lowest and highest
    values that it takes, by command, whatever a rig file allows.

    ``waypoint_rate`` (Hz) is for a :class:`TimedDriver`: how often it wants to be told where to be.
    ``approach`` names commands that have to stand where a run begins before the run's clock starts, and
    how near (SI): the driver goes there by itself when it is told. ``ready`` names signals and the values
    they must have by then.
    """

    name: str
    rig: str
    description: str
    stream: Stream
    commands: tuple[Signal, ...]
    safe: Mapping[str, float]
    command_timeout: float
    address_help: str
    longest_output: float = math.inf
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    waypoint_rate: float = 0.0
    approach: Mapping[str, float] = field(default_factory=dict)
    ready: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """What a device said of itself when it was connected.

    ``boot_id`` changes at every start of the device; ``speed`` is how many seconds of the device's
    clock pass in one second (1 but for a twin that runs faster than real time).
    """

    firmware: str
    serial: str
    boot_id: int
    speed: float = 1.0
    calibration: Mapping[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class Counters:
    """What happened on the wire since the connection was made.

    ``lost`` samples are holes in ``seq``; ``stale`` ones bore the time of the sample before. ``unheard``
    counts how often the device made itself safe although it was commanded: it heard nothing for so long.
    """

    frames: int = 0
    lost: int = 0
    stale: int = 0
    crc_errors: int = 0
    resyncs: int = 0
    resets: int = 0
    unheard: int = 0


@runtime_checkable
class Driver(Protocol):
    """The four things every device can do: talk, take a command, go to its safe state, be closed.

    A driver is used by one thread at a time, except that ``safe`` and ``close`` may be called from
    any. Constructing one does no I/O.

    ``spec`` of the class declares everything that such a device may have. Where a device says what is
    fitted to it and how fast it samples, ``spec`` of a driver that is connected is that one's: its
    stream may have fewer signals (one that is not there is absent) and another rate.
    """

    spec: DriverSpec
    counters: Counters

    def __init__(self, address: str) -> None: ...

    def connect(self) -> DeviceInfo:
        """Open the wire, wait for the device, send its configuration.

        Raises ConnectError when nobody is there and ProtocolError when somebody else is.
        """
        ...

    def read(self, timeout: float) -> Batch:
        """Return the samples that have come in, waiting up to ``timeout`` s for the first.

        An empty batch means that nothing came. Raises DeviceResetError when the device booted again
        and ConnectError when the wire is gone.
        """
        ...

    def command(self, values: Mapping[str, float]) -> None:
        """Send new values for some of ``spec.commands``; also what keeps the device's watchdog quiet."""
        ...

    def safe(self) -> None:
        """Bring the device to its safe state. Does its best, whatever state things are in; never raises."""
        ...

    def close(self) -> None:
        """Let go of the wire. Safe to call twice, and before ``connect``."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


@runtime_checkable
class FaultReportingDriver(Driver, Protocol):
    """A driver that says what keeps its device from being commanded, which ends a run as a limit does."""

    def fault(self) -> str:
        """Return why the device cannot be commanded, in words; empty when it can."""
        ...

    def is_transient(self) -> bool:
        """Whether the trouble passes by itself, and a path may go on then without anybody looking."""
        ...


@runtime_checkable
class TimedDriver(FaultReportingDriver, Protocol):
    """A driver that moves along a path: its commands belong to times of the device's clock.

    It plays them a little later and as smoothly as they are, however unevenly they come.
    """

    def command_at(self, values: Mapping[str, float], t_hw_ns: int) -> None:
        """As :meth:`Driver.command`, for a time of the device's clock."""
        ...


@dataclass(frozen=True, slots=True)
class FoundAddress:
    """An ``address``, as a driver takes it, at which its device may be, and ``what`` was found there."""

    address: str
    what: str


@runtime_checkable
class AddressFinder(Protocol):
    """What a driver's class satisfies, beside :class:`Driver`, where it finds addresses by itself."""

    def find_addresses(self, search: str | None = None) -> tuple[FoundAddress, ...]:
        """Return addresses at which such a device may be, the likeliest first; a class method.

        It moves nothing, sends no command, and takes a few seconds at most.

        Args:
            search: A network to look through, such as "192.168.1.0/24"; None for what this machine knows.

        Raises:
            OptionError: The network is none, is too large, or the device is on no network.
        """
        ...


class Twin(Protocol):
    """A simulated device on the real wire, registered under the entry-point group ``labhil.twins``.

    A twin is a program of its own: ``serve`` opens its port, calls ``ready`` once with the address
    to connect to, and runs until it is interrupted.
    """

    name: str
    rig: str
    description: str

    def terms(self) -> Mapping[str, str]:
        """Names of the effects that this twin can carry, each with one line about it."""
        ...

    def parameters(self) -> Mapping[str, float]:
        """Names that ``--set`` takes, with their default values (SI)."""
        ...

    def serve(self, options: TwinOptions, ready: ReadyCallback) -> None:
        """Run until SIGINT, SIGTERM or the end of standard input closes it."""
        ...


@runtime_checkable
class PartlyFittedTwin(Twin, Protocol):
    """A twin that says before it starts which of its driver's signals it will not have."""

    def unfitted(self, parameters: Mapping[str, float]) -> Mapping[str, str]:
        """Return the signals that it lacks with these parameters, each with the setting that fits it."""
        ...


@dataclass(frozen=True, slots=True)
class TwinOptions:
    """How to start a twin.

    ``terms`` names the effects that it carries beyond the bare rig (None: the twin's own default);
    ``parameters`` overrides single values; ``speed`` runs its world that many times faster than
    real time; ``wire`` is ``"pty"`` or ``"tcp"``; ``tables`` are files with measured maps, by name. ``host``
    is the address of this machine that a networked twin binds to, ``series`` which make of its controller it
    is (None: the twin's own default). What the twin is made of is written to ``answer`` (JSON: ``terms``,
    ``parameters``, ``seed``) and told nowhere else.
    """

    seed: int = 0
    speed: float = 1.0
    terms: tuple[str, ...] | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    wire: str = "pty"
    answer: Path | None = None
    tables: Mapping[str, Path] = field(default_factory=dict)
    host: str | None = None
    series: str | None = None


class ReadyCallback(Protocol):
    """Told once, with the address that a driver can connect to."""

    def __call__(self, address: str) -> None:
        """Receive the address."""
        ...
