"""Tables as recordings: of a file that others wrote, or of arrays, without a file on disk in between."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from labhil.analysis.import_check import check_table
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording
from labhil.recording.tables import ImportedTable, describe_import, import_table, write_import
from labhil.rig import RigFile
from labhil.signals import FloatArray, Stream

Progress = Callable[[str], None]
Read = tuple[Recording, list[str], bytes]
"""A recording, notes on how it was made, and the bytes of its file."""


def read_table(path: Path, rig: RigFile, progress: Progress = lambda text: None) -> Read:
    """Read a table by the rules of a rig file, as ``labhil import`` does.

    Raises TableError with the column, what was expected and what was found.
    """
    table = import_table(path, rig)
    table, findings = check_table(table, progress)
    return _as_recording(table, [*describe_import(table), *findings])


def table_in_memory(
    name: Path, sha256: str, rig: RigFile, stream: Stream, t: FloatArray, values: FloatArray
) -> Read:
    """Make a recording of samples: times (n,) s that increase, ``values`` (n, stream.width) in SI units."""
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


def _as_recording(table: ImportedTable, notes: list[str]) -> Read:
    """The recording as it is when it was written and read: there is one way from samples to a recording."""
    with tempfile.TemporaryDirectory(prefix="labhil-") as folder:
        path = write_import(table, Path(folder) / "recording.mcap")
        content, recording = path.read_bytes(), read_recording(path)
    return replace(recording, path=table.source, rig=table.rig), notes, content
