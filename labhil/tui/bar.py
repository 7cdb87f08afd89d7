"""The line at the top of the screen, and the question before quitting."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.text import Text

from labhil.campaign.studies.jobs import Job
from labhil.tui.formatting import RUN_STATES
from labhil.tui.runner import Runner


def bar_text(folder: Path, runner: Runner, at_work: Sequence[Job], colours: dict[str, str]) -> Text:
    """Return the line at the top: the run and the studies at work, or the folder.

    Args:
        folder: Folder of the screen.
        runner: The run.
        at_work: Studies that have not ended.
        colours: Colours of the theme.
    """
    line = Text(no_wrap=True, overflow="ellipsis")
    if runner.state != "idle":
        line.append_text(RUN_STATES[runner.state].text(colours))
        line.append(f" {runner.name} ")
        if runner.duration and runner.is_active:
            line.append(f"{runner.elapsed:.0f} of {runner.duration:.0f} s ", style="bold")
    for job in at_work:
        line.append(f" … {job.title}", style=colours["accent"])
    if not line.plain:
        place = folder if folder.name else folder.absolute()
        line.append(str(place), style=colours["muted"])
    return line


def question_before_leaving(runner: Runner, at_work: Sequence[Job]) -> str:
    """Return the question before quitting; empty where nothing is at work."""
    if runner.is_active:
        return "A run is on.\n\nStop it and quit? Devices go to their safe state, the recording is kept."
    if at_work:
        titles = "\n  ".join(job.title for job in at_work)
        return f"Still at work:\n\n  {titles}\n\nCancel and quit?"
    return ""
