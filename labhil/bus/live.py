"""Who is there: tokens that stand as long as their process lives.

A killed process loses its token within milliseconds, a frozen one only after some ten seconds: that is
news for a screen, never what a device's safety rests on.
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
    """Let everybody know that ``device`` is served, as long as the context lasts."""
    token = bus.session.liveliness().declare_token(live_key(device))
    try:
        yield
    finally:
        token.undeclare()


def live_devices(bus: Bus, timeout: float = 1.0) -> tuple[str, ...]:
    """Names of the devices whose hosts are alive, sorted; BusError when the bus is closed."""
    try:
        replies = bus.session.liveliness().get(ALL_LIVE, timeout=timeout)
        devices = {str(reply.ok.key_expr).split("/")[1] for reply in replies if reply.ok is not None}
    except zenoh.ZError as error:
        raise BusError(f"{ALL_LIVE}: could not be asked: {error}") from error
    return tuple(sorted(devices))
