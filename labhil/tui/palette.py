"""The command palette: only the commands that are possible now."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from textual import work
from textual.app import SystemCommand
from textual.command import CommandPalette
from textual.css.query import NoMatches

from labhil.tui.experiment import ALLOWED, ExperimentPane
from labhil.tui.themes import DARK
from labhil.tui.top_bar import WithBar

if TYPE_CHECKING:
    from labhil.tui.app import LabApp

TABS = ("devices", "live", "experiment", "recordings", "results")


class Palette(CommandPalette, WithBar):
    """Show the commands, with a search that ends when the palette is closed.

    Textual 8.2 searches in a worker, which queries the list of commands. Where the palette was closed in
    between, the list is gone, and the whole program would end with an error.
    """

    @work(exclusive=True, group=CommandPalette._GATHER_COMMANDS_GROUP)
    async def _gather_commands(self, search_value: str) -> None:
        with suppress(NoMatches):
            await CommandPalette._gather_commands.__wrapped__(self, search_value)  # type: ignore[attr-defined]


def commands(app: LabApp, pane: ExperimentPane) -> Iterator[SystemCommand]:
    """Yield the commands that are possible now.

    Args:
        app: The app.
        pane: The pane of experiments, which controls the run.
    """
    yield SystemCommand("lab: stop all devices", "Emergency stop (F12)", app.action_stop_all)
    if app.emergency.latch is not None:
        yield SystemCommand(
            "lab: release the emergency stop", "Runs may be started again", app.action_release
        )
    for name in ("start", "pause", "resume", "stop", "abort"):
        if app.runner.state in ALLOWED[name] and (name != "start" or pane.plan is not None):
            what = pane.plan.experiment.experiment.name if name == "start" and pane.plan else "the run"
            yield SystemCommand(
                f"run: {name}", f"{name.capitalize()} {what}", partial(pane.action_control, name)
            )
    for number, name in enumerate(TABS, start=1):
        if name != app.tab:
            yield SystemCommand(f"show: {name}", f"Tab {number}", partial(app.action_tab, name))
    for job in app.studies.jobs.running:
        yield SystemCommand(
            f"cancel: {job.title}", "Files stay as they were", partial(app.studies.jobs.cancel, job)
        )
    opposite = "light" if app.theme == DARK.name else "dark"
    yield SystemCommand(f"layout: {opposite} colours", "Change the theme", app.action_toggle_theme)
    yield SystemCommand("help: keys", "All keys of this screen, or put them away", app.action_keys)
    yield SystemCommand("quit", "A run is ended in order first", app.action_leave)
