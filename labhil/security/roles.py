"""The rights of a person in a lab on another machine, by role."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType

from labhil.errors import OptionError


class Role(StrEnum):
    """The role of a person with a certificate; :data:`RIGHTS` lists the commands of each."""

    VIEWER = "viewer"
    """Sees every sample, event and status, and may press the emergency stop."""
    OPERATOR = "operator"
    """Also commands devices and controls a run; releases only an emergency stop of their own."""
    ADMIN = "admin"
    """Also releases anybody's emergency stop, and ends the host of a device."""


def parse_role(name: str) -> Role:
    """Return the role of that name; OptionError where there is none."""
    if name not in list(Role):
        raise OptionError(
            "role",
            ": expected viewer (sees all, may press the emergency stop), operator (may also command devices"
            f" and runs) or admin (may also release any emergency stop), found {name!r}",
        )
    return Role(name)


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
"""The commands of each role; the gateway decides whose emergency stop an operator may release."""
