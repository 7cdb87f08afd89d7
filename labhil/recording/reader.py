"""MCAP in, numpy out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel

from labhil.bounds import ImplausibleError
from labhil.codec import stream_from_json
from labhil.documents import parse_json
from labhil.errors import ProtocolError, RecordingError
from labhil.recording.chunks import Contents, is_mcap, scan_mcap
from labhil.recording.clock import ClockFit, fit_clock
from labhil.recording.clock_faults import find_clock_faults
from labhil.recording.event_schemas import without_timestamp
from labhil.recording.memory_maps import FileBytes, bytes_of, sha256_of
from labhil.recording.recording import Event, Recording, StreamData, topic_of, unambiguous
from labhil.recording.rig_attachments import attached_rig
from labhil.recording.runs import MixedRunsError, Run, choose_run, separate_runs
from labhil.recording.samples import Samples
from labhil.recording.stamps import with_device_time
from labhil.signals import Batch, IntArray, Stream
from labhil.terminal import printable_name

LARGEST_SPEED = 1e6
"""Seconds of a device's world in one of the host, at most: no simulation is faster."""

LARGEST_STAMP = 1 << 62
"""ns or counts; as Unix time it is the year 2116, and differences of such stamps fit into 64 bits."""


def read_recordings(paths: Sequence[Path], run: int | None = None) -> list[Recording]:
    """Read several recordings, of each the ``run`` as :func:`read_recording`; one run is taken as it is.

    RecordingError when none of them holds that many.
    """
    recordings = [_read(path, run) for path in paths]
    most = max((recording.runs for recording in recordings), default=1)
    if run is not None and recordings and not 1 <= run <= most:
        names = ", ".join(str(path) for path in paths)
        many = "one run of each stream" if most == 1 else f"{most} runs of a stream"
        raise RecordingError(f"run {run}: expected a number from 1 to {most}, found {many} in {names}")
    return recordings


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
        contents = scan_mcap(data, samples.take)
    except ImplausibleError as error:
        raise RecordingError(f"{path}: {error}; `labhil recover` saves what is plausible of it") from error
    topics = _topics(path, contents, samples)
    untimed, span = choose_run(path, topics, run)
    origin_ns = min((int(s.t_acq_ns[0]) for s in untimed if len(s)), default=0)
    streams = _set_times(untimed, origin_ns)
    return Recording(
        path=path,
        sha256=sha256_of(data),
        streams=streams,
        rig=attached_rig(path, unambiguous(contents.attachments, contents.ambiguous)),
        attachments=contents.attachments,
        metadata=contents.metadata,
        events=tuple(event for event in _events(contents, origin_ns, streams) if event.t_ns in span),
        complete=not contents.damage,
        damage=contents.damage,
        foreign=_foreign(contents),
        runs=max((len(topic) for topic in topics), default=1),
        ambiguous=tuple(sorted(contents.ambiguous)),
    )


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
    for (device, stream), parts in channels.items():
        filled = [part for part in parts if len(part[1])] or parts[:1]
        try:
            runs = separate_runs([batch for _, batch in filled])
        except MixedRunsError as error:
            raise RecordingError(f"{path}: {topic_of(device, stream)}: {error}") from error
        metadata = filled[0][0]
        topics.setdefault((device, stream.name), []).extend(
            _without_times(device, stream, metadata, run) for run in runs
        )
    return list(topics.values())


def _without_times(device: str, stream: Stream, metadata: Mapping[str, str], run: Run) -> StreamData:
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
        lost=count_lost(batch.seq),
        speed=_speed(metadata),
        metadata={key: value for key, value in metadata.items() if not key.startswith("labhil.")},
        clock=untimed,
        copies=run.copies,
        moved=run.moved,
    )


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


def count_lost(seq: IntArray) -> int:
    """How many numbers are missing in a sequence that should count up by one."""
    return int(np.maximum(np.diff(seq) - 1, 0).sum())


def _set_times(streams: list[StreamData], origin_ns: int) -> tuple[StreamData, ...]:
    """Give all streams of a device its own time, which is 0 at the first sample of them all."""
    clocks = {id(data): _fit(data, origin_ns) for data in streams}
    mains = _mains(streams, clocks)
    fits = [
        with_device_time(data.stamps, clocks[id(data)], mains.get(data.device), measured=data.is_measured)
        for data in streams
    ]
    pairs = list(zip(streams, fits, strict=True))
    start = min((float(clock.t[0]) / data.speed for data, clock in pairs if len(data)), default=0.0)
    timed = []
    for data, clock in pairs:
        t = clock.t - start * data.speed
        # a stream that borrows a device's clock borrows its faults, which are reported once
        has_own_clock = len(data) and (mains.get(data.device) is None or clock is clocks[id(data)])
        faults = find_clock_faults(data.stamps, clock, t) if has_own_clock and data.is_measured else ()
        timed.append(replace(data, t=t, clock=clock, clock_faults=faults, clock_start=start))
    return tuple(timed)


def _fit(data: StreamData, origin_ns: int) -> ClockFit:
    return fit_clock(data.t_hw_ns, data.t_acq_ns, origin_ns, data.speed, steady=data.stamps.keeps_rate)


def _mains(streams: list[StreamData], clocks: Mapping[int, ClockFit]) -> dict[str, ClockFit]:
    """The clock of each device that has one: that of its longest stream."""
    mains: dict[str, ClockFit] = {}
    for data in sorted(streams, key=len, reverse=True):
        clock = clocks[id(data)]
        if clock.device_clock and clock.map is not None and data.is_measured:
            mains.setdefault(data.device, clock)
    return mains


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
                clock_map = data.clock.map
                begin = float(clock_map.steady_host(np.zeros(1))[0])
                t = (clock_map.device(host) + begin - start) * data.speed
            events.append(Event(device, topic, t_ns, t, without_timestamp(_body(payload), t_ns)))
    return tuple(sorted(events, key=lambda event: event.t_ns))


def _body(payload: bytes) -> Mapping[str, Any]:
    try:
        body = parse_json(payload)
    except ValueError:
        body = payload.decode("utf-8", "replace")
    return body if isinstance(body, dict) else {"text": str(body)}
