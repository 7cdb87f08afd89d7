"""For those who write drivers: what a device is to labhil, what it says, and the suite that every driver
passes.

How to write and register one is in ``docs/plugins.md``.

Example:
    >>> from labhil.devices import Batch, Driver, DriverSpec, Signal, Stream
    >>> Batch.empty(width=2).values.shape
    (0, 2)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from labhil.driver import Counters, DeviceInfo, Driver, DriverSpec, TimedDriver, Twin, TwinOptions
from labhil.signals import Batch, Direction, Hold, Signal, Stream

if TYPE_CHECKING:
    from labhil.testing import DriverContract

__all__ = [
    "Batch",
    "Counters",
    "DeviceInfo",
    "Direction",
    "Driver",
    "DriverContract",
    "DriverSpec",
    "Hold",
    "Signal",
    "Stream",
    "TimedDriver",
    "Twin",
    "TwinOptions",
]


def __getattr__(name: str) -> Any:
    if name == "DriverContract":  # it needs pytest
        from labhil.testing import DriverContract

        return DriverContract
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
