"""The progress bar of a run on stderr."""

from __future__ import annotations

from types import TracebackType
from typing import Self

import rich.progress

from labhil.experiment.control import RunState
from labhil.experiment.result import Progress
from labhil.terminal import complain, terminal


class ProgressBar:
    """Shows :class:`Progress` as a bar on stderr; without a terminal, as a line per change of state."""

    def __init__(self) -> None:
        self._console = terminal(stderr=True)
        self._bar = rich.progress.Progress(
            rich.progress.TextColumn("{task.description}"),
            rich.progress.BarColumn(),
            rich.progress.TextColumn("{task.completed:.1f} of {task.total:.1f} s"),
            rich.progress.TimeRemainingColumn(),
            console=self._console,
            transient=True,
        )
        self._task = self._bar.add_task("starting", total=1.0)
        self._shown: RunState | None = None

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def __call__(self, progress: Progress) -> None:
        """Show the progress."""
        if self._console.is_terminal:
            self._bar.update(
                self._task,
                description=progress.state.value,
                completed=progress.elapsed,
                total=progress.duration,
            )
        elif progress.state is not self._shown:
            complain(progress.state.value)
        self._shown = progress.state
