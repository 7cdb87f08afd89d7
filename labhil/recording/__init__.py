"""Recordings as MCAP files: write, read, recover and export them; import foreign tables as recordings."""

from labhil.recording.export import export, export_csv
from labhil.recording.import_report import describe_import
from labhil.recording.reader import read_recording
from labhil.recording.recording import Event, Recording, StreamData
from labhil.recording.tables import ImportedTable, import_table, write_import
from labhil.recording.writer import RecordingWriter

__all__ = [
    "Event",
    "ImportedTable",
    "Recording",
    "RecordingWriter",
    "StreamData",
    "describe_import",
    "export",
    "export_csv",
    "import_table",
    "read_recording",
    "write_import",
]

import sys

from labhil.public import CallablePackage

sys.modules[__name__].__class__ = CallablePackage
