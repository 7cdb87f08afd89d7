"""Ours out: recordings as tables for other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from labhil.errors import RecordingError, UsageError
from labhil.recording.reader import Recording, StreamData


def exported_stream(recording: Recording) -> StreamData:
    """The stream that a table is made of: ``state``, or the one that has samples.

    RecordingError when the recording holds no samples, or several streams of which none is the one.
    """
    filled = [data for data in recording.streams if len(data)]
    chosen = [data for data in filled if data.stream.name == "state"] or filled
    if len(chosen) == 1:
        return chosen[0]
    found = ", ".join(f"/{data.device}/{data.stream.name}" for data in chosen) or "none with samples"
    hint = "; choose a device with --device" if len({data.device for data in chosen}) > 1 else ""
    raise RecordingError(f"{recording.path}: expected one stream to export, found {found}{hint}")


def export_csv(recording: Recording, out: Path, stream: StreamData | None = None) -> Path:
    """Write one stream as CSV: a header line, the column ``t`` (s), then the signals, SI units.

    Numbers are written so that reading them gives the same doubles. Without ``stream`` the recording's
    ``state`` is written. UsageError when ``out`` cannot be written.
    """
    data = exported_stream(recording) if stream is None else stream
    rows = np.column_stack([data.t, data.values]).tolist()
    lines = [",".join(("t", *data.stream.columns()))]
    lines += [",".join(map(repr, row)) for row in rows]
    try:
        out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{out}: cannot be written: {error.strerror}") from error
    return out


def export(recording: Recording, out: Path) -> Path:
    """Write a recording in the format that the extension of ``out`` names; UsageError for others."""
    suffix = out.suffix.lower()
    if suffix != ".csv":
        raise UsageError(f"{out}: expected an extension .csv, found {suffix or 'none'!r}")
    return export_csv(recording, out)
