"""Reader of recordings: MCAP files to numpy arrays."""

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
from labhil.recording.recording import Event, Recording, StreamData, topic_of, without_ambiguous
from labhil.recording.rig_attachments import attached_rig
from labhil.recording.runs import MixedRunsError, Run, choose_run, separate_runs
from labhil.recording.samples import Samples
from labhil.recording.stamps import with_device_time
from labhil.signals import Batch, IntArray, Stream
from labhil.terminal import printable_name
from labhil.unreadable import RECORDING, beginning_of, reason_unreadable

MAX_SPEED = 1e6
"""Largest speed of a simulation, seconds of its world per second of the host."""

MAX_STAMP = 1 << 62
"""Largest stamp, ns or counts (Unix time of the year 2116): differences fit into 64 bits."""


def read_recordings(paths: Sequence[Path], run: int | None = None) -> list[Recording]:
    """Read several recordings.

    Args:
        paths: the files.
        run: number of the run in files with several, as of :func:`read_recording`; others have one run.

    Returns:
        The recordings.

    Raises:
        RecordingError: A file cannot be read, or none has so many runs.
    """
    recordings = [_read(path, run) for path in paths]
    most = max((recording.runs for recording in recordings), default=1)
    if run is not None and recordings and not 1 <= run <= most:
        names = ", ".join(str(path) for path in paths)
        many = "one run of each stream" if most == 1 else f"{most} runs of a stream"
        raise RecordingError(f"run {run}: expected a number from 1 to {most}, found {many} in {names}")
    return recordings


def read_recording(path: Path, run: int | None = None) -> Recording:
    """Read a recording, one without an end as far as possible.

    Args:
        path: the file.
        run: number of the run, from 1, in a file with several runs of a stream, such as a merged file.

    Returns:
        The recording.

    Raises:
        RecordingError: The file cannot be read, is no MCAP file, or is unusable; or it has several runs and
            ``run`` selects none of them.
    """
    return read_recordings([path], run)[0]


def _read(path: Path, run: int | None) -> Recording:
    data, samples = _bytes_of(path), Samples()
    try:
        contents = scan_mcap(data, samples.decode)
    except ImplausibleError as error:
        raise RecordingError(f"{path}: {error}; `labhil recover` saves what is plausible of it") from error
    topics = _decode_topics(path, contents, samples)
    untimed, span = choose_run(path, topics, run)
    origin_ns = min((int(s.t_acq_ns[0]) for s in untimed if len(s)), default=0)
    streams = _set_times(untimed, origin_ns)
    return Recording(
        path=path,
        sha256=sha256_of(data),
        streams=streams,
        rig=attached_rig(path, without_ambiguous(contents.attachments, contents.ambiguous)),
        attachments=contents.attachments,
        metadata=contents.metadata,
        events=tuple(event for event in _read_events(contents, origin_ns, streams) if event.t_ns in span),
        complete=not contents.damage,
        damage=contents.damage,
        foreign=_foreign_channels(contents),
        runs=max((len(topic) for topic in topics), default=1),
        ambiguous=tuple(sorted(contents.ambiguous)),
    )


def _foreign_channels(contents: Contents) -> tuple[str, ...]:
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
        beside = f"; there is an unfinished recording {part}" if part.exists() else ""
        raise RecordingError(
            f"{path}: cannot be read: {reason_unreadable(path, error, RECORDING)}{beside}"
        ) from error
    if not data:
        raise RecordingError(f"{path}: expected an MCAP recording, found an empty file")
    if not is_mcap(data):
        raise RecordingError(
            f"{path}: expected an MCAP recording, found a file that begins with {beginning_of(data[:8])}; "
            "tables become recordings with `labhil import`"
        )
    return data


def _decode_topics(path: Path, contents: Contents, samples: Samples) -> list[list[StreamData]]:
    """Decode the runs of each topic, by time, without their times of analysis."""
    channels: dict[tuple[str, Stream], list[tuple[Mapping[str, str], Batch]]] = {}
    for channel in contents.channels.values():
        if "labhil.stream" not in channel.metadata:
            continue
        try:
            stream = stream_from_json(channel.metadata["labhil.stream"])
            batch = samples.batch(channel, contents.messages[channel.id])
            _check_stamps(batch)
            _parse_speed(channel.metadata)
            device = _device_of(channel)
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
            _untimed(device, stream, metadata, run) for run in runs
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
        lost=count_lost(batch.seq),
        speed=_parse_speed(metadata),
        metadata={key: value for key, value in metadata.items() if not key.startswith("labhil.")},
        clock=untimed,
        copies=run.copies,
        moved=run.moved,
    )


