"""Tables and arrays as recordings in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from labhil.analysis.import_check import check_table
from labhil.recording.import_report import describe_import
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording
from labhil.recording.tables import ImportedTable, import_table, write_import
from labhil.rig import RigFile
from labhil.signals import FloatArray, Stream

Progress = Callable[[str], None]
ReadTable = tuple[Recording, list[str], bytes]
"""A recording, notes on how it was made, and the bytes of its file."""


def read_table(path: Path, rig: RigFile, progress: Progress = lambda text: None) -> ReadTable:
    """Read a table by the rules of a rig file, as ``labhil import`` does.

    Args:
        path: The table.
        rig: The rig file.
        progress: Called with a line of text before a long stage.

    Raises:
        TableError: A column is missing or has wrong values.
    """
    table = import_table(path, rig)
    table, findings = check_table(table, progress)
    return _as_recording(table, [*describe_import(table), *findings])


def recording_of_samples(
    name: Path, sha256: str, rig: RigFile, stream: Stream, t: FloatArray, values: FloatArray
) -> ReadTable:
    """Make a recording of samples in memory.

    Args:
        name: Its name, in the place of a path.
        sha256: Hash of the samples.
        rig: The rig file.
        stream: The stream of the samples.
        t: Increasing times (n,), s.
        values: Samples (n, stream.width) in SI units.
    """
    table = ImportedTable(
        source=name,
        sha256=sha256,
        rig=rig,
        stream=stream,
        row=np.arange(len(t)),
        t=t - t[0],
        values=values,
        time_origin=float(t[0]),
        rows=len(t),
        dropped={},
        outside={},
        flagged=np.zeros(len(t), dtype=np.bool_),
    )
    table, findings = check_table(table)
    return _as_recording(table, findings)


def _as_recording(table: ImportedTable, notes: list[str]) -> ReadTable:
    """Write a table to a temporary recording and read it, so that every recording is made in the same way."""
    with tempfile.TemporaryDirectory(prefix="labhil-") as folder:
        path = write_import(table, Path(folder) / "recording.mcap")
        content, recording = path.read_bytes(), read_recording(path)
    return replace(recording, path=table.source, rig=table.rig), notes, content
