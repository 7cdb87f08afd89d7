"""MCAP in, numpy out."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel

from labhil.bounds import ImplausibleError
from labhil.codec import stream_from_json
from labhil.documents import parse_json
from labhil.errors import ProtocolError, RecordingError, suggestion
from labhil.recording.chunks import Contents, is_mcap, scan
from labhil.recording.clock import ClockFit, fit_clock
from labhil.recording.clock_faults import ClockFault, clock_faults
from labhil.recording.device_clocks import (
    ClockOffset,
    DeviceClock,
    device_clock,
    offsets_between,
)
from labhil.recording.event_schemas import published
from labhil.recording.mapped import FileBytes, bytes_of, sha256_of
from labhil.recording.rig_attachments import attached_rig
from labhil.recording.runs import MixedRunsError, Run, choose_run, runs_of
from labhil.recording.samples import Samples
from labhil.recording.stamps import HOST_CLOCK, Stamps, in_time_of
from labhil.rig import RigFile
from labhil.signals import Batch, Direction, FloatArray, IntArray, Stream
from labhil.terminal import printable_name

IMPORT, TIME_COLUMN = "import", "time_column"
"""The metadata of an imported table, and what its column of the time is called there."""

LARGEST_SPEED = 1e6
"""Seconds of a device's world in one of the host, at most: no simulation is faster."""

LARGEST_STAMP = 1 << 62
"""ns or counts; as Unix time it is the year 2116, and differences of such stamps fit into 64 bits."""


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
        found = self.clock.map
        if found is None:
            return self.t / self.speed
        return found.steady_host(found.elapsed(self.t_hw_ns)) - self.clock_start

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
        own = attached_rig(self.path, _without(self.attachments, self.ambiguous), name)
        return replace(self, streams=streams, rig=self.rig if own is None else own)

    def stream_with(self, *names: str) -> StreamData:
        """Return the stream that has all these signals; RecordingError says what is there otherwise."""
        found = [data for data in self.streams if set(names) <= set(data.stream.names())]
        if len(found) == 1:
            return found[0]
        wanted = " and ".join(names)
        if found:
            where = ", ".join(printable_name(f"/{data.device}/{data.stream.name}") for data in found)
            raise RecordingError(f"{self.path}: expected one stream with {wanted}, found several: {where}")
        here = [name for data in self.streams for name in data.stream.names()]
        near = "".join(suggestion(name, here) for name in names if name not in here)
        raise RecordingError(f"{self.path}: expected a stream with {wanted}{near}; found: {self.described()}")

    def no_streams(self) -> str:
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

    def described(self) -> str:
        """Which streams there are with which signals, and which channels of other programs, for messages."""
        if not self.streams:
            return self.no_streams()
        found = [
            f"{_shown(data.device, data.stream)}: {', '.join(data.stream.names())}" for data in self.streams
        ]
        others = [f"of another program: {', '.join(self.foreign)}"] if self.foreign else []
        return "; ".join(found + others)

    def losses(self) -> list[str]:
        """What is not as it should be, a line each: no end, damaged parts, lost samples, faulty clocks."""
        lines = [f"{self.path}: read as far as it goes: {self.damage}"] if self.damage else []
        if self.ambiguous:
            names = ", ".join(map(printable_name, self.ambiguous))
            lines.append(f"{self.path}: holds several different attachments of one name: {names}")
        for data in self.streams:
            name = _shown(data.device, data.stream)[1:]
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
        found: dict[str, DeviceClock] = {}
        for data in self.streams:
            if data.device not in found and _is_measured(data):
                clock = device_clock(data.stamps, data.clock)
                if clock is not None:
                    found[data.device] = clock
        return found

    @property
    def clock_offsets(self) -> Mapping[tuple[str, str], ClockOffset]:
        """By how much one device's clock was ahead of another's, for each pair of devices of one speed."""
        return offsets_between(self.clocks)

    @property
    def duration(self) -> float:
        """Seconds (of analysis time) from the first sample to the last."""
        return max((float(data.t[-1]) for data in self.streams if len(data)), default=0.0)


def read_recordings(paths: Sequence[Path], run: int | None = None) -> list[Recording]:
    """Read several recordings, of each the ``run`` as :func:`read_recording`; one run is taken as it is.

    RecordingError when none of them holds that many.
    """
    found = [_read(path, run) for path in paths]
    most = max((recording.runs for recording in found), default=1)
    if run is not None and found and not 1 <= run <= most:
        names = ", ".join(str(path) for path in paths)
        many = "one run of each stream" if most == 1 else f"{most} runs of a stream"
        raise RecordingError(f"run {run}: expected a number from 1 to {most}, found {many} in {names}")
    return found


