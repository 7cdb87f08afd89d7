"""The session of a process on the bus: a zenoh peer that listens only on the loopback.

Two other sessions reach beyond the loopback, over TLS with certificates on both sides: :func:`open_bus` with
the folder of a connection joins a lab on another machine as a guest, :func:`open_to_guests` serves guests.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import zenoh

from labhil.bus.authentication import MAX_AGE, Signer, Verifier, new_key
from labhil.bus.keys import ARRIVED, guest_key
from labhil.bus.register import find_key, is_endpoint, store_key
from labhil.bus.rights import access_control
from labhil.errors import BusError, CommandRefusedError
from labhil.security.authority import Authority, bracketed
from labhil.security.connection import Connection, load_connection
from labhil.security.roles import RIGHTS

CONNECT_TIMEOUT_MS = 5000
"""How long joining a bus may take, ms."""
BLOCKED_LINK_CLOSES_AFTER_US = 60_000_000
"""How long a link may be blocked before it is closed, µs; a reader that stalls for less loses nothing."""
ARRIVAL_TIMEOUT = 2.0
"""How long a session that is closed waits for the arrival of its messages, s."""
ATTEMPTS = 5
"""Attempts to find a free port."""
DISCOVERY_TIME = 1.0
"""How long it takes until all peers are known by gossip, s."""


class Part(Protocol):
    """A part of a bus with a thread of its own, such as a subscription."""

    def failure(self) -> str:
        """Return why it does not work any more although it is open; empty while it works."""


@dataclass(frozen=True, slots=True)
class Bus:
    """An open session on the bus.

    Attributes:
        session: The zenoh session.
        endpoint: Where other processes reach it (``tcp/127.0.0.1:PORT``).
        opened: When it was opened, s of the monotonic clock.
        keys: Keys of the sessions that it joined, or its own; messages are signed with them.
        guest: The connection of a guest at a lab on another machine, which has a certificate and no keys.
    """

    session: zenoh.Session
    endpoint: str
    opened: float = field(default_factory=time.monotonic)
    keys: tuple[bytes, ...] = field(default=(), repr=False)
    guest: Connection | None = None
    _key_file: Path | None = None
    _signers: dict[str, Signer] = field(default_factory=dict, repr=False)
    _parts: list[Part] = field(default_factory=list, repr=False)

    def place(self, key_expression: str) -> str:
        """Return the key under which a request is sent: that of a guest contains its name."""
        return key_expression if self.guest is None else guest_key(key_expression, self.guest.name)

    def unanswered_error(self, key_expression: str) -> BusError | CommandRefusedError:
        """Return the error for a request that nobody answers, perhaps because a right is missing."""
        command = key_expression.rpartition("/")[2]
        guest = self.guest
        if guest is not None and command not in RIGHTS[guest.role]:
            return CommandRefusedError(
                f"{command}: {guest.name!r} is {guest.role} in the lab at {guest.endpoint} and has no right"
                " to that; whoever keeps the lab gives certificates: labhil security add"
            )
        where = "" if guest is None else f" at {guest.endpoint}, or {guest.name!r} was revoked"
        return BusError(f"{key_expression}: nobody answers there{where}")

    def sign(self, key_expression: str, payload: bytes) -> bytes:
        """Return the attachment that authenticates a message.

        Each key expression has its own numbers, so that messages of other threads cannot overtake its own.
        """
        signer = self._signers.get(key_expression) or self._signers.setdefault(
            key_expression, Signer(self.keys)
        )
        return signer.sign(key_expression, payload)

    def verifier(self, max_age: float = MAX_AGE, transit: float = 0.0) -> Verifier:
        """Return a verifier of messages that are signed with the session's key."""
        return Verifier(self.keys, max_age, transit)

    def watch(self, part: Part) -> None:
        """Include a part in :meth:`failure`."""
        self._parts.append(part)

    def unwatch(self, part: Part) -> None:
        """Exclude a part again; safe to call twice."""
        with suppress(ValueError):
            self._parts.remove(part)

    def failure(self) -> str:
        """Return the failure of the first part that does not work any more; empty while all work.

        A process that commands a device checks this several times a second: a thread that died receives
        nothing more, not even the emergency stop.
        """
        if self.session.is_closed():
            return "the session on the bus is closed"
        return next((fault for part in self._parts.copy() if (fault := part.failure())), "")

    @property
    def is_settling(self) -> bool:
        """Whether the bus was joined so recently that not every peer may be known yet."""
        return time.monotonic() < self.opened + DISCOVERY_TIME

    def close(self) -> None:
        """Close the session once all its messages have arrived; safe to call twice."""
        if self.session.is_closed():
            return
        if self._key_file is not None:
            self._key_file.unlink(missing_ok=True)
        self._wait_for_arrival()
        self.session.close()

    def _wait_for_arrival(self) -> None:
        """Wait until messages have arrived (a query is answered after them): closing discards unsent ones."""
        with suppress(zenoh.ZError):  # a peer that does not answer in time must not block this process
            for _ in self.session.get(ARRIVED, target=zenoh.QueryTarget.ALL, timeout=ARRIVAL_TIMEOUT):
                continue

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_bus(connect: str | Sequence[str] | None = None) -> Bus:
    """Join a bus, or begin one.

    Each process listens on a port of its own and discovers the others by gossip, so that the bus outlives the
    process that began it.

    Args:
        connect: Endpoint of a process on the bus, or the folder that ``labhil security add`` made for a guest
            at a lab on another machine. Of several endpoints, those without an answer are ignored. None
            begins a bus.

    Raises:
        BusError: Nobody listens at ``connect``, or no port is free.
        UsageError: The folder is no connection.
    """
    if isinstance(connect, str) and not is_endpoint(connect):
        return _open_as_guest(load_connection(Path(connect)))
    for attempt in range(1, ATTEMPTS + 1):
        endpoint = f"tcp/127.0.0.1:{_free_port()}"
        try:
            session = zenoh.open(_config(_settings(endpoint, connect)))
            keys, file = _keys(endpoint, connect)
            return Bus(session, endpoint, keys=keys, _key_file=file)
        except zenoh.ZError as error:
            # another process may have taken the port since it was found free
            if "Address already in use" in str(error) and attempt < ATTEMPTS:
                continue
            where = (
                f"expected a labhil process at {connect}" if connect else f"expected to listen at {endpoint}"
            )
            raise BusError(f"the bus could not be opened: {where}; found: {error}") from error
    raise BusError(f"no free port found on 127.0.0.1 in {ATTEMPTS} attempts")


