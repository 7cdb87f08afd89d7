"""Liveliness tokens: which devices have a host that is alive.

A killed process loses its token within milliseconds, a frozen one only after some ten seconds. That is for
display; the safety of a device never depends on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import zenoh

from labhil.bus.keys import ALL_LIVE, live_key
from labhil.bus.session import Bus
from labhil.errors import BusError


@contextmanager
def announce(bus: Bus, device: str) -> Iterator[None]:
    """Declare that ``device`` has a host, as long as the context lasts."""
    token = bus.session.liveliness().declare_token(live_key(device))
    try:
        yield
    finally:
        token.undeclare()


def live_devices(bus: Bus, timeout: float = 1.0) -> tuple[str, ...]:
    """Return the names of the devices whose hosts are alive, sorted; BusError where the bus is closed."""
    try:
        replies = bus.session.liveliness().get(ALL_LIVE, timeout=timeout)
        devices = {str(reply.ok.key_expr).split("/")[1] for reply in replies if reply.ok is not None}
    except zenoh.ZError as error:
        raise BusError(f"{ALL_LIVE}: could not be asked: {error}") from error
    return tuple(sorted(devices))