def read_recording(path: Path, run: int | None = None) -> Recording:
    """Read a recording; one without an end is read as far as it goes.

    Args:
        path: The file.
        run: Which one, from 1, of several runs of one stream in the file, as merged files have them.

    Raises:
        RecordingError: There is no such file, it is no MCAP file, or it is damaged beyond use; it holds
            several runs and ``run`` chooses none of them.
    """
    return read_recordings([path], run)[0]


def _read(path: Path, run: int | None) -> Recording:
    data, samples = _bytes_of(path), Samples()
    try:
        contents = scan(data, samples.take)
    except ImplausibleError as error:
        raise RecordingError(f"{path}: {error}; `labhil recover` saves what is plausible of it") from error
    topics = _topics(path, contents, samples)
    untimed, span = choose_run(path, topics, run)
    origin_ns = min((int(s.t_acq_ns[0]) for s in untimed if len(s)), default=0)
    streams = _timed(untimed, origin_ns)
    return Recording(
        path=path,
        sha256=sha256_of(data),
        streams=streams,
        rig=attached_rig(path, _without(contents.attachments, contents.ambiguous)),
        attachments=contents.attachments,
        metadata=contents.metadata,
        events=tuple(event for event in _events(contents, origin_ns, streams) if event.t_ns in span),
        complete=not contents.damage,
        damage=contents.damage,
        foreign=_foreign(contents),
        runs=max((len(topic) for topic in topics), default=1),
        ambiguous=tuple(sorted(contents.ambiguous)),
    )


def _without(attachments: Mapping[str, bytes], ambiguous: Collection[str]) -> dict[str, bytes]:
    return {name: content for name, content in attachments.items() if name not in ambiguous}


def _foreign(contents: Contents) -> tuple[str, ...]:
    return tuple(
        f"{printable_name(channel.topic)} ({printable_name(channel.message_encoding) or 'no encoding'})"
        for channel in contents.channels.values()
        if "labhil.stream" not in channel.metadata and "device" not in channel.metadata
    )


def _bytes_of(path: Path) -> FileBytes:
    try:
        data = bytes_of(path)
    except OSError as error:
        part = Path(f"{path}.part")
        beside = f"; beside it lies {part}, which was not finished" if part.exists() else ""
        raise RecordingError(f"{path}: cannot be read: {error.strerror}{beside}") from error
    if not data:
        raise RecordingError(f"{path}: expected an MCAP recording, found an empty file")
    if not is_mcap(data):
        raise RecordingError(
            f"{path}: expected an MCAP recording, found a file that begins with {data[:8]!r}; "
            "tables become recordings with `labhil import`"
        )
    return data


def _topics(path: Path, contents: Contents, samples: Samples) -> list[list[StreamData]]:
    """Decode the runs of each topic of ours, by time; their times of analysis are not known yet."""
    channels: dict[tuple[str, Stream], list[tuple[Mapping[str, str], Batch]]] = {}
    for channel in contents.channels.values():
        if "labhil.stream" not in channel.metadata:
            continue
        try:
            stream = stream_from_json(channel.metadata["labhil.stream"])
            batch = samples.batch(channel, contents.messages[channel.id])
            _check_stamps(batch)
            _speed(channel.metadata)
            device = _device(channel)
        except (ProtocolError, ValueError) as error:
            raise RecordingError(f"{path}: {printable_name(channel.topic)}: {error}") from error
        channels.setdefault((device, stream), []).append((channel.metadata, batch))
    topics: dict[tuple[str, str], list[StreamData]] = {}
    for (device, stream), found in channels.items():
        filled = [one for one in found if len(one[1])] or found[:1]
        try:
            runs = runs_of([batch for _, batch in filled])
        except MixedRunsError as error:
            raise RecordingError(f"{path}: {_shown(device, stream)}: {error}") from error
        told = filled[0][0]
        topics.setdefault((device, stream.name), []).extend(
            _untimed(device, stream, told, run) for run in runs
        )
    return list(topics.values())


def _untimed(device: str, stream: Stream, metadata: Mapping[str, str], run: Run) -> StreamData:
    batch = run.batch
    untimed = ClockFit(np.zeros(len(batch)), 0.0, 0.0, 0, device_clock=False)
    return StreamData(
        device=device,
        stream=stream,
        seq=batch.seq,
        t_acq_ns=batch.t_acq_ns,
        t_hw_ns=batch.t_hw_ns,
        values=batch.values,
        t=untimed.t,
        lost=holes(batch.seq),
        speed=_speed(metadata),
        metadata={key: value for key, value in metadata.items() if not key.startswith("labhil.")},
        clock=untimed,
        copies=run.copies,
        moved=run.moved,
    )


def _shown(device: str, stream: Stream) -> str:
    """The topic of a stream, for messages."""
    return f"/{printable_name(device)}/{printable_name(stream.name)}"