def open_to_guests(authority: Authority, address: str) -> Bus:
    """Open a session that guests from other machines join, each with the rights of its role.

    A link needs a certificate of the authority, and every message the right to it.

    Args:
        authority: The authority of the lab.
        address: Address of this machine at which to listen.

    Raises:
        BusError: It is not possible to listen there.
    """
    endpoint = f"tls/{bracketed(address)}:{authority.port}"
    settings = {
        # with a peer here, a guest that joins as a router would answer liveliness queries for the others
        "mode": "router",
        "listen/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        **authority.tls(),
        "access_control": access_control(authority.valid_people()),
    }
    try:
        return Bus(zenoh.open(_config(settings)), endpoint)
    except zenoh.ZError as error:
        raise BusError(
            f"expected to listen at {endpoint}; found: {error}. Is --listen an address of this machine, and"
            " the port free?"
        ) from error


def _open_as_guest(connection: Connection) -> Bus:
    settings = {
        "mode": "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "connect/endpoints": [connection.endpoint],
        "connect/timeout_ms": CONNECT_TIMEOUT_MS,
        "connect/exit_on_failure": True,
        **connection.tls(),
    }
    try:
        return Bus(zenoh.open(_config(settings)), connection.endpoint, guest=connection)
    except zenoh.ZError as error:
        raise BusError(
            f"expected `labhil security serve` at {connection.endpoint} that knows the certificate of"
            f" {connection.name!r}; found: {error}. Can the machine be reached, is it served, was its folder"
            f" made anew since {connection.folder} was?"
        ) from error


def _keys(endpoint: str, connect: str | Sequence[str] | None) -> tuple[tuple[bytes, ...], Path | None]:
    """Return the keys of the joined sessions, or a new one, and the file that passes it on."""
    endpoints = [connect] if isinstance(connect, str) else list(connect or ())
    with suppress(BusError, OSError):  # without the directory keys are neither found nor passed on
        joined = dict.fromkeys(key for joins in endpoints if (key := find_key(joins)) is not None)
        keys = tuple(joined) or (new_key(),)
        # a session that joined several buses is no way to reach them
        return keys, store_key(endpoint, keys[0]) if len(keys) == 1 else None
    return (new_key(),), None


def _settings(endpoint: str, connect: str | Sequence[str] | None) -> Mapping[str, object]:
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
    return settings


def _config(settings: Mapping[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
