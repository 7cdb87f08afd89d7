"""What a host receives and sends: plain data, JSON on the way."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from labhil.bus.incoming import SetpointMessage, parse, validate
from labhil.documents import parse_json
from labhil.rig_sections import Interlock, Limit

WATCHDOG = 0.22
"""How long commands may stop, s of the host's clock, before a host brings its device to safety.

With the wire and one sample period on top the device is safe within a quarter of a second.
"""


class HostState(StrEnum):
    """What a host is doing."""

    CONNECTING = "connecting"
    IDLE = "idle"
    """Samples come in; the device is in its safe state."""
    ACTIVE = "active"
    """Somebody with the lease commands the device."""
    TRIPPED = "tripped"
    """A sample left its limits or tripped an interlock; safe until the lease is taken anew."""
    LATCHED = "latched"
    """The emergency stop was pressed; the device is in its safe state until it is released."""
    RECONNECTING = "reconnecting"
    """The wire is gone or the device booted again; nothing that is known of it is news."""
    FAILED = "failed"
    """The device or the wire to it failed."""
    STOPPED = "stopped"
    """Told to end, or left by its parent."""


@dataclass(frozen=True, slots=True)
class HostConfig:
    """What a host needs to know; one line of JSON on its standard input.

    ``connect`` is the endpoint of a bus session to join; ``watchdog`` is in s of the host's clock;
    ``reconnect`` lets it look for a device that it has lost; a ``patient`` one looks for as long as it lasts,
    and for a device that is not there at the start, too.
    """

    device: str
    plugin: str
    address: str
    limits: Mapping[str, Limit] = field(default_factory=dict)
    connect: str | None = None
    watchdog: float = WATCHDOG
    interlocks: Mapping[str, Interlock] = field(default_factory=dict)
    reconnect: bool = False
    patient: bool = False

    def to_line(self) -> str:
        """Return the configuration as one line."""
        limits = {name: limit.model_dump() for name, limit in self.limits.items()}
        data = {
            "device": self.device,
            "plugin": self.plugin,
            "address": self.address,
            "limits": limits,
            "connect": self.connect,
            "watchdog": self.watchdog,
            "interlocks": {name: lock.model_dump() for name, lock in self.interlocks.items()},
            "reconnect": self.reconnect,
            "patient": self.patient,
        }
        return json.dumps(data) + "\n"

    @classmethod
    def from_line(cls, line: str) -> HostConfig:
        """Read what :meth:`to_line` wrote; ValueError when that is not what it is."""
        data = parse_json(line)
        limits = {name: Limit.model_validate(limit) for name, limit in data["limits"].items()}
        return cls(
            str(data["device"]),
            str(data["plugin"]),
            str(data["address"]),
            limits,
            data["connect"],
            float(data["watchdog"]),
            {name: Interlock.model_validate(lock) for name, lock in data["interlocks"].items()},
            bool(data["reconnect"]),
            bool(data.get("patient", False)),
        )


A_SETPOINT = 'a setpoint is {"token", "t_ns", "values": {name: number}}'


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Values for some of a device's commands, from the holder of ``token``, sent at Unix time ``t_ns``.

    ``t_hw_ns`` is the time of the device's clock that they belong to, where they are part of a path.
    """

    token: str
    t_ns: int
    values: Mapping[str, float]
    t_hw_ns: int | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the setpoint as plain data: what the command ``set`` takes."""
        data = {"token": self.token, "t_ns": self.t_ns, "values": dict(self.values)}
        return data if self.t_hw_ns is None else {**data, "t_hw_ns": self.t_hw_ns}

    def to_bytes(self) -> bytes:
        """Return the setpoint as it is streamed."""
        return json.dumps(self.to_json()).encode()

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Setpoint:
        """Read plain data; CommandRefusedError when something is missing or is not what it should be."""
        return cls.of(validate(SetpointMessage, data, A_SETPOINT))

    @classmethod
    def from_bytes(cls, payload: bytes) -> Setpoint:
        """Read what :meth:`to_bytes` wrote; CommandRefusedError when that is not what it is."""
        return cls.of(parse(SetpointMessage, payload, A_SETPOINT))

    @classmethod
    def of(cls, message: SetpointMessage) -> Setpoint:
        """Take over what was read already."""
        return cls(message.token, message.t_ns, message.values, message.t_hw_ns)