def _speed(metadata: Mapping[str, str]) -> float:
    speed = float(metadata.get("speed", "1"))
    if not 1.0 / LARGEST_SPEED < speed < LARGEST_SPEED:
        raise ValueError(f"expected a speed between 1/{LARGEST_SPEED:g} and {LARGEST_SPEED:g}, found {speed}")
    return speed


def _device(channel: Channel) -> str:
    """The device of a channel: as its metadata say, or its topic, which is /device/stream."""
    device = channel.metadata.get("device")
    if device:
        return device
    root, _, rest = channel.topic.partition("/")
    device, _, stream = rest.partition("/")
    if root or not device or not stream:
        raise ValueError("expected a topic /device/stream, or the metadata `device`")
    return device


def _check_stamps(batch: Batch) -> None:
    """ValueError for stamps whose differences would not fit into 64 bits: no clock shows them."""
    for name, stamps in (("seq", batch.seq), ("t_acq_ns", batch.t_acq_ns), ("t_hw_ns", batch.t_hw_ns)):
        wrong = np.flatnonzero((stamps < -LARGEST_STAMP) | (stamps > LARGEST_STAMP))
        if len(wrong):
            raise ValueError(
                f"message {wrong[0]}: expected a {name} within ±{LARGEST_STAMP}, found {stamps[wrong[0]]}"
            )


def holes(seq: IntArray) -> int:
    """How many numbers are missing in a sequence that should count up by one."""
    return int(np.maximum(np.diff(seq) - 1, 0).sum())


def _timed(streams: list[StreamData], origin_ns: int) -> tuple[StreamData, ...]:
    """Give all streams of a device its own time, which is 0 at the first sample of them all."""
    clocks = {id(data): _fit(data, origin_ns) for data in streams}
    mains = _mains(streams, clocks)
    found = [
        in_time_of(data.stamps, clocks[id(data)], mains.get(data.device), measured=_is_measured(data))
        for data in streams
    ]
    pairs = list(zip(streams, found, strict=True))
    start = min((float(clock.t[0]) / data.speed for data, clock in pairs if len(data)), default=0.0)
    timed = []
    for data, clock in pairs:
        t = clock.t - start * data.speed
        # a stream that borrows a device's clock borrows its faults, which are told once
        own = len(data) and (mains.get(data.device) is None or clock is clocks[id(data)])
        faults = clock_faults(data.stamps, clock, t) if own and _is_measured(data) else ()
        timed.append(replace(data, t=t, clock=clock, clock_faults=faults, clock_start=start))
    return tuple(timed)


def _fit(data: StreamData, origin_ns: int) -> ClockFit:
    return fit_clock(data.t_hw_ns, data.t_acq_ns, origin_ns, data.speed, steady=data.stamps.keep_rate)


def _is_measured(data: StreamData) -> bool:
    """Whether the device stamped the samples; what was asked of it is stamped by its host."""
    return any(signal.direction is not Direction.REQUESTED for signal in data.stream.signals)


def _mains(streams: list[StreamData], clocks: Mapping[int, ClockFit]) -> dict[str, ClockFit]:
    """The clock of each device that has one: that of its longest stream."""
    found: dict[str, ClockFit] = {}
    for data in sorted(streams, key=len, reverse=True):
        clock = clocks[id(data)]
        if clock.device_clock and clock.map is not None and _is_measured(data):
            found.setdefault(data.device, clock)
    return found


def _events(contents: Contents, origin_ns: int, streams: Sequence[StreamData]) -> tuple[Event, ...]:
    """What happened, in the time of the device it happened to; of a run with one device, in that one's."""
    devices = {data.device: data for data in streams if data.clock.map is not None and len(data)}
    only = next(iter(devices.values())) if len({data.device for data in streams}) == 1 and devices else None
    start = next((data.clock_start for data in streams), 0.0)
    events = []
    for channel in contents.channels.values():
        if channel.message_encoding != "json":
            continue
        messages = contents.messages[channel.id]
        for t_ns, payload in zip(messages.log_times().tolist(), messages.payloads(), strict=True):
            device, _, topic = channel.topic.strip("/").partition("/")
            host = (t_ns - origin_ns) * 1e-9
            data = devices.get(device, only)
            t = host - start
            if data is not None and data.clock.map is not None:
                found = data.clock.map
                begin = float(found.steady_host(np.zeros(1))[0])
                t = (found.device(host) + begin - start) * data.speed
            events.append(Event(device, topic, t_ns, t, published(_body(payload), t_ns)))
    return tuple(sorted(events, key=lambda event: event.t_ns))


def _body(payload: bytes) -> Mapping[str, Any]:
    try:
        body = parse_json(payload)
    except ValueError:
        body = payload.decode("utf-8", "replace")
    return body if isinstance(body, dict) else {"text": str(body)}
