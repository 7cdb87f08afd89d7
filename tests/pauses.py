"""How long a machine kept this process from running: a watchdog that trips then is right to do so."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Self

from labhil.service.messages import WATCHDOG

SLEEP = 0.01


class Pauses:
    """Context in which a thread measures by how much it sleeps too long.

    Attributes:
        longest: The longest pause so far, s.
    """

    def __init__(self) -> None:
        self.longest = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()

    @property
    def tripped_a_watchdog(self) -> bool:
        """Whether commands may have stopped for too long: a pause and what was late already."""
        return self.longest > WATCHDOG / 2

    def _run(self) -> None:
        before = time.monotonic()
        while not self._over.wait(SLEEP):
            now = time.monotonic()
            self.longest = max(self.longest, now - before - SLEEP)
            before = now
