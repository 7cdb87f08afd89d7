"""The relay between one bus of this machine and guests: samples and events out, permitted requests in."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any, Self

import zenoh

from labhil.bus.ask import ask, ask_all
from labhil.bus.authentication import Refusals
from labhil.bus.keys import (
    ALL_SCHEMAS,
    ALL_STREAMS,
    RUN,
    SETPOINT,
    command_key,
    live_key,
    setpoint_key,
    split_key,
)
from labhil.bus.live import live_devices
from labhil.bus.publish import publish_command
from labhil.bus.register import Registered
from labhil.bus.session import Bus, open_bus
from labhil.bus.subscribe import subscribe
from labhil.errors import BusError, CommandRefusedError

DEVICE_TIMEOUT, RUN_TIMEOUT = 2.0, 5.0
"""How long an answer may take, s; a run carries out a request before it answers."""

Answer = Mapping[str, Any] | BusError | CommandRefusedError


class Relay:
    """Passes the samples, events and schemas of a bus on to guests; a context manager.

    Only messages that are signed with the session's key go out. A guest that is too slow loses samples and
    does not block the lab. Setpoints do not go out, since they contain the token of a lease.

    Args:
        entry: The bus.
        door: The bus of the guests.
    """

    def __init__(self, entry: Registered, door: Bus) -> None:
        self.entry = entry
        # not reported: a process that joins several buses connects them, and each gets the others' messages
        self._door, self._refusals = door, Refusals()
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self._resources = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as resources:
            self._bus = resources.enter_context(open_bus(self.entry.endpoint))
            for keys in (ALL_SCHEMAS, ALL_STREAMS):
                resources.enter_context(subscribe(self._bus, keys, self._pass_on, self._refusals))
            resources.callback(self._show_live, ())
            self._resources = resources.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._resources.close()

    def serves(self, device: str) -> bool:
        """Return whether a device, or the run, is on this bus."""
        return device in self.entry.devices or (device == RUN and self.entry.kind in ("run", "lab"))

    def poll(self) -> None:
        """Show guests which devices are alive; BusError where this bus is not heard any more."""
        if fault := self._bus.failure():
            raise BusError(f"{self.entry.endpoint}: {fault}")
        self._show_live(tuple(name for name in live_devices(self._bus) if name in self.entry.devices))

    def ask(self, device: str, command: str, request: Mapping[str, Any]) -> Mapping[str, Any]:
        """Ask a device or the run, signed with this session's key; raises what ``bus.ask`` raises."""
        timeout = RUN_TIMEOUT if device == RUN else DEVICE_TIMEOUT
        return ask(self._bus, command_key(device, command), request, timeout)

    def schemas(self, key: str) -> Mapping[str, Answer]:
        """Return the schemas of the streams whose keys match ``key``."""
        return ask_all(self._bus, key, timeout=DEVICE_TIMEOUT)

    def command(self, device: str, payloads: list[bytes]) -> None:
        """Pass setpoints on, signed with this session's key."""
        for payload in payloads:
            publish_command(self._bus, setpoint_key(device), payload)

    def _pass_on(self, key: str, payloads: list[bytes]) -> None:
        _device, stream = split_key(key)
        if stream == SETPOINT:
            return
        with suppress(zenoh.ZError):  # the door was closed meanwhile
            for payload in payloads:
                self._door.session.put(key, payload, congestion_control=zenoh.CongestionControl.DROP)

    def _show_live(self, devices: tuple[str, ...]) -> None:
        for device in set(self._tokens) - set(devices):
            with suppress(zenoh.ZError):
                self._tokens.pop(device).undeclare()
        for device in set(devices) - set(self._tokens):
            self._tokens[device] = self._door.session.liveliness().declare_token(live_key(device))
