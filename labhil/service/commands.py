"""The requests to a host, how each is read, and which of them need the session's key."""

from __future__ import annotations

from collections.abc import Callable

from labhil.bus.incoming import (
    AnyRequest,
    EstopRequest,
    Incoming,
    LeaseRequest,
    SafeRequest,
    SetpointMessage,
    is_press,
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
"""What anybody may ask for. Anybody may press the emergency stop, too."""


def reader_of(name: str) -> Callable[[bytes], Incoming]:
    """Return what reads the request of a command; a stop counts however badly it is written."""

    def read(payload: bytes) -> Incoming:
        try:
            return parse(COMMANDS[name], payload, A_SETPOINT if name == "set" else name)
        except CommandRefusedError as error:
            if name == "estop" and is_press(payload):
                return EstopRequest(reason=f"(the message that pressed it was malformed: {error})")
            raise

    return read


def is_guarded(name: str, request: Incoming) -> bool:
    """Whether a request has to be signed with the session's key."""
    presses = isinstance(request, EstopRequest) and request.action == "press"
    return not presses and name not in OPEN_TO_ALL
