"""The configuration, the states and the setpoints of a host, as data that travels as JSON."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from labhil.bus.incoming import SetpointMessage, parse, validate
from labhil.documents import parse_json
from labhil.host_clock import unix_ns
from labhil.rig_sections import Interlock, Limit

WATCHDOG = 0.22
"""How long no command may come, s of the host's clock, before a host brings its device to its safe state.

Including the transmission and one sample period the device is safe within 0.25 s.
"""


class HostState(StrEnum):
    """The state of a host."""

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
    """The connection is lost or the device booted again; there are no current samples."""
    FAILED = "failed"
    """The device or the connection to it failed."""
    STOPPED = "stopped"
    """The host was ended, or its parent is gone."""


@dataclass(frozen=True, slots=True)
class HostConfig:
    """The configuration of a host; one line of JSON on its standard input.

    Attributes:
        device: Name of the device.
        plugin: Name of its driver.
        address: Where the driver connects.
        limits: The limits of the rig file.
        connect: Endpoint of the bus to join; None for a bus of its own.
        watchdog: How long no command may come, s of the host's clock.
        interlocks: The interlocks of the rig file.
        reconnect: Whether it searches for a device that it has lost.
        patient: Whether that search has no time limit and includes a device that is absent at the start.
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
        """Read a line of :meth:`to_line`; ValueError for any other text."""
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
    """Values for some of a device's commands.

    Attributes:
        token: Token of the lease.
        t_ns: Unix time at which it was sent, ns.
        values: SI values, by column.
        t_hw_ns: Time of the device's clock that they belong to, ns, where they are part of a path.
    """

    token: str
    t_ns: int
    values: Mapping[str, float]
    t_hw_ns: int | None = None

    def age(self) -> float:
        """Return its age, s; negative for one from the future.

        A sender without the session's clock stamps by the wall clock, which may have been set since.
        """
        return min(unix_ns() - self.t_ns, time.time_ns() - self.t_ns, key=abs) * 1e-9

    def to_json(self) -> dict[str, Any]:
        """Return the setpoint as JSON data, the request of the command ``set``."""
        data = {"token": self.token, "t_ns": self.t_ns, "values": dict(self.values)}
        return data if self.t_hw_ns is None else {**data, "t_hw_ns": self.t_hw_ns}

    def to_bytes(self) -> bytes:
        """Return the setpoint as it is streamed."""
        return json.dumps(self.to_json()).encode()

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Setpoint:
        """Read JSON data; CommandRefusedError where a field is missing or wrong."""
        return cls.of(validate(SetpointMessage, data, A_SETPOINT))

    @classmethod
    def from_bytes(cls, payload: bytes) -> Setpoint:
        """Read a streamed setpoint; CommandRefusedError where it is malformed."""
        return cls.of(parse(SetpointMessage, payload, A_SETPOINT))

    @classmethod
    def of(cls, message: SetpointMessage) -> Setpoint:
        """Return the setpoint of a message."""
        return cls(message.token, message.t_ns, message.values, message.t_hw_ns)
