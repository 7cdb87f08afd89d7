"""MCAP in, numpy out."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel

from labhil.bounds import ImplausibleError
from labhil.codec import Codec, stream_from_json
from labhil.documents import parse_json
from labhil.errors import ProtocolError, RecordingError, RigFileError, suggestion
from labhil.recording.chunks import Contents, Messages, is_mcap, scan
from labhil.recording.clock import ClockFit, fit_clock, keeps_its_rate
from labhil.recording.device_clocks import (
    ClockOffset,
    DeviceClock,
    clocks_from_metadata,
    offsets_between,
)
from labhil.rig import RigFile, parse_rig
from labhil.signals import Batch, FloatArray, IntArray, Stream
from labhil.terminal import printable_name

RIG_ATTACHMENT = "rig.toml"

LARGEST_SPEED = 1e6
"""Seconds of a device's world in one of the host, at most: no simulation is faster."""

LARGEST_STAMP = 1 << 62
"""ns or counts; as Unix time it is the year 2116, and differences of such stamps fit into 64 bits."""


@dataclass(frozen=True)
class StreamData:
    """All samples of one stream.

    ``seq``, ``t_acq_ns`` (host, Unix time) and ``t_hw_ns`` (the device's clock) are int64 of shape (n,);
    ``values`` has shape (n, stream.width), SI units; ``t`` (n,) is the time of analysis in seconds of the
    device's world: its clock mapped onto the host's, 0 at the recording's first sample. ``lost`` counts
    the holes in ``seq``; ``speed`` is how many seconds of that world passed in a second of the host.
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

    def __len__(self) -> int:
        return len(self.seq)

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
    names the channels of other programs, with their encoding; their samples are not read.
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
        own = self.attachments.get(f"rig.{name}.toml")
        rig = self.rig if own is None else _parsed_rig(self.path, own)
        return replace(self, streams=streams, rig=rig)

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
        what = "; ".join(
            f"{printable_name(f'/{data.device}/{data.stream.name}')}: {', '.join(data.stream.names())}"
            for data in self.streams
        )
        raise RecordingError(
            f"{self.path}: expected a stream with {wanted}{near}; found: {what or self.no_streams()}"
        )

    def no_streams(self) -> str:
        """What is found where no stream of ours is, for messages."""
        if not self.foreign:
            return "no streams at all"
        return f"no stream of labhil, but channels of another program: {', '.join(self.foreign)}"

    def losses(self) -> list[str]:
        """What is not there that should be, a line each: the end of the file, damaged parts, lost samples."""
        lines = [f"{self.path}: read as far as it goes: {self.damage}"] if self.damage else []
        return lines + [
            f"{self.path}: {data.lost} samples of {printable_name(data.device)}/"
            f"{printable_name(data.stream.name)} were lost"
            for data in self.streams
            if data.lost
        ]

    @property
    def clocks(self) -> Mapping[str, DeviceClock]:
        """How each device's clock ran against the host's, as written at the recording's end."""
        return clocks_from_metadata(self.metadata)

    @property
    def clock_offsets(self) -> Mapping[tuple[str, str], ClockOffset]:
        """By how much one device's clock was ahead of another's, for each pair of devices of one speed."""
        return offsets_between(self.clocks)

    @property
    def duration(self) -> float:
        """Seconds (of analysis time) from the first sample to the last."""
        return max((float(data.t[-1]) for data in self.streams if len(data)), default=0.0)


def read_recording(path: Path) -> Recording:
    """Read a recording; one without an end is read as far as it goes.

    RecordingError when there is no such file, when it is no MCAP file, or when it is damaged beyond use.
    """
    data = _bytes_of(path)
    try:
        contents = scan(data)
    except ImplausibleError as error:
        raise RecordingError(f"{path}: {error}; `labhil recover` saves what is plausible of it") from error
    streams = _streams(path, contents)
    origin_ns = min((int(s.t_acq_ns[0]) for s in streams if len(s)), default=0)
    return Recording(
        path=path,
        sha256=hashlib.sha256(data).hexdigest(),
        streams=_timed(streams, origin_ns),
        rig=_rig(path, contents),
        attachments=contents.attachments,
        metadata=contents.metadata,
        events=_events(contents, origin_ns, {data.device: data.speed for data in streams}),
        complete=not contents.damage,
        damage=contents.damage,
        foreign=_foreign(contents),
    )


