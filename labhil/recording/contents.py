"""Summary of a recording for users and programs: streams, rates, gaps, clocks, events."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from labhil.documents import parse_json
from labhil.kinds import RigKind, kind_named, kind_names
from labhil.recording.memory_maps import BLOCK_ROWS, release_array
from labhil.recording.recording import Event, Recording, StreamData
from labhil.recording.runs import MIN_UNIX_TIME

ROUTINE = ("state", "status")
"""Topics and kinds of routine events, which a summary omits."""
FREE_TEXT = ("operator", "sample", "notes")
"""Keys of free text in an experiment file."""


def tags_of(recording: Recording) -> tuple[str, ...]:
    """Tags of the experiment of a recording."""
    try:
        tags = parse_json(recording.metadata.get("experiment", {}).get("tags", "[]"))
    except ValueError:
        return ()
    return tuple(str(tag) for tag in tags) if isinstance(tags, list) else ()


def free_text_of(recording: Recording) -> dict[str, str]:
    """Return what the experiment file says in words: operator, sample, notes and tags that are not empty."""
    experiment = recording.metadata.get("experiment", {})
    texts = {key: experiment.get(key, "") for key in FREE_TEXT} | {"tags": ", ".join(tags_of(recording))}
    return {key: text for key, text in texts.items() if text}


def recording_status(recording: Recording) -> str:
    """Status: "done", "failed", "imported", or "no end" after the recorder was killed."""
    return status_from_metadata(recording.metadata) if recording.complete else "no end"


def status_from_metadata(metadata: Mapping[str, Mapping[str, str]]) -> str:
    """Status of a recording with these metadata, as of :func:`recording_status`."""
    end = metadata.get("end", {})
    if not end:
        return "no end"
    if is_imported(metadata):
        return "imported"
    return "done" if end.get("exit_status") in ("0", "done") else "failed"


def is_imported(metadata: Mapping[str, Mapping[str, str]]) -> bool:
    """Whether neither a run nor a lab in service made the recording, by its metadata."""
    return not {"experiment", "lab"} & metadata.keys()


def start_time(recording: Recording) -> datetime | None:
    """Time of the first sample; None if the stamps are no dates."""
    first = min((int(data.t_acq_ns[0]) for data in recording.streams if len(data)), default=0)
    return datetime.fromtimestamp(first * 1e-9, UTC) if first >= MIN_UNIX_TIME else None


def compatible_kinds(recording: Recording) -> tuple[str, ...]:
    """Rig kinds whose inputs and outputs a device of the recording has."""
    names: dict[str, set[str]] = {}
    for data in recording.streams:
        names.setdefault(data.device, set()).update(data.stream.names())
    kinds = [kind_named(name) for name in kind_names()]
    return tuple(
        kind.name for kind in kinds if any(_is_compatible(kind, signals) for signals in names.values())
    )


def _is_compatible(kind: RigKind, names: set[str]) -> bool:
    outputs = {signal.name for signal in kind.outputs}
    measured = bool(outputs & names) if kind.any_output else outputs <= names
    return measured and any(set(inputs) <= names for inputs in kind.driven_by)


def describe_contents(recording: Recording) -> dict[str, Any]:
    """Summarise a recording as ``labhil.info/1``, with finite numbers or None.

    Args:
        recording: the recording.

    Returns:
        JSON data.
    """
    start = start_time(recording)
    experiment = recording.metadata.get("experiment", {})
    return {
        "schema": "labhil.info/1",
        "path": str(recording.path),
        "sha256": recording.sha256,
        "size": recording.path.stat().st_size,
        "status": recording_status(recording),
        "reason": recording.metadata.get("end", {}).get("reason", ""),
        "complete": recording.complete,
        "damage": recording.damage,
        "start": None if start is None else start.isoformat(),
        "duration": recording.duration,
        "rig": None if recording.rig is None else recording.rig.kind.name,
        "fits": list(compatible_kinds(recording)),
        "experiment": experiment.get("name"),
        **{key: experiment.get(key) for key in FREE_TEXT},
        "tags": list(tags_of(recording)),
        "campaign": dict(recording.metadata["campaign"]) if "campaign" in recording.metadata else None,
        "streams": [_describe_stream(recording, data) for data in recording.streams],
        "events": [_describe_event(event) for event in recording.events if not _is_routine(event)],
        "attachments": sorted(recording.attachments),
        "foreign": list(recording.foreign),
        "warnings": recording.warnings(),
    }


def _describe_stream(recording: Recording, data: StreamData) -> dict[str, Any]:
    steps = np.diff(data.seq)
    clock = recording.clocks.get(data.device)
    return {
        "device": data.device,
        "stream": data.stream.name,
        "samples": len(data),
        "lost": data.lost,
        "longest_gap": int(steps.max() - 1) if len(steps) else 0,
        "rate": data.rate,
        "nominal_rate": data.stream.rate,
        "speed": data.speed,
        "clock": None
        if clock is None
        else {"drift_ppm": clock.drift * 1e6, "jitter": clock.jitter, "stepped": clock.stepped},
        "clock_faults": [fault.statement for fault in data.clock_faults],
        "signals": [
            {
                "name": signal.name,
                "unit": signal.unit,
                "width": signal.width,
                "direction": signal.direction.value,
                **_value_range(data, signal.name),
            }
            for signal in data.stream.signals
        ],
    }


def _value_range(data: StreamData, name: str) -> dict[str, float | None]:
    values = data[name]
    lowest, highest = np.inf, -np.inf
    for start in range(0, len(values), BLOCK_ROWS):
        block = values[start : start + BLOCK_ROWS]
        finite = block[np.isfinite(block)]
        lowest = min(lowest, float(finite.min(initial=np.inf)))
        highest = max(highest, float(finite.max(initial=-np.inf)))
    release_array(values)
    if lowest > highest:
        return {"lowest": None, "highest": None}
    return {"lowest": lowest, "highest": highest}


def _is_routine(event: Event) -> bool:
    return event.topic in ROUTINE or str(event.body.get("kind", "")) in ROUTINE


def _describe_event(event: Event) -> dict[str, Any]:
    body = event.body
    message = body.get("message") or body.get("text") or body.get("reason") or ""
    return {
        "t": event.t,
        "device": event.device,
        "kind": str(body.get("kind", "note")),
        "message": str(message),
    }


def format_contents(info: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of ``labhil info`` for a summary of :func:`describe_contents`."""
    yield f"{info['path']}: {info['status']}, {info['duration']:.4g} s, {info['size'] / 1e6:.3g} MB"
    start = "" if info["start"] is None else f"started {info['start'][:19].replace('T', ' ')} UTC"
    rig = "no rig file attached" if info["rig"] is None else f"rig {info['rig']} attached"
    fits = f"fits rig kinds: {', '.join(info['fits'])}" if info["fits"] else "fits no rig kind as it is"
    yield "  " + "; ".join(part for part in (start, rig, fits) if part)
    for key in ("experiment", *FREE_TEXT):
        if info[key]:
            yield f"  {key}: {info[key]}"
    if info["tags"]:
        yield f"  tags: {', '.join(info['tags'])}"
    if info["campaign"]:
        campaign = dict(info["campaign"])
        head = f"run {campaign.pop('run', '?')} of {campaign.pop('of', '?')} of {campaign.pop('file', '?')}"
        campaign.pop("name", None)
        yield f"  campaign: {', '.join([head, *(f'{key} = {value}' for key, value in campaign.items())])}"
    for stream in info["streams"]:
        yield from _format_stream(stream)
    if info["events"]:
        yield "  events:"
        yield from (
            f"    {event['t']:9.3f} s  {event['device']:<9} {event['kind']:<10} {event['message']}".rstrip()
            for event in info["events"]
        )
    yield from (f"  warning: {warning}" for warning in info["warnings"])


def _format_stream(stream: Mapping[str, Any]) -> Iterator[str]:
    lost = f"{stream['lost']} lost" if stream["lost"] else "none lost"
    if stream["lost"]:
        lost += f" (up to {stream['longest_gap']} in a row)"
    faster = f", {stream['speed']:g} times faster than real time" if stream["speed"] != 1.0 else ""
    yield (
        f"  /{stream['device']}/{stream['stream']}: {stream['samples']} samples, {lost}, "
        f"{stream['rate']:.5g} Hz (nominal {stream['nominal_rate']:g}){faster}"
    )
    clock = stream["clock"]
    if clock is not None:
        jitter = f"stamps jitter {clock['jitter'] * 1e3:.2g} ms"
        yield f"    clock {clock['drift_ppm']:+.1f} ppm of the host's, {jitter}"
    for signal in stream["signals"]:
        width = f" × {signal['width']}" if signal["width"] > 1 else ""
        value_range = (
            "no finite value"
            if signal["lowest"] is None
            else f"{signal['lowest']:.4g} to {signal['highest']:.4g}"
        )
        yield f"    {signal['name']}{width} [{signal['unit']}] {signal['direction']}: {value_range}"
