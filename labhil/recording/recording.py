"""Data of a recording: streams of samples, events, clocks. ``reader.py`` reads it from a file."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from labhil.errors import RecordingError, suggestion
from labhil.recording.clock import ClockFit
from labhil.recording.clock_faults import ClockFault
from labhil.recording.device_clocks import (
    ClockOffset,
    DeviceClock,
    estimate_device_clock,
    pairwise_offsets,
)
from labhil.recording.rig_attachments import attached_rig
from labhil.recording.stamps import HOST_CLOCK, Stamps
from labhil.rig import RigFile
from labhil.signals import Direction, FloatArray, IntArray, Stream
from labhil.terminal import printable_name

IMPORT, TIME_COLUMN = "import", "time_column"
"""Metadata of an imported table, and their key for the name of its time."""


@dataclass(frozen=True)
class StreamData:
    """Samples of a stream.

    Attributes:
        device: name of the device.
        stream: declaration of the stream.
        seq: sequence numbers, (n,).
        t_acq_ns: the host's clock, Unix time, (n,).
        t_hw_ns: the device's clock, (n,).
        values: samples, (n, stream.width), SI units.
        t: time of analysis, (n,) s of the device's world: the device's clock, the same for all its streams,
            0 at the recording's first sample. :attr:`t_common` compares devices.
        lost: number of lost samples.
        speed: seconds of the device's world per second of the host.
        metadata: metadata of the stream.
        clock: relation of the device's clock to the host's.
        copies: number of dropped exact copies of samples.
        moved: number of samples that were behind later ones in the file.
        clock_faults: faults of the stamps.
        clock_start: host time of ``t`` = 0, s after the first stamp of the recording.
    """

    device: str
    stream: Stream
    seq: IntArray
    t_acq_ns: IntArray
    t_hw_ns: IntArray
    values: FloatArray
    t: FloatArray
    lost: int
    speed: float
    metadata: Mapping[str, str]
    clock: ClockFit
    copies: int = 0
    moved: int = 0
    clock_faults: tuple[ClockFault, ...] = ()
    clock_start: float = 0.0

    def __len__(self) -> int:
        return len(self.seq)

    @property
    def stamps(self) -> Stamps:
        """Stamps of the samples, with facts about their clocks."""
        steady = HOST_CLOCK in self.metadata
        return Stamps(self.seq, self.t_hw_ns, self.t_acq_ns, self.stream.rate, self.speed, steady)

    @property
    def t_common(self) -> FloatArray:
        """Common time of all devices, (n,) s of the host since the recording's origin.

        The device's clock is mapped to the host's, without the jitter and steps of the host's stamps. Without
        a map it is the host's stamps.
        """
        clock_map = self.clock.map
        if clock_map is None:
            return self.t / self.speed
        return clock_map.steady_host(clock_map.elapsed(self.t_hw_ns)) - self.clock_start

    def __getitem__(self, name: str) -> FloatArray:
        """Values of a signal, (n,), or (n, width) of a vector; RecordingError if there is no such signal."""
        names = self.stream.names()
        if name not in names:
            raise RecordingError(
                f"stream /{self.device}/{self.stream.name}: no signal {name!r}{suggestion(name, names)}; "
                f"found: {', '.join(names)}"
            )
        columns = self.values[:, self.stream.columns_of(name)]
        return columns[:, 0] if columns.shape[1] == 1 else columns

    @property
    def is_measured(self) -> bool:
        """Whether the device stamped the samples; the host stamps requested values."""
        return any(signal.direction is not Direction.REQUESTED for signal in self.stream.signals)

    @property
    def rate(self) -> float:
        """Measured rate with lost samples, Hz; the nominal rate for fewer than two samples."""
        if len(self) < 2 or not self.t[-1] > self.t[0]:
            return self.stream.rate
        return float((self.seq[-1] - self.seq[0]) / (self.t[-1] - self.t[0]))


@dataclass(frozen=True, slots=True)
class Event:
    """An event at the Unix time ``t_ns`` of the host, which is ``t`` (s) in the time of analysis."""

    device: str
    topic: str
    t_ns: int
    t: float
    body: Mapping[str, Any]


@dataclass(frozen=True)
class Recording:
    """A recording.

    Attributes:
        path: the file.
        sha256: its SHA-256.
        streams: streams of samples.
        rig: the attached rig file, if there is one.
        attachments: attachments by name.
        metadata: metadata by name.
        events: events in the order of time.
        complete: whether the file is undamaged and has an end.
        damage: what is damaged or missing, for messages.
        foreign: channels of other programs with their encodings, which are not read.
        runs: number of runs in the file, of which this is one.
        ambiguous: names of several different attachments; a rig file among them is not used.
    """

    path: Path
    sha256: str
    streams: tuple[StreamData, ...]
    rig: RigFile | None
    attachments: Mapping[str, bytes]
    metadata: Mapping[str, Mapping[str, str]]
    events: tuple[Event, ...]
    complete: bool
    damage: str = ""
    foreign: tuple[str, ...] = ()
    runs: int = 1
    ambiguous: tuple[str, ...] = ()

    @property
    def time_column(self) -> str:
        """Name of the time in the table from which this was imported; otherwise "t"."""
        return self.metadata.get(IMPORT, {}).get(TIME_COLUMN, "t")

    def of_device(self, name: str | None) -> Recording:
        """Select the streams and the rig file of a device.

        Args:
            name: the device; None for all devices.

        Returns:
            The recording of this device.

        Raises:
            RecordingError: There is no such device.
        """
        if name is None:
            return self
        devices = list(dict.fromkeys(data.device for data in self.streams))
        if name not in devices:
            raise RecordingError(
                f"{self.path}: expected samples of the device {name!r}{suggestion(name, devices)}; "
                f"found: {', '.join(map(printable_name, devices)) or 'no device at all'}"
            )
        streams = tuple(data for data in self.streams if data.device == name)
        device_rig = attached_rig(self.path, without_ambiguous(self.attachments, self.ambiguous), name)
        return replace(self, streams=streams, rig=self.rig if device_rig is None else device_rig)

    def stream_with(self, *names: str) -> StreamData:
        """Find the only stream with all these signals; RecordingError if there is none or several."""
        matching = [data for data in self.streams if set(names) <= set(data.stream.names())]
        if len(matching) == 1:
            return matching[0]
        wanted = " and ".join(names)
        if matching:
            where = ", ".join(printable_name(f"/{data.device}/{data.stream.name}") for data in matching)
            raise RecordingError(f"{self.path}: expected one stream with {wanted}, found several: {where}")
        available = [name for data in self.streams for name in data.stream.names()]
        near = "".join(suggestion(name, available) for name in names if name not in available)
        raise RecordingError(
            f"{self.path}: expected a stream with {wanted}{near}; found: {self.describe_streams()}"
        )

    def describe_missing_streams(self) -> str:
        """Describe a recording without streams, and what was expected, for messages."""
        expected = "a topic /<device>/<stream> as `labhil run` and `labhil import` write it"
        if not self.foreign:
            return f"no streams at all; expected {expected}"
        bag = any(name.endswith("(cdr)") for name in self.foreign)
        hint = "; a ROS 2 bag becomes a recording with `labhil import`" if bag else ""
        return (
            f"no stream of labhil, but channels of another program: {', '.join(self.foreign)}; "
            f"expected {expected}{hint}"
        )

    def describe_streams(self) -> str:
        """List the streams with their signals, and foreign channels, for messages."""
        if not self.streams:
            return self.describe_missing_streams()
        descriptions = [
            f"{topic_of(data.device, data.stream)}: {', '.join(data.stream.names())}" for data in self.streams
        ]
        others = [f"of another program: {', '.join(self.foreign)}"] if self.foreign else []
        return "; ".join(descriptions + others)

    def warnings(self) -> list[str]:
        """List damage, lost samples and clock faults, in lines for users."""
        lines = [f"{self.path}: read as far as it goes: {self.damage}"] if self.damage else []
        if self.ambiguous:
            names = ", ".join(map(printable_name, self.ambiguous))
            lines.append(f"{self.path}: holds several different attachments of one name: {names}")
        for data in self.streams:
            name = topic_of(data.device, data.stream)[1:]
            counts = {
                f"samples of {name} were lost": data.lost,
                f"exact copies of samples of {name} were dropped": data.copies,
                f"samples of {name} were behind later ones, and were put in order": data.moved,
            }
            lines += [f"{self.path}: {count} {what}" for what, count in counts.items() if count]
            lines += [f"{self.path}: {name}: {fault.statement}" for fault in data.clock_faults]
        return lines

    @property
    def clocks(self) -> Mapping[str, DeviceClock]:
        """Clock of each device against the host's, from the stamps of its first stream."""
        clocks: dict[str, DeviceClock] = {}
        for data in self.streams:
            if data.device not in clocks and data.is_measured:
                clock = estimate_device_clock(data.stamps, data.clock)
                if clock is not None:
                    clocks[data.device] = clock
        return clocks

    @property
    def clock_offsets(self) -> Mapping[tuple[str, str], ClockOffset]:
        """Offset between the clocks of each pair of devices of equal speed."""
        return pairwise_offsets(self.clocks)

    @property
    def duration(self) -> float:
        """Time of analysis from the first sample to the last, s."""
        return max((float(data.t[-1]) for data in self.streams if len(data)), default=0.0)


def without_ambiguous(attachments: Mapping[str, bytes], ambiguous: Collection[str]) -> dict[str, bytes]:
    """Attachments without those with ambiguous names."""
    return {name: content for name, content in attachments.items() if name not in ambiguous}


def topic_of(device: str, stream: Stream) -> str:
    """Topic of a stream, for messages."""
    return f"/{printable_name(device)}/{printable_name(stream.name)}"
