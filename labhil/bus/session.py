"""One process's seat on the bus: a zenoh peer that listens on loopback and nowhere else."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import zenoh

from labhil.bus.keys import ARRIVED
from labhil.errors import BusError

CONNECT_TIMEOUT_MS = 5000
BLOCKED_LINK_CLOSES_AFTER_US = 60_000_000  # a reader that stalls for less loses nothing
ARRIVAL_TIMEOUT = 2.0  # s
ATTEMPTS = 5
ACQUAINTANCE = 1.0
"""Seconds after which the peers that gossip tells of are known."""


@dataclass(frozen=True, slots=True)
class Bus:
    """An open session, and the endpoint where other processes reach it (``tcp/127.0.0.1:PORT``)."""

    session: zenoh.Session
    endpoint: str
    opened: float = field(default_factory=time.monotonic)

    @property
    def settling(self) -> bool:
        """Whether the bus was joined so recently that not every peer may be known yet."""
        return time.monotonic() < self.opened + ACQUAINTANCE

    def close(self) -> None:
        """Leave the bus once all that was published has arrived; safe to call twice."""
        if self.session.is_closed():
            return
        self._wait_for_arrival()
        self.session.close()

    def _wait_for_arrival(self) -> None:
        """Closing a session throws away what still waits to be sent, so let the question go after it."""
        with suppress(zenoh.ZError):  # a peer that does not answer in time must not keep us here
            for _ in self.session.get(ARRIVED, target=zenoh.QueryTarget.ALL, timeout=ARRIVAL_TIMEOUT):
                continue

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_bus(connect: str | Sequence[str] | None = None) -> Bus:
    """Join the bus of the process that listens at ``connect``; without it, begin one.

    Of several endpoints, those where nobody answers are left out in silence; of one, that is an error.
    Each process listens on a port of its own, drawn here, and learns of the others by gossip: the bus
    outlives the process that began it. BusError when nobody listens at ``connect``.
    """
    for attempt in range(1, ATTEMPTS + 1):
        endpoint = f"tcp/127.0.0.1:{_free_port()}"
        try:
            return Bus(zenoh.open(_config(endpoint, connect)), endpoint)
        except zenoh.ZError as error:
            # between drawing a port and listening there somebody else may have taken it
            if "Address already in use" in str(error) and attempt < ATTEMPTS:
                continue
            where = (
                f"expected a process of ours at {connect}" if connect else f"expected to listen at {endpoint}"
            )
            raise BusError(f"the bus could not be opened: {where}; found: {error}") from error
    raise BusError(f"no free port found on 127.0.0.1 in {ATTEMPTS} attempts")


def _config(endpoint: str, connect: str | Sequence[str] | None) -> zenoh.Config:
    # scouting/delay stays as it is: 0 loses the first samples
    settings: dict[str, object] = {
        "mode": "peer",
        "listen/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": BLOCKED_LINK_CLOSES_AFTER_US,
    }
    if isinstance(connect, str):
        settings["connect/endpoints"] = [connect]
        settings["connect/timeout_ms"] = CONNECT_TIMEOUT_MS
        settings["connect/exit_on_failure"] = True
    elif connect is not None:
        settings["connect/endpoints"] = list(connect)
        settings["connect/exit_on_failure"] = False
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
