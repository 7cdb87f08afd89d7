"""The requests to a host: the model of each, and which have to be signed with the session's key."""

from __future__ import annotations

from collections.abc import Callable

from labhil.bus.incoming import (
    AnyRequest,
    EstopRequest,
    Incoming,
    LeaseRequest,
    SafeRequest,
    SetpointMessage,
    is_stop,
    parse,
)
from labhil.errors import CommandRefusedError
from labhil.service.messages import A_SETPOINT

COMMANDS: dict[str, type[Incoming]] = {
    "status": AnyRequest,
    "set": SetpointMessage,
    "safe": SafeRequest,
    "lease": LeaseRequest,
    "estop": EstopRequest,
    "shutdown": AnyRequest,
}
OPEN_TO_ALL = ("status",)
"""Requests without a signature. Pressing the emergency stop needs none either."""


def reader_of(name: str) -> Callable[[bytes], Incoming]:
    """Return the function that reads the request of a command; a malformed emergency stop counts as one."""

    def read(payload: bytes) -> Incoming:
        try:
            return parse(COMMANDS[name], payload, A_SETPOINT if name == "set" else name)
        except CommandRefusedError as error:
            if name == "estop" and is_stop(payload):
                return EstopRequest(reason=f"(the message that pressed it was malformed: {error})")
            raise

    return read


def is_guarded(name: str, request: Incoming) -> bool:
    """Return whether a request has to be signed with the session's key."""
    presses_stop = isinstance(request, EstopRequest) and request.action == "press"
    return not presses_stop and name not in OPEN_TO_ALL
