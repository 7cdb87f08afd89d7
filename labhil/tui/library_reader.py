"""Reading the recordings of a folder in a thread."""

from __future__ import annotations

import threading
from pathlib import Path

from textual.app import App

from labhil.tui.background import work_in_background
from labhil.tui.messages import LibraryRead
from labhil.tui.recording_library import RecordingLibrary


class LibraryReader:
    """Post a :class:`LibraryRead` to ``app`` whenever another recording of ``folder`` has been read."""

    def __init__(self, app: App[None], folder: Path) -> None:
        self._app, self._library = app, RecordingLibrary(folder)
        self._reading = threading.Lock()

    def scan(self) -> None:
        """Read the folder again, unless a scan is under way."""
        if self._reading.acquire(blocking=False):
            work_in_background(self._app, self._read, "reading the folder", "shelf")

    def _read(self) -> None:
        try:
            for recordings in self._library.scan():
                self._app.post_message(LibraryRead(recordings))
        finally:
            self._reading.release()
