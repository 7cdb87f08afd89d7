"""Threads whose owner learns how they ended: an exception in one is kept, and never lost."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from pathlib import Path


class SupervisedThread:
    """A thread that keeps what ended it, for the owner who asks :meth:`failure` several times a second.

    Args:
        work: What the thread does; it returns only once its owner has ended it.
        name: Of the thread, and in the reason of its failure.
        daemon: Whether the process may end while it is still at work.
        on_failure: Called in the thread when ``work`` has raised, to wake whoever waits for it.

    Example:
        >>> thread = SupervisedThread(lambda: 1 / 0, "divide")
        >>> thread.start()
        >>> thread.join()
        >>> thread.failure().partition(" at ")[0]
        "the thread 'divide' has died: ZeroDivisionError('division by zero')"
    """

    def __init__(
        self,
        work: Callable[[], object],
        name: str,
        *,
        daemon: bool = False,
        on_failure: Callable[[], object] = lambda: None,
    ) -> None:
        self.error: BaseException | None = None
        self._work, self._on_failure = work, on_failure
        self._thread = threading.Thread(target=self._run, name=name, daemon=daemon)
        self._end_requested = False

    def start(self) -> None:
        """Begin the work."""
        self._thread.start()

    def end(self) -> None:
        """Say that the work may end from now on: a thread that returns is then no failure."""
        self._end_requested = True

    def join(self, timeout: float | None = None) -> None:
        """Wait until the work is over, at most ``timeout`` s."""
        self._thread.join(timeout)

    def is_alive(self) -> bool:
        """Whether it is at work."""
        return self._thread.is_alive()

    def failure(self) -> str:
        """Return why it works no more without having been ended; empty while all is well."""
        if self.error is not None:
            return f"the thread {self._thread.name!r} has died: {self.error!r}{_place(self.error)}"
        if self._end_requested or self._thread.is_alive() or self._thread.ident is None:
            return ""
        return f"the thread {self._thread.name!r} has ended, though nobody told it to"

    def _run(self) -> None:
        try:
            self._work()
        except BaseException as error:  # noqa: BLE001 - sys.exit() in a thread ends it in silence, too
            self.error = error
            self._on_failure()


def _place(error: BaseException) -> str:
    """Where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    return f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