def _parse_speed(metadata: Mapping[str, str]) -> float:
    speed = float(metadata.get("speed", "1"))
    if not 1.0 / MAX_SPEED < speed < MAX_SPEED:
        raise ValueError(f"expected a speed between 1/{MAX_SPEED:g} and {MAX_SPEED:g}, found {speed}")
    return speed


def _device_of(channel: Channel) -> str:
    """Device of a channel, from its metadata or its topic /device/stream."""
    device = channel.metadata.get("device")
    if device:
        return device
    root, _, rest = channel.topic.partition("/")
    device, _, stream = rest.partition("/")
    if root or not device or not stream:
        raise ValueError("expected a topic /device/stream, or the metadata `device`")
    return device


def _check_stamps(batch: Batch) -> None:
    """Raise ValueError for stamps whose differences do not fit into 64 bits, which no clock shows."""
    for name, stamps in (("seq", batch.seq), ("t_acq_ns", batch.t_acq_ns), ("t_hw_ns", batch.t_hw_ns)):
        implausible = np.flatnonzero((stamps < -MAX_STAMP) | (stamps > MAX_STAMP))
        if len(implausible):
            row = implausible[0]
            raise ValueError(f"message {row}: expected a {name} within ±{MAX_STAMP}, found {stamps[row]}")


def count_lost(seq: IntArray) -> int:
    """Number of missing sequence numbers."""
    return int(np.maximum(np.diff(seq) - 1, 0).sum())


def _set_times(streams: list[StreamData], origin_ns: int) -> tuple[StreamData, ...]:
    """Set the times of all streams by the clocks of their devices, with 0 at the first sample of all."""
    clocks = {id(data): _fit_clock(data, origin_ns) for data in streams}
    device_clocks = _device_clocks(streams, clocks)
    fits = [
        with_device_time(
            data.stamps, clocks[id(data)], device_clocks.get(data.device), measured=data.is_measured
        )
        for data in streams
    ]
    pairs = list(zip(streams, fits, strict=True))
    start = min((float(clock.t[0]) / data.speed for data, clock in pairs if len(data)), default=0.0)
    timed = []
    for data, clock in pairs:
        t = clock.t - start * data.speed
        # the faults of a clock that several streams use are reported once
        has_own_clock = len(data) and (device_clocks.get(data.device) is None or clock is clocks[id(data)])
        faults = find_clock_faults(data.stamps, clock, t) if has_own_clock and data.is_measured else ()
        timed.append(replace(data, t=t, clock=clock, clock_faults=faults, clock_start=start))
    return tuple(timed)


def _fit_clock(data: StreamData, origin_ns: int) -> ClockFit:
    return fit_clock(data.t_hw_ns, data.t_acq_ns, origin_ns, data.speed, steady=data.stamps.keeps_rate)


def _device_clocks(streams: list[StreamData], clocks: Mapping[int, ClockFit]) -> dict[str, ClockFit]:
    """Clock of each device that has one, from its longest stream."""
    device_clocks: dict[str, ClockFit] = {}
    for data in sorted(streams, key=len, reverse=True):
        clock = clocks[id(data)]
        if clock.device_clock and clock.map is not None and data.is_measured:
            device_clocks.setdefault(data.device, clock)
    return device_clocks


def _read_events(contents: Contents, origin_ns: int, streams: Sequence[StreamData]) -> tuple[Event, ...]:
    """Events in the time of their device; all in the time of the device if there is only one."""
    # of the streams of a device a measured one counts
    in_order = sorted(streams, key=lambda data: data.is_measured)
    devices = {data.device: data for data in in_order if data.clock.map is not None and len(data)}
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
            t = host - start if data is None else _device_time(data, t_ns, host, start)
            events.append(Event(device, topic, t_ns, t, without_timestamp(_parse_body(payload), t_ns)))
    return tuple(sorted(events, key=lambda event: event.t_ns))


def _device_time(data: StreamData, t_ns: int, host: float, start: float) -> float:
    """The time of a host's moment in a device's world, s; at a speed of its own, among the samples around it.

    A simulated world stands still while its machine gives it no time, and catches up later. At 20 times real
    time a tenth of a second is 2 s of that world: no line between the clocks says where it stood.
    """
    clock_map = data.clock.map
    if clock_map is None:
        return host - start
    begin = float(clock_map.steady_host(np.zeros(1))[0])
    t = (clock_map.device(host) + begin - start) * data.speed
    if data.speed == 1.0:
        return t
    row = int(np.searchsorted(data.t_acq_ns, t_ns, side="right"))
    low = float(data.t[row - 1]) if row > 0 else -np.inf
    high = float(data.t[row]) if row < len(data) else np.inf
    return min(max(t, low), high)


def _parse_body(payload: bytes) -> Mapping[str, Any]:
    try:
        body = parse_json(payload)
    except ValueError:
        body = payload.decode("utf-8", "replace")
    return body if isinstance(body, dict) else {"text": str(body)}
