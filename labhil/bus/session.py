"""One process's seat on the bus: a zenoh peer that listens on loopback and nowhere else.

Two other seats reach beyond the loopback, over TLS with certificates on both sides: :func:`open_bus` with the
folder of a connection is a guest at a lab on another machine, :func:`open_to_guests` is where guests come in.
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

from labhil.bus.authentication import OLDEST, Signer, Verifier, new_key
from labhil.bus.keys import ARRIVED, guest_key
from labhil.bus.register import is_endpoint, keep_key, key_of
from labhil.bus.rights import access_control
from labhil.errors import BusError, CommandRefusedError
from labhil.security.authority import Authority, bracketed
from labhil.security.connection import Connection, load_connection
from labhil.security.roles import RIGHTS

CONNECT_TIMEOUT_MS = 5000
BLOCKED_LINK_CLOSES_AFTER_US = 60_000_000  # a reader that stalls for less loses nothing
ARRIVAL_TIMEOUT = 2.0  # s
ATTEMPTS = 5
ACQUAINTANCE = 1.0
"""Seconds after which the peers that gossip tells of are known."""


class Part(Protocol):
    """Something with a thread of its own that works on a bus."""

    def failure(self) -> str:
        """Return why it does its work no more, though nobody closed it; empty while all is well."""


@dataclass(frozen=True, slots=True)
class Bus:
    """An open session, and the endpoint where other processes reach it (``tcp/127.0.0.1:PORT``).

    ``keys`` are those of the sessions that it joined, or its own; what it asks, commands and
    publishes is signed with them. A ``guest`` at a lab on another machine has none: its certificate counts.
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
        """Return where a command or a question is sent: a guest's key has its name in it."""
        return key_expression if self.guest is None else guest_key(key_expression, self.guest.name)

    def unanswered(self, key_expression: str) -> BusError | CommandRefusedError:
        """Return the error for a question that nobody answers; where a right is missing, nobody does."""
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
        """Return what is attached to a message to show that it comes from a holder of the session's key.

        Each key expression has numbers of its own: what other threads publish overtakes none of its messages.
        """
        signer = self._signers.get(key_expression) or self._signers.setdefault(
            key_expression, Signer(self.keys)
        )
        return signer.sign(key_expression, payload)

    def verifier(self, oldest: float = OLDEST, transit: float = 0.0) -> Verifier:
        """Return what tells the messages of holders of the session's key from those of others."""
        return Verifier(self.keys, oldest, transit)

    def attend(self, part: Part) -> None:
        """Let :meth:`failure` look after something that works on this bus."""
        self._parts.append(part)

    def dismiss(self, part: Part) -> None:
        """Look after it no more; safe to call twice."""
        with suppress(ValueError):
            self._parts.remove(part)

    def failure(self) -> str:
        """Return what works no more on this bus, and why; empty while all is well.

        Whoever commands a device asks this several times a second: a thread that died hears nothing more, not
        even the emergency stop.
        """
        if self.session.is_closed():
            return "the session on the bus is closed"
        return next((why for part in self._parts.copy() if (why := part.failure())), "")

    @property
    def settling(self) -> bool:
        """Whether the bus was joined so recently that not every peer may be known yet."""
        return time.monotonic() < self.opened + ACQUAINTANCE

    def close(self) -> None:
        """Leave the bus once all that was published has arrived; safe to call twice."""
        if self.session.is_closed():
            return
        if self._key_file is not None:
            self._key_file.unlink(missing_ok=True)
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

    Where ``connect`` is a folder that ``labhil security add`` made, be a guest at the lab on another machine.
    Of several endpoints, those where nobody answers are left out in silence; of one, that is an error.
    Each process listens on a port of its own, drawn here, and learns of the others by gossip: the bus
    outlives the process that began it. BusError when nobody listens at ``connect``, UsageError for a folder
    that is no connection.
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
            # between drawing a port and listening there somebody else may have taken it
            if "Address already in use" in str(error) and attempt < ATTEMPTS:
                continue
            where = (
                f"expected a process of ours at {connect}" if connect else f"expected to listen at {endpoint}"
            )
            raise BusError(f"the bus could not be opened: {where}; found: {error}") from error
    raise BusError(f"no free port found on 127.0.0.1 in {ATTEMPTS} attempts")


def open_to_guests(authority: Authority, address: str) -> Bus:
    """Listen at ``address`` for the people of ``authority``, each with the rights of its role.

    Nobody gets a link without a certificate of this authority, nor a message through without the right to it.
    BusError where it cannot be listened there.
    """
    endpoint = f"tls/{bracketed(address)}:{authority.port}"
    settings = {
        # a guest that joins as a router would else be asked, by a peer, who is there: others would see nobody
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
    """The keys of the sessions that are joined, else a new one, and the file that hands them on."""
    places = [connect] if isinstance(connect, str) else list(connect or ())
    with suppress(BusError, OSError):  # without the directory keys are neither found nor handed on
        joined = dict.fromkeys(key for place in places if (key := key_of(place)) is not None)
        keys = tuple(joined) or (new_key(),)
        # one that joined several sessions is only a visitor: nobody reaches them by it
        return keys, keep_key(endpoint, keys[0]) if len(keys) == 1 else None
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
