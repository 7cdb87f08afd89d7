"""The application: five tabs, the emergency stop, and an orderly end of runs and studies.

Each tab has a pane in a file of its own; ``session.py`` holds the view of the buses.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

from rich.text import Text
from textual.app import App, ComposeResult, SystemCommand
from textual.binding import Binding, BindingType
from textual.events import Event, Key
from textual.markup import escape
from textual.notifications import SeverityLevel
from textual.screen import Screen
from textual.widget import Widget
from textual.widgets import HelpPanel

from labhil.tui.background import OUT_OF_DATE
from labhil.tui.bar import bar_text
from labhil.tui.devices import DevicesPane
from labhil.tui.emergency_stop import EmergencyStop
from labhil.tui.experiment import ExperimentPane
from labhil.tui.footer import KeyFooter
from labhil.tui.frame_limiter import FrameLimiter
from labhil.tui.library_reader import LibraryReader
from labhil.tui.live import LivePane
from labhil.tui.messages import LibraryRead, RunLine, StartRequested, StudyLine, StudyRequested
from labhil.tui.palette import TABS, Palette, commands
from labhil.tui.panes import LabScreen, Pane, TabbedPanes
from labhil.tui.recordings import RecordingsPane
from labhil.tui.results import ResultsPane
from labhil.tui.run_desk import RunDesk
from labhil.tui.runner import Runner
from labhil.tui.session import Session
from labhil.tui.shutdown import end_in_order
from labhil.tui.studies import Studies, has_result
from labhil.tui.themes import DARK, LIGHT
from labhil.tui.top_bar import TopBar

FRAME_INTERVAL = 0.1
"""Shortest time between two frames of the plots, s; see ``FrameLimiter``."""
STATE_INTERVAL = 0.25
"""Time between two refreshes of tables and states, s, so that a silent stream shows within a second."""
FILES_INTERVAL = 2.0
"""Time between two scans of the folder, s."""

STOP_KEYS = ("f12", "ctrl+e")


class LabApp(App[None]):
    """Run the terminal UI.

    Args:
        folder: Folder of recordings, results and experiments.
        session: View of the buses in reach.
        theme: Name of the first theme.
        tab: Name of the first tab.
    """

    TITLE = "labhil"
    CSS_PATH = "lab.tcss"
    ENABLE_COMMAND_PALETTE = True
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (120, "-wide")]  # noqa: RUF012 - Textual declares no class variable
    VERTICAL_BREAKPOINTS = [(0, "-low"), (36, "-high")]  # noqa: RUF012
    BINDINGS: ClassVar[list[BindingType]] = [
        *[
            Binding(str(number), f"tab('{name}')", name.capitalize(), id=f"tab.{name}", show=False)
            for number, name in enumerate(TABS, start=1)
        ],
        Binding(
            ",".join(STOP_KEYS),
            "stop_all",
            "STOP ALL",
            id="lab.stop",
            priority=True,
            show=False,
            tooltip="Emergency stop: every device to its safe state, at once",
        ),
        Binding("f9", "release", "Release", id="lab.release", priority=True, tooltip="Allow runs again"),
        Binding("ctrl+t", "toggle_theme", "Light/dark", id="app.theme", show=False),
        Binding("question_mark", "keys", "Keys", id="app.keys", tooltip="All keys of this screen, and back"),
        Binding("q", "leave", "Quit", id="app.quit", tooltip="Quit; a run is ended in order first"),
        Binding("ctrl+q,ctrl+c", "leave", "Quit", id="app.quit.too", show=False, priority=True),
    ]

    def __init__(
        self, folder: Path, session: Session, *, theme: str = DARK.name, tab: str = "devices"
    ) -> None:
        super().__init__()
        self.folder, self.session, self._first_tab = folder, session, tab
        self.runner = Runner(folder, lambda line: self.post_message(RunLine(line)))
        self.studies = Studies(self)
        self._library = LibraryReader(self, folder)
        self.emergency = EmergencyStop(self, session, self._show_stop, self._log_event)
        self._run_desk = RunDesk(
            self,
            self.runner,
            pane=lambda: self.base.query_one(ExperimentPane) if self.is_drawable else None,
            is_stopped=lambda: self.emergency.latch is not None,
            on_change=self._refresh_state,
            on_result=self.refresh_files,
        )
        self._is_out_of_date = False
        self._frame_limiter = FrameLimiter()
        self._panes: tuple[Widget, ...] = ()
        # the moving line under a tab costs a third of the time until its pane is visible
        self.animation_level = "none"
        self.register_theme(DARK)
        self.register_theme(LIGHT)
        self.theme = theme

    def compose(self) -> ComposeResult:
        """Lay out the tabs and the footer; every screen brings its bar."""
        panes: dict[str, tuple[str, Pane]] = {
            "devices": ("1 Devices", DevicesPane(self.session)),
            "live": ("2 Live", LivePane(self.session, self.folder)),
            "experiment": ("3 Experiment", ExperimentPane(self.folder, self.runner, self.session)),
            "recordings": ("4 Recordings", RecordingsPane(self.folder)),
            "results": ("5 Results", ResultsPane(self.folder, self.studies.jobs)),
        }
        yield TabbedPanes(panes, self._first_tab)
        yield KeyFooter()

    def get_default_screen(self) -> Screen[Any]:
        """Return the screen with the tabs."""
        return LabScreen(id="_default")

    def on_mount(self) -> None:
        """Start the timers, and read the folder."""
        self._panes = tuple(self.base.query_one(TabbedPanes).panes.values())
        self.set_interval(FRAME_INTERVAL, self._draw_plots)
        self.set_interval(STATE_INTERVAL, self._refresh_state)
        self.set_interval(FILES_INTERVAL, self.refresh_files)
        self._library.scan()  # before the tab is opened: reading takes a while
        end_in_order(self, self.runner)
        self._show_tab()
        self.watch(self.base.query_one(TabbedPanes), "active", self._show_tab, init=False)
        self.watch(self.base, "focused", self._keep_focus, init=False)

    def on_unmount(self) -> None:
        """End the run and all studies."""
        self.close_everything()

    def close_everything(self) -> None:
        """End the run and all studies; safe to call twice. A run without a stop request fails."""
        self.runner.close()
        self.studies.jobs.close()

    async def on_event(self, event: Event) -> None:
        """Handle the keys of the emergency stop before all others, also while a dialog is open."""
        if isinstance(event, Key) and event.key in STOP_KEYS:
            self.action_stop_all()
            return
        await super().on_event(event)

    def notify(
        self,
        message: str,
        *,
        title: str = "",
        severity: SeverityLevel = "information",
        timeout: float | None = None,
        markup: bool = False,
    ) -> None:
        """Show a message without interpreting markup: it may hold text of devices, files or the bus."""
        super().notify(message, title=title, severity=severity, timeout=timeout, markup=markup)

    # drawing

    @property
    def base(self) -> Screen[Any]:
        """The screen with the tabs, below any dialog."""
        return self.screen_stack[0]

    @property
    def is_drawable(self) -> bool:
        """Whether there is something to draw on: not before the first layout, nor during shutdown."""
        return self.is_running and bool(self._panes) and all(pane.is_attached for pane in self._panes)

    @property
    def tab(self) -> str:
        """Name of the tab in front."""
        return self.base.query_one(TabbedPanes).active

    @property
    def _front_pane(self) -> Pane:
        return self.base.query_one(TabbedPanes).front

    def _draw_plots(self) -> None:
        if (
            self.is_drawable
            and self.tab == "live"
            and len(self.screen_stack) == 1
            and self._frame_limiter.due()
        ):
            self.base.query_one(LivePane).draw()

    def _refresh_state(self) -> None:
        failure = self.session.failure()
        if self.runner.is_active:
            self.runner.abort_if_unseen(failure)
        if not self.is_drawable:
            return
        if failure and not self._is_out_of_date:
            self._is_out_of_date = True
            self.notify(f"{OUT_OF_DATE}: {failure}", severity="error", timeout=3600.0)
        self.emergency.refresh()
        self._show_bars()
        self._front_pane.refresh_view()

    def bar_line(self) -> Text:
        """Return the line of the bar about the run and the studies at work."""
        return bar_text(self.folder, self.runner, self.studies.at_work, self.theme_variables)

    def stop_note(self) -> Text:
        """Return the red lines of the bar; empty while no emergency stop is in force."""
        return self.emergency.note()

    def _show_bars(self) -> None:
        """Refresh the bar of every screen: those below a dialog are seen too."""
        for screen in self.screen_stack:
            for bar in screen.query(TopBar):
                bar.refresh_view()

    def refresh_files(self) -> None:
        """Read the files that the tab in front shows; recordings in a thread, one scan at a time."""
        if not self.is_drawable:
            return
        if self.tab == "recordings":
            self._library.scan()
        else:
            self._front_pane.refresh_list()

    def on_library_read(self, message: LibraryRead) -> None:
        """Show the recordings that have been read."""
        if self.is_drawable:
            self.base.query_one(RecordingsPane).show_entries(message.recordings)

    # tabs

    def action_command_palette(self) -> None:
        """Show the command palette."""
        if not isinstance(self.screen, Palette):
            self.push_screen(Palette(id="--command-palette"))

    def action_tab(self, name: str) -> None:
        """Bring a tab to the front."""
        if len(self.screen_stack) == 1:
            self.base.query_one(TabbedPanes).active = name

    def _show_tab(self) -> None:
        """Refresh the tab in front, and focus its main widget at once: keys may be typed ahead."""
        self._refresh_state()
        self.refresh_files()
        self._focus_tab()

    def _keep_focus(self, focused: Widget | None) -> None:
        """Keep the focus in the tab: a late layout, or a click beside it, takes it away."""
        if focused is None and self.app_focus:
            self.call_next(self._focus_tab)

    def _focus_tab(self) -> None:
        if self.is_drawable:
            pane = self._front_pane
            self.base.set_focus(pane.query_one(pane.MAIN_WIDGET))

    # the run

    def on_start_requested(self, message: StartRequested) -> None:
        """Start a run; ask first where it moves real devices."""
        self._run_desk.ask_to_start(Path(message.path))

    def on_run_line(self, message: RunLine) -> None:
        """Follow the run."""
        self._run_desk.follow(message.line)

    # studies

    def on_study_requested(self, message: StudyRequested) -> None:
        """Start a fit, a diagnosis, …, and show it among the results."""
        if self.studies.start(message):
            self.action_tab("results")
        self.base.query_one(ResultsPane).refresh_list()

    def on_study_line(self, message: StudyLine) -> None:
        """Follow a study."""
        job, is_new_state = self.studies.follow(message)
        if not self.is_drawable:
            return
        results = self.base.query_one(ResultsPane)
        if is_new_state:
            self.studies.announce(job)
            results.refresh_list()
            self.refresh_files()
            if has_result(job):
                results.show_file(Path(job.done))
        elif self.tab == "results":
            results.refresh_view()

    # the emergency stop

    def action_stop_all(self) -> None:
        """Bring every device in reach to its safe state, and block all runs until the release."""
        self.emergency.press()

    def action_release(self) -> None:
        """Allow runs again, once somebody has confirmed it."""
        self.emergency.ask_release()

    def _log_event(self, kind: str, text: str, device: str = "") -> None:
        if self.is_drawable:
            self.base.query_one(ExperimentPane).log_line(kind, text, device)

    def _show_stop(self) -> bool:
        if not self.is_drawable:
            return False
        self._show_bars()
        self.refresh_bindings()
        return True

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Enable the release only after an emergency stop."""
        if action == "release":
            return self.emergency.latch is not None and not self.emergency.is_asking
        return True

    # leaving

    def action_leave(self) -> None:
        """Quit; during a run only after a question, and after the run has ended in order."""
        self._run_desk.leave(self.studies.at_work)

    def action_keys(self) -> None:
        """Show or hide all keys of the screen in front."""
        if self.screen.query(HelpPanel):
            self.action_hide_help_panel()
        else:
            self.action_show_help_panel()

    def action_toggle_theme(self) -> None:
        """Change between the dark and the light theme."""
        self.theme = LIGHT.name if self.theme == DARK.name else DARK.name

    # the command palette

    def get_system_commands(self, screen: Screen[Any]) -> Iterable[SystemCommand]:
        """Yield the commands that are possible now; names in them are no markup."""
        for name, about, action, *_ in commands(self, self.base.query_one(ExperimentPane)):
            yield SystemCommand(escape(name), escape(about), action)
