"""Ending long work early with the best so far: Ctrl+C, SIGTERM, or a number of seconds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from labhil.ending import Deadline, EndedEarly
from labhil.errors import OptionError, RunStoppedError


@contextmanager
def ending_early(seconds: float | None = None) -> Iterator[Deadline]:
    """Let Ctrl+C, SIGTERM or the end of ``seconds`` end a long computation with the best so far.

    UsageError where ``seconds`` is no time; RunStoppedError where there is nothing yet by then.
    """
    if seconds is not None and not seconds > 0:
        raise OptionError("seconds", f": expected more than 0, found {seconds:g}")
    with Deadline(seconds) as deadline:
        try:
            yield deadline
        except EndedEarly as early:
            raise RunStoppedError(f"ended early ({early}), before there was a result") from early
