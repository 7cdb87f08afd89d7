"""The description of one kind of serial rig, and the conversion of its raw samples to SI units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labhil.driver import DeviceInfo, DriverSpec
from labhil.link import ChannelScale, Config, Hello
from labhil.signals import FloatArray, IntArray, Signal, Stream

COUNTER_RANGE = 1 << 16
"""Counts after which a 16 bit counter wraps."""


@dataclass(frozen=True, slots=True)
class SerialRig:
    """One kind of device on the link.

    Attributes:
        spec: Its declaration; ``spec.stream`` lists all possible channels in the order of the protocol, the
            commands last.
        baud_rate: Its baud rate.
        optional: Channels that may be missing.
        counters: Channels that wrap at 16 bits and are unwrapped.
    """

    spec: DriverSpec
    baud_rate: int
    optional: frozenset[str] = frozenset()
    counters: frozenset[str] = frozenset()

    @property
    def config(self) -> Config:
        """The configuration that is sent after HELLO."""
        longest = self.spec.longest_output
        return Config(
            round(self.spec.command_timeout * 1000), None if math.isinf(longest) else round(longest)
        )

    def mismatch(self, hello: Hello) -> str:
        """Return how the device of a HELLO differs from this kind; empty where it does not."""
        names = self.spec.stream.names()
        if hello.device != self.spec.name:
            return f"expected the device {self.spec.name!r}, found {hello.device!r}: wrong port?"
        if len(hello.channels) != len(names):
            return f"expected {len(names)} channels ({', '.join(names)}), found {len(hello.channels)}"
        if not 0.0 < hello.sample_rate < math.inf:
            return f"expected a sample rate above 0 Hz, found {hello.sample_rate:g}"
        missing = [
            name
            for name, channel in zip(names, hello.channels, strict=True)
            if not channel.fitted and name not in self.optional
        ]
        return f"expected the channel {missing[0]}, found that it is not fitted" if missing else ""

    def spec_of(self, hello: Hello) -> DriverSpec:
        """Return the declaration of the device of a HELLO: its fitted channels, at its rate."""
        signals = tuple(signal for signal, _ in self.fitted(hello))
        return replace(self.spec, stream=Stream(self.spec.stream.name, signals, hello.sample_rate))

    def fitted(self, hello: Hello) -> list[tuple[Signal, ChannelScale]]:
        """Return the channels that the device has, in order."""
        pairs = zip(self.spec.stream.signals, hello.channels, strict=True)
        return [(signal, channel) for signal, channel in pairs if channel.fitted]

    def command_scales(self, hello: Hello) -> list[ChannelScale]:
        """Return the scales of the commands, in order."""
        scales = {signal.name: channel for signal, channel in self.fitted(hello)}
        return [scales[command.name] for command in self.spec.commands]


class Scaler:
    """Converts raw samples of one device to SI units, and unwraps its counters."""

    def __init__(self, rig: SerialRig, hello: Hello) -> None:
        fitted = rig.fitted(hello)
        self.width = len(fitted)
        self._scale = np.array([channel.scale for _, channel in fitted])
        self._zero = np.array([channel.zero for _, channel in fitted])
        self._counters = [column for column, (signal, _) in enumerate(fitted) if signal.name in rig.counters]
        self._counts: dict[int, int] = {}

    def values(self, raw: NDArray[np.uint16]) -> FloatArray:
        """Return the SI values (n, width) of raw numbers (n, width)."""
        counts = raw.astype(np.float64)
        for column in self._counters:
            counts[:, column] = self._unwrap(column, raw[:, column])
        return np.asarray((counts - self._zero) * self._scale)

    def _unwrap(self, column: int, raw: NDArray[np.uint16]) -> FloatArray:
        previous = self._counts.get(column, int(raw[0])) % COUNTER_RANGE
        wrapped: IntArray = np.r_[previous, raw.astype(np.int64)]
        steps: IntArray = wrapped[1:] - wrapped[:-1]
        # between two samples a counter moves by less than half its range
        steps = np.mod(steps + COUNTER_RANGE // 2, COUNTER_RANGE) - COUNTER_RANGE // 2
        unwrapped = self._counts.get(column, int(raw[0])) + np.cumsum(steps)
        self._counts[column] = int(unwrapped[-1])
        return np.asarray(unwrapped, dtype=np.float64)


def info_of(hello: Hello, fitted: Sequence[tuple[Signal, ChannelScale]]) -> DeviceInfo:
    """Return the identity and calibration of the device of a HELLO, with its fitted channels."""
    calibration = {"sample_rate": hello.sample_rate, "speed": hello.speed}
    for signal, channel in fitted:
        calibration[f"{signal.name}_scale"] = channel.scale
        calibration[f"{signal.name}_offset"] = -channel.zero * channel.scale
    return DeviceInfo(
        firmware=".".join(str(part) for part in hello.firmware) + f"+{hello.build_hash:08x}",
        serial=hello.serial,
        boot_id=hello.boot_id,
        speed=hello.speed,
        calibration=calibration,
    )
