"""MCAP in, numpy out; and the tables of others in, ours out."""

from labhil.recording.reader import Event, Recording, StreamData, read_recording
from labhil.recording.writer import RecordingWriter

__all__ = ["Event", "Recording", "RecordingWriter", "StreamData", "read_recording"]