def _foreign(contents: Contents) -> tuple[str, ...]:
    return tuple(
        f"{printable_name(channel.topic)} ({printable_name(channel.message_encoding) or 'no encoding'})"
        for channel in contents.channels.values()
        if "labhil.stream" not in channel.metadata and "device" not in channel.metadata
    )


def _bytes_of(path: Path) -> bytes:
    try:
        data = path.read_bytes()
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


def _streams(path: Path, contents: Contents) -> list[StreamData]:
    """Decode all streams of ours; their times of analysis are not known yet."""
    streams = []
    for channel in contents.channels.values():
        if "labhil.stream" not in channel.metadata:
            continue
        try:
            stream = stream_from_json(channel.metadata["labhil.stream"])
            batch = _decode(Codec(stream), contents.messages[channel.id])
            _check_stamps(batch)
            speed = _speed(channel.metadata)
            device = _device(channel)
        except (ProtocolError, ValueError) as error:
            raise RecordingError(f"{path}: {printable_name(channel.topic)}: {error}") from error
        untimed = ClockFit(np.zeros(len(batch)), 0.0, 0.0, 0, device_clock=False)
        told = {key: value for key, value in channel.metadata.items() if not key.startswith("labhil.")}
        streams.append(
            StreamData(
                device=device,
                stream=stream,
                seq=batch.seq,
                t_acq_ns=batch.t_acq_ns,
                t_hw_ns=batch.t_hw_ns,
                values=batch.values,
                t=untimed.t,
                lost=holes(batch.seq),
                speed=speed,
                metadata=told,
                clock=untimed,
            )
        )
    return streams


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


def _decode(codec: Codec, messages: Messages) -> Batch:
    rows = messages.rows(codec.size)
    return codec.decode(messages.payloads()) if rows is None else codec.decode_rows(rows)


def holes(seq: IntArray) -> int:
    """How many numbers are missing in a sequence that should count up by one."""
    return int(np.maximum(np.diff(seq) - 1, 0).sum())


def _timed(streams: list[StreamData], origin_ns: int) -> tuple[StreamData, ...]:
    """Give all streams one time, which is 0 at the first sample of them all."""
    clocks = [
        fit_clock(
            data.t_hw_ns,
            data.t_acq_ns,
            origin_ns,
            data.speed,
            steady=keeps_its_rate(data.t_hw_ns, data.seq, data.stream.rate),
        )
        for data in streams
    ]
    pairs = list(zip(streams, clocks, strict=True))
    start = min((float(clock.t[0]) / data.speed for data, clock in pairs if len(data)), default=0.0)
    return tuple(replace(data, t=clock.t - start * data.speed, clock=clock) for data, clock in pairs)


def _rig(path: Path, contents: Contents) -> RigFile | None:
    text = contents.attachments.get(RIG_ATTACHMENT)
    return None if text is None else _parsed_rig(path, text)


def _parsed_rig(path: Path, text: bytes) -> RigFile:
    try:
        return parse_rig(text.decode("utf-8"), path.parent / RIG_ATTACHMENT)
    except (UnicodeDecodeError, RigFileError) as error:
        raise RecordingError(f"{path}: its attached rig file cannot be used: {error}") from error


def _events(contents: Contents, origin_ns: int, speeds: Mapping[str, float]) -> tuple[Event, ...]:
    events = []
    for channel in contents.channels.values():
        if channel.message_encoding != "json":
            continue
        messages = contents.messages[channel.id]
        for t_ns, payload in zip(messages.log_times().tolist(), messages.payloads(), strict=True):
            device, _, topic = channel.topic.strip("/").partition("/")
            t = (t_ns - origin_ns) * 1e-9 * speeds.get(device, 1.0)
            events.append(Event(device, topic, t_ns, t, _body(payload)))
    return tuple(sorted(events, key=lambda event: event.t_ns))


def _body(payload: bytes) -> Mapping[str, Any]:
    try:
        body = parse_json(payload)
    except ValueError:
        body = payload.decode("utf-8", "replace")
    return body if isinstance(body, dict) else {"text": str(body)}
