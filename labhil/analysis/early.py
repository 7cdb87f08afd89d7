"""Early end of a long computation, with the best result so far: by Ctrl+C, SIGTERM, or a time limit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from labhil.ending import Deadline, EndedEarly
from labhil.errors import OptionError, RunStoppedError


@contextmanager
def ending_early(seconds: float | None = None) -> Iterator[Deadline]:
    """Let Ctrl+C, SIGTERM or a time limit of ``seconds`` end the computation with the best result so far.

    Raises:
        OptionError: ``seconds`` is not positive.
        RunStoppedError: There is no result yet when it ends.
    """
    if seconds is not None and not seconds > 0:
        raise OptionError("seconds", f": expected more than 0, found {seconds:g}")
    with Deadline(seconds) as deadline:
        try:
            yield deadline
        except EndedEarly as early:
            raise RunStoppedError(
                f"ended early ({early}), before there was a result; run it again and give it more time"
            ) from early
