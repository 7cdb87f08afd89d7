"""What a recording holds, once it has been read: streams of samples, events, clocks."""

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
"""The metadata of an imported table, and what its column of the time is called there."""


@dataclass(frozen=True)
class StreamData:
    """All samples of one stream.

    ``seq``, ``t_acq_ns`` (host, Unix time) and ``t_hw_ns`` (the device's clock) are int64 of shape (n,);
    ``values`` has shape (n, stream.width), SI units; ``t`` (n,) is the time of analysis in seconds of the
    device's world: the device's own clock at its own rate, for all streams of a device the same, set where
    it begins so that it is 0 at the recording's first sample. What compares devices takes :attr:`t_common`.
    ``lost`` counts the holes in ``seq``; ``speed`` is how many seconds of that world passed in a second of
    the host. Exact ``copies`` of samples were dropped, ``moved`` ones stood behind later ones in the file.
    ``clock_faults`` say what is wrong with the stamps.
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
        """The stamps of the samples, with what is known of the clocks that made them."""
        steady = HOST_CLOCK in self.metadata
        return Stamps(self.seq, self.t_hw_ns, self.t_acq_ns, self.stream.rate, self.speed, steady)

    @property
    def t_common(self) -> FloatArray:
        """Time that all devices of a recording share, (n,): s of the host since the recording's origin.

        The device's clock mapped by its rate against the host's, without the jitter and the steps of the
        host's stamps; these themselves where there is no such map.
        """
        clock_map = self.clock.map
        if clock_map is None:
            return self.t / self.speed
        return clock_map.steady_host(clock_map.elapsed(self.t_hw_ns)) - self.clock_start

    def __getitem__(self, name: str) -> FloatArray:
        """Values of the signal ``name``: shape (n,), or (n, width) for a vector.

        RecordingError names the signals that are there.
        """
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
        """Whether the device stamped the samples; what was asked of it is stamped by its host."""
        return any(signal.direction is not Direction.REQUESTED for signal in self.stream.signals)

    @property
    def rate(self) -> float:
        """Measured rate in Hz (lost samples counted in); the nominal one for fewer than two samples."""
        if len(self) < 2 or not self.t[-1] > self.t[0]:
            return self.stream.rate
        return float((self.seq[-1] - self.seq[0]) / (self.t[-1] - self.t[0]))


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at ``t_ns`` (host, Unix time), which is ``t`` in the time of analysis."""

    device: str
    topic: str
    t_ns: int
    t: float
    body: Mapping[str, Any]


@dataclass(frozen=True)
class Recording:
    """A recording as it stands in its file.

    ``complete`` is False when the file has no end (its recorder was killed) or a part of it is damaged;
    ``damage`` then says what is missing. ``rig`` is the rig file that was attached, if one was. ``foreign``
    names the channels of other programs, with their encoding; their samples are not read. Where the file
    holds several ``runs`` of one stream, this is one of them. ``ambiguous`` names attachments of which it
    holds several: a rig file among them is not used.
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
        """What the column of the time was called in the table that this was imported from; else "t"."""
        return self.metadata.get(IMPORT, {}).get(TIME_COLUMN, "t")

    def of_device(self, name: str | None) -> Recording:
        """Return what this recording holds of one device, with that device's rig file; all of it for None.

        RecordingError names the devices that are there.
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
        own = attached_rig(self.path, unambiguous(self.attachments, self.ambiguous), name)
        return replace(self, streams=streams, rig=self.rig if own is None else own)

    def stream_with(self, *names: str) -> StreamData:
        """Return the stream that has all these signals; RecordingError says what is there otherwise."""
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
        """What is found where no stream of ours is, and what was expected, for messages."""
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
        """Which streams there are with which signals, and which channels of other programs, for messages."""
        if not self.streams:
            return self.describe_missing_streams()
        descriptions = [
            f"{topic_of(data.device, data.stream)}: {', '.join(data.stream.names())}" for data in self.streams
        ]
        others = [f"of another program: {', '.join(self.foreign)}"] if self.foreign else []
        return "; ".join(descriptions + others)

    def warnings(self) -> list[str]:
        """What is not as it should be, a line each: no end, damaged parts, lost samples, faulty clocks."""
        lines = [f"{self.path}: read as far as it goes: {self.damage}"] if self.damage else []
        if self.ambiguous:
            names = ", ".join(map(printable_name, self.ambiguous))
            lines.append(f"{self.path}: holds several different attachments of one name: {names}")
        for data in self.streams:
            name = topic_of(data.device, data.stream)[1:]
            counts = {
                f"samples of {name} were lost": data.lost,
                f"exact copies of samples of {name} were dropped": data.copies,
                f"samples of {name} stood behind later ones, and were put in order": data.moved,
            }
            lines += [f"{self.path}: {count} {what}" for what, count in counts.items() if count]
            lines += [f"{self.path}: {name}: {fault.statement}" for fault in data.clock_faults]
        return lines

    @property
    def clocks(self) -> Mapping[str, DeviceClock]:
        """How each device's clock ran against the host's, from the stamps of its first stream."""
        clocks: dict[str, DeviceClock] = {}
        for data in self.streams:
            if data.device not in clocks and data.is_measured:
                clock = estimate_device_clock(data.stamps, data.clock)
                if clock is not None:
                    clocks[data.device] = clock
        return clocks

    @property
    def clock_offsets(self) -> Mapping[tuple[str, str], ClockOffset]:
        """By how much one device's clock was ahead of another's, for each pair of devices of one speed."""
        return pairwise_offsets(self.clocks)

    @property
    def duration(self) -> float:
        """Seconds (of analysis time) from the first sample to the last."""
        return max((float(data.t[-1]) for data in self.streams if len(data)), default=0.0)


def unambiguous(attachments: Mapping[str, bytes], ambiguous: Collection[str]) -> dict[str, bytes]:
    """Attachments but for those of whose names a file holds several."""
    return {name: content for name, content in attachments.items() if name not in ambiguous}


def topic_of(device: str, stream: Stream) -> str:
    """The topic of a stream, for messages."""
    return f"/{printable_name(device)}/{printable_name(stream.name)}"
