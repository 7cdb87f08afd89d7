"""The page of a recording: streams, losses, every signal, events, attached files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

import numpy as np

from labhil.recording.conclusion import is_flawless, steps_with, verdict_on
from labhil.recording.recording import Event, Recording, StreamData
from labhil.report.formatting import format_count, format_multiple, format_quantity
from labhil.report.html.element import Content, Markup, tag
from labhil.report.html.model import next_steps_section, warning
from labhil.report.html.page import Page, PageSection, drop_empty, section
from labhil.report.html.picture import Album
from labhil.report.html.signals import signal_picture, timing_picture
from labhil.report.html.table import facts, numbers, table, text, tiles
from labhil.signals import IntArray

MOST_GAPS = 20
MOST_EVENTS = 60
MOST_CHARACTERS = 20_000
ROUTINE = frozenset({"status"})
"""Topics of periodic messages without news."""


def recording_page(recording: Recording, foot: str, album: Album) -> Page:
    """Make the page of a recording.

    Args:
        recording: The recording.
        foot: Last line of the page: where it comes from.
        album: The pictures of the page.
    """
    return Page(
        kind=_kind(recording),
        title=f"Recording {recording.path.name}",
        headline=verdict_on(recording),
        tone="no_mismatch" if is_flawless(recording) else "data_fault",
        lead=_lead(recording),
        sections=drop_empty(
            next_steps_section(steps_with(recording)),
            section("Streams", _streams(recording), *_clock_faults(recording), *_gaps(recording)),
            *(_signals(data, album) for data in recording.streams),
            _events(recording),
            *(_attachment(name, content) for name, content in recording.attachments.items()),
            _metadata(recording),
        ),
        foot=foot,
    )


def _kind(recording: Recording) -> str:
    name = recording.path.name
    return f"Recording {name}" if recording.rig is None else f"Recording {name} · {recording.rig.kind.name}"


def _lead(recording: Recording) -> tuple[Content, ...]:
    lost = sum(data.lost for data in recording.streams)
    n_samples = sum(len(data) for data in recording.streams)
    figures = tiles(
        (
            ("Duration", format_quantity(recording.duration, "s"), "time of analysis, first sample to last"),
            ("Streams", len(recording.streams), f"{format_count(n_samples)} samples"),
            ("Samples lost", format_count(lost), "holes in the sequence numbers"),
            ("File", "complete" if recording.complete else "incomplete", "whether it has its end"),
        )
    )
    damage = None
    if not recording.complete:
        damage = warning(f"The recording was read as far as it goes: {recording.damage}.")
    return damage, figures, tag("p", "SHA-256 ", tag("code", recording.sha256), class_="quiet")


def _streams(recording: Recording) -> Markup | None:
    if not recording.streams:
        return warning("There are no streams of samples in this recording.")
    columns = (
        *text("Stream"),
        *numbers("Samples", "Lost", "Gaps", "Rate, nominal", "Rate, measured", "Duration", "Speed"),
        *numbers("Clock drift", "Host jitter"),
    )
    rows = [_stream(data) for data in recording.streams]
    return table("Streams of samples; speed is how many seconds of its world pass in one", columns, rows)


def _stream(data: StreamData) -> list[Content]:
    clock = data.clock
    return [
        tag("code", _name(data)),
        format_count(len(data)),
        format_count(data.lost),
        format_count(len(_holes(data))),
        format_quantity(data.stream.rate, "Hz"),
        format_quantity(data.rate if len(data) else None, "Hz"),
        format_quantity(float(data.t[-1] - data.t[0]) if len(data) else None, "s"),
        format_multiple(data.speed, 1.0),
        format_quantity(1e6 * clock.drift, "ppm", digits=3) if clock.device_clock else "no device clock",
        format_quantity(1e3 * clock.jitter, "ms", digits=3),
    ]


def _name(data: StreamData) -> str:
    return f"/{data.device}/{data.stream.name}"


def _holes(data: StreamData) -> IntArray:
    """Indices of rows after which samples are missing."""
    return np.asarray(np.flatnonzero(np.diff(data.seq) > 1), dtype=np.int64)


def _clock_faults(recording: Recording) -> Iterator[Markup]:
    for data in recording.streams:
        for fault in data.clock_faults:
            yield warning(f"{_name(data)}: {fault.statement}")


def _gaps(recording: Recording) -> Iterator[Markup]:
    for data in recording.streams:
        rows = _holes(data)
        if not len(rows):
            continue
        lost = np.diff(data.seq)[rows] - 1
        gaps = [
            (
                format_quantity(float(data.t[row]), "s", digits=6),
                format_quantity(float(data.t[row + 1]), "s", digits=6),
                n,
            )
            for row, n in zip(rows[:MOST_GAPS].tolist(), lost.tolist(), strict=False)
        ]
        more = f", the first {MOST_GAPS} of {len(rows)}" if len(rows) > MOST_GAPS else ""
        yield table(f"Gaps of {_name(data)}{more}", numbers("After", "Until", "Samples lost"), gaps)


def _signals(data: StreamData, album: Album) -> PageSection | None:
    columns = (
        *text("Signal", "Direction", "Unit"),
        *numbers("Smallest", "Largest", "Mean", "Standard deviation"),
        *text("What it is"),
    )
    rows = [row for signal in data.stream.signals for row in _signal_rows(data, signal.name)]
    pictures = []
    if len(data) >= 2:
        pictures = [signal_picture(album, data, signal) for signal in data.stream.signals]
        pictures.append(timing_picture(album, data))
    return section(f"Signals of {_name(data)}", table("Signals, SI units", columns, rows), *pictures)


def _signal_rows(data: StreamData, name: str) -> Iterator[list[Content]]:
    signal = next(s for s in data.stream.signals if s.name == name)
    columns = data.values[:, data.stream.columns_of(name)]
    for column, title in enumerate(signal.columns()):
        values = columns[:, column]
        values = values[np.isfinite(values)]
        with np.errstate(over="ignore", invalid="ignore"):  # of the largest doubles; shown as no number
            statistics = [
                float(f(values)) if len(values) else None for f in (np.min, np.max, np.mean, np.std)
            ]
        yield [
            tag("code", title),
            signal.direction.value,
            signal.unit,
            *(format_quantity(number) for number in statistics),
            signal.description,
        ]


def _events(recording: Recording) -> PageSection | None:
    events = [event for event in recording.events if event.topic not in ROUTINE]
    if not events:
        return None
    columns = (*numbers("Time"), *text("From", "Kind", "Message"))
    more = f", the first {MOST_EVENTS} of {len(events)}" if len(events) > MOST_EVENTS else ""
    rows = [_event(event) for event in events[:MOST_EVENTS]]
    return section("What happened", table(f"Events of the run{more}", columns, rows))


def _event(event: Event) -> list[Content]:
    kind = event.body.get("kind", event.topic)
    message = event.body.get("message") or event.body.get("text")
    if message is None:
        message = json.dumps(dict(event.body), ensure_ascii=False)
    return [
        f"{event.t:.3f}\N{NO-BREAK SPACE}s".replace("-", "−"),
        tag("code", event.device),
        str(kind),
        str(message)[:500],
    ]


def _attachment(name: str, content: bytes) -> PageSection | None:
    """An attached file as text; binary files by their size."""
    try:
        decoded = content.decode("utf-8")
    except UnicodeDecodeError:
        return section(f"Attached: {name}", tag("p", f"{format_count(len(content))} bytes that are no text."))
    note = None
    if len(decoded) > MOST_CHARACTERS:
        note = tag(
            "p",
            f"The first {format_count(MOST_CHARACTERS)} of {format_count(len(decoded))} characters.",
            class_="quiet",
        )
    return section(f"Attached: {name}", note, tag("pre", decoded[:MOST_CHARACTERS]))


def _metadata(recording: Recording) -> PageSection | None:
    parts: list[Content] = []
    for name, entries in recording.metadata.items():
        parts += _entries(name, entries)
    shown: list[Mapping[str, str]] = []
    for data in recording.streams:
        if data.metadata and data.metadata not in shown:
            parts += _entries(_name(data), data.metadata)
            shown.append(data.metadata)
    return section("Metadata", *parts)


def _entries(name: str, entries: Mapping[str, str]) -> list[Content]:
    return [tag("h3", name), facts((tag("code", key), value) for key, value in entries.items())]
