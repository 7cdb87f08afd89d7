"""For those who write drivers: what a device is to labhil, what it says, and the suite that every driver
passes.

How to write and register one is in ``docs/how-to/write-a-driver.md``.

Example:
    >>> from labhil.devices import Batch, Driver, DriverSpec, Signal, Stream
    >>> Batch.empty(width=2).values.shape
    (0, 2)
    >>> from labhil.devices import rig_kind
    >>> [signal.name for signal in rig_kind("ball_beam").outputs]
    ['ball_position']
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from labhil.driver import (
    AddressFinder,
    Counters,
    DeviceInfo,
    Driver,
    DriverSpec,
    FaultReportingDriver,
    FoundAddress,
    TimedDriver,
    Twin,
    TwinOptions,
)
from labhil.kinds import Known, RigKind
from labhil.kinds import kind_named as rig_kind
from labhil.signals import Batch, Direction, Hold, Signal, Stream

if TYPE_CHECKING:
    from labhil.testing import DriverContract

__all__ = [
    "AddressFinder",
    "Batch",
    "Counters",
    "DeviceInfo",
    "Direction",
    "Driver",
    "DriverContract",
    "DriverSpec",
    "FaultReportingDriver",
    "FoundAddress",
    "Hold",
    "Known",
    "RigKind",
    "Signal",
    "Stream",
    "TimedDriver",
    "Twin",
    "TwinOptions",
    "rig_kind",
]


def __getattr__(name: str) -> Any:
    if name == "DriverContract":  # it needs pytest
        from labhil.testing import DriverContract

        return DriverContract
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
