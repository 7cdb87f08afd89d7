"""What a person may do in a lab from another machine, by role."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType


class Role(StrEnum):
    """The rights that stand behind a certificate."""

    VIEWER = "viewer"
    """Sees every sample, event and status, and may press the emergency stop."""
    OPERATOR = "operator"
    """Also commands devices and controls a run; releases only an emergency stop of his own."""
    ADMIN = "admin"
    """Also releases anybody's emergency stop, and ends the host of a device."""


SETPOINT = "setpoint"
_VIEWER = ("status", "estop")
_OPERATOR = (
    *_VIEWER,
    *("lease", "set", SETPOINT, "safe", "release"),
    *("pause", "resume", "stop", "abort", "mark"),
)

RIGHTS: Mapping[Role, tuple[str, ...]] = MappingProxyType(
    {Role.VIEWER: _VIEWER, Role.OPERATOR: _OPERATOR, Role.ADMIN: (*_OPERATOR, "shutdown")}
)
"""The commands of each role; whose emergency stop may be released is decided where it is released."""
