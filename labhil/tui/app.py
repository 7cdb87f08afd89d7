"""The application: five tabs, one key that stops everything, and no way out that leaves a device moving."""

from __future__ import annotations

import asyncio
import signal
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

from rich.text import Text
from textual.app import App, ComposeResult, SystemCommand
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.events import Event, Key
from textual.markup import escape
from textual.notifications import SeverityLevel
from textual.screen import Screen
from textual.widget import Widget
from textual.widgets import (
    DataTable,
    Footer,
    HelpPanel,
    OptionList,
    SelectionList,
    Static,
    TabbedContent,
    TabPane,
)

from labhil.bus.latch import Latch
from labhil.campaign.studies.jobs import Jobs
from labhil.errors import LabhilError
from labhil.service.emergency import Outcome
from labhil.tui.devices import DevicesPane
from labhil.tui.dialogs import Confirm, Tell
from labhil.tui.experiment import ExperimentPane
from labhil.tui.lab import Lab
from labhil.tui.live import LivePane
from labhil.tui.messages import RunSaid, ShelfRead, StartWanted, StudySaid, StudyWanted
from labhil.tui.pace import Pace
from labhil.tui.palette import TABS, Palette, commands
from labhil.tui.recordings import RecordingsPane
from labhil.tui.results import ResultsPane
from labhil.tui.runner import Runner
from labhil.tui.shelf import Shelf
from labhil.tui.stop import StopButton, stop_note
from labhil.tui.themes import DARK, LIGHT
from labhil.tui.words import RUN_STATES

FRAME_INTERVAL = 0.1
"""Plots are drawn at most ten times a second, see ``Pace``."""
FACTS_INTERVAL = 0.25
"""Tables and states are brought up to date four times a second, so that silence shows within one."""
FILES_INTERVAL = 2.0

STOP_KEYS = ("f12", "ctrl+e")
ENDINGS = (signal.SIGTERM, signal.SIGHUP)


class LabApp(App[None]):
    """What a person in the lab works with."""

    TITLE = "labhil"
    CSS_PATH = "lab.tcss"
    ENABLE_COMMAND_PALETTE = True
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (120, "-wide")]  # noqa: RUF012 - theirs is no class variable
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

    def __init__(self, folder: Path, lab: Lab, *, theme: str = DARK.name, tab: str = "devices") -> None:
        super().__init__()
        self.folder, self.lab, self._first_tab = folder, lab, tab
        self.runner = Runner(folder, lambda line: self.post_message(RunSaid(line)))
        self.jobs = Jobs(lambda number, line: self.post_message(StudySaid(number, line)), time.monotonic)
        self.shelf = Shelf(folder)
        self.stopped: Latch | None = None
        self.outcome: Outcome | None = None
        self.leaving = ""
        self._reading = threading.Lock()
        self._pace = Pace()
        self._bar = Text()
        self._panes: tuple[TabPane, ...] = ()
        self.register_theme(DARK)
        self.register_theme(LIGHT)
        self.theme = theme

    def compose(self) -> ComposeResult:
        """The bar, the tabs, the footer."""
        with Horizontal(id="bar"):
            yield Static(" labhil ", id="brand")
            yield Static(id="bar-run")
            yield StopButton(" ■ STOP ALL  F12 ", id="bar-stop")
        yield Static(id="stop-note")
        with TabbedContent(initial=self._first_tab, id="tabs"):
            with TabPane("1 Devices", id="devices"):
                yield DevicesPane(self.lab)
            with TabPane("2 Live", id="live"):
                yield LivePane(self.lab)
            with TabPane("3 Experiment", id="experiment"):
                yield ExperimentPane(self.folder, self.runner, self.lab)
            with TabPane("4 Recordings", id="recordings"):
                yield RecordingsPane(self.folder)
            with TabPane("5 Results", id="results"):
                yield ResultsPane(self.folder, self.jobs)
        yield Footer(show_command_palette=False)

    def on_mount(self) -> None:
        """Begin to look at everything."""
        self._panes = tuple(self.base.query(TabPane))
        self.set_interval(FRAME_INTERVAL, self._draw_plots)
        self.set_interval(FACTS_INTERVAL, self._show_facts)
        self.set_interval(FILES_INTERVAL, self.look_at_files)
        self._look_at_shelf()  # before anybody asks: reading takes a while
        self._show_facts()
        if threading.current_thread() is threading.main_thread():
            loop = asyncio.get_running_loop()
            for number in ENDINGS:
                loop.add_signal_handler(number, self._end_by_signal, number)
        self._focus_tab()

    def on_unmount(self) -> None:
        """End what this screen started; a second call finds nothing to do."""
        self.close_everything()

    def close_everything(self) -> None:
        """End the run, and all work. Safe twice; a run that nobody asked to stop has failed."""
        self.runner.close()
        self.jobs.close()

    def _end_by_signal(self, number: int) -> None:
        self.runner.ask("stop", f"the terminal UI was ended by {signal.Signals(number).name}")
        self.exit(return_code=128 + number)

    async def on_event(self, event: Event) -> None:
        """The emergency stop comes before everything, also where a dialog holds the keys."""
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
        """Show a message; what a device, a file or the bus says in it is no markup."""
        super().notify(message, title=title, severity=severity, timeout=timeout, markup=markup)

    # what is shown

    @property
    def base(self) -> Screen[Any]:
        """The screen with the tabs, whatever lies over it."""
        return self.screen_stack[0]

    @property
    def standing(self) -> bool:
        """Whether there is anything to draw on: not before the first layout, nor while the screen goes."""
        return self.is_running and bool(self._panes) and all(pane.is_attached for pane in self._panes)

    @property
    def tab(self) -> str:
        """The tab in front."""
        return self.base.query_one("#tabs", TabbedContent).active

    def _draw_plots(self) -> None:
        if self.standing and self.tab == "live" and len(self.screen_stack) == 1 and self._pace.due():
            self.base.query_one(LivePane).draw()

    def _end_unseen_run(self) -> None:
        """End the run of this screen where the screen no longer sees what its devices do."""
        blind = self.lab.failure() if self.runner.active and self.runner.state != "aborting" else ""
        if blind:
            self.runner.ask("abort", f"the terminal UI no longer sees the devices: {blind}"[:200])

    def _show_facts(self) -> None:
        self._end_unseen_run()
        if not self.standing:
            return
        self._look_at_latch()
        self._show_bar()
        tab = self.tab
        if tab == "devices":
            self.base.query_one(DevicesPane).refresh_view()
        elif tab == "live":
            self.base.query_one(LivePane).refresh_list()
        elif tab == "experiment":
            self.base.query_one(ExperimentPane).refresh_view()
        elif tab == "results":
            self.base.query_one(ResultsPane).refresh_view()

    def _show_bar(self) -> None:
        colours = self.theme_variables
        line = Text(no_wrap=True, overflow="ellipsis")
        runner = self.runner
        if runner.state != "idle":
            line.append_text(RUN_STATES[runner.state].text(colours))
            line.append(f" {runner.name} ")
            if runner.duration and runner.active:
                line.append(f"{runner.elapsed:.0f} of {runner.duration:.0f} s ", style="bold")
        for job in self.jobs.at_work:
            line.append(f" … {job.title}", style=colours["accent"])
        if not line.plain:
            place = self.folder if self.folder.name else self.folder.absolute()
            line.append(str(place), style=colours["muted"])
        if line != self._bar:
            self._bar = line
            self.base.query_one("#bar-run", Static).update(line, layout=False)

    def look_at_files(self) -> None:
        """Read anew what the tab in front shows of the folder; recordings in a thread, one look at a time."""
        if not self.standing:
            return
        if self.tab == "recordings":
            self._look_at_shelf()
        elif self.tab == "experiment":
            self.base.query_one(ExperimentPane).refresh_list()
        elif self.tab == "results":
            self.base.query_one(ResultsPane).refresh_list()

    def _look_at_shelf(self) -> None:
        if self._reading.acquire(blocking=False):
            self.run_worker(self._read_shelf, thread=True, group="shelf", exit_on_error=False)

    def _read_shelf(self) -> None:
        try:
            for recordings in self.shelf.look():
                self.post_message(ShelfRead(recordings))
        finally:
            self._reading.release()

    def on_shelf_read(self, message: ShelfRead) -> None:
        """The folder as far as it is read."""
        if self.standing:
            self.base.query_one(RecordingsPane).take(message.recordings)

    # tabs

    def action_command_palette(self) -> None:
        """Show the command palette."""
        if not isinstance(self.screen, Palette):
            self.push_screen(Palette(id="--command-palette"))

    def action_tab(self, name: str) -> None:
        """Bring a tab to the front."""
        if len(self.screen_stack) == 1:
            self.base.query_one("#tabs", TabbedContent).active = name

    def on_tabbed_content_tab_activated(self, event: TabbedContent.TabActivated) -> None:
        """Show the newest there, and let keys go to what is worked with."""
        event.stop()
        self._show_facts()
        self.look_at_files()
        self._focus_tab()

    def _focus_tab(self) -> None:
        kinds: dict[str, tuple[str, type[Widget]]] = {
            "devices": ("#devices-table", DataTable),
            "live": ("#live-signals", SelectionList),
            "experiment": ("#experiment-list", OptionList),
            "recordings": ("#recordings-table", DataTable),
            "results": ("#results-table", DataTable),
        }
        self.base.query_one(*kinds[self.tab]).focus()

    # the run

    def on_start_wanted(self, message: StartWanted) -> None:
        """Start a run; what moves real devices is asked for once more."""
        if self.stopped is not None:
            self.notify("The emergency stop is on: F9 releases it.", severity="error")
            return
        pane = self.base.query_one(ExperimentPane)
        addresses = pane.moves_hardware()
        if not addresses:
            self._start(message.path)
            return

        def go(yes: bool | None) -> None:
            if yes:
                self._start(message.path)

        question = f"This moves real devices:\n\n  {', '.join(addresses)}\n\nIs everybody out of their way?"
        self.push_screen(Confirm(question, "Start", "Not yet", danger=True), go)

    def _start(self, path: str) -> None:
        if self.runner.active or self.stopped is not None:
            return
        pane = self.base.query_one(ExperimentPane)
        name = pane.plan.experiment.experiment.name if pane.plan is not None else Path(path).stem
        self.runner.start(Path(path), name)
        pane.log_line("starting", name)
        self._show_facts()

    def on_run_said(self, message: RunSaid) -> None:
        """Follow the run."""
        before = self.runner.state
        self.runner.take(message.line)
        if not self.standing:
            return
        pane = self.base.query_one(ExperimentPane)
        if "result" in message.line:
            pane.take_result(message.line["result"], message.line["error"])
            self.look_at_files()
        elif "refused" in message.line:
            pane.log_line("refused", message.line["refused"])
        if self.runner.state != before or "ended" in message.line:
            self._show_facts()
        if self.leaving and not self.runner.active:
            self.exit()

    # studies

    def on_study_wanted(self, message: StudyWanted) -> None:
        """Start a fit, a diagnosis, …; show it where results are."""
        job = self.jobs.start(message.task)
        if job.task.kind not in ("export", "verify"):
            self.action_tab("results")
        self.notify(f"{job.title}: at work", timeout=2)
        self.base.query_one(ResultsPane).refresh_list()

    async def on_study_said(self, message: StudySaid) -> None:
        """Follow a study."""
        was = self.jobs.all[message.number].state
        job = self.jobs.take(message.number, message.line)
        if not self.standing:
            return
        results = self.base.query_one(ResultsPane)
        if job.state != was:
            self._tell_end(job)
            results.refresh_list()
            self.look_at_files()
            if job.state == "done" and job.task.kind in ("fit", "diagnose"):
                results.show_file(Path(job.done))
        elif self.tab == "results":
            results.refresh_view()

    def _tell_end(self, job: Any) -> None:
        if job.state == "failed":
            self.notify(job.said, title=job.title, severity="error", timeout=10)
        elif job.task.kind == "verify":
            self.push_screen(Tell(job.title, str(job.done)))
        elif job.state == "done":
            self.notify("done", title=job.title)

    # the emergency stop

    def action_stop_all(self) -> None:
        """Bring every device in reach to its safe state, and hold all runs until it is released."""
        self.outcome = None
        self.run_worker(self._stop_devices, thread=True, group="stop", exit_on_error=False)

    def _stop_devices(self) -> None:
        outcome = self.lab.stop_all("emergency stop in the terminal UI")
        self.call_later(self._take_outcome, outcome)

    def _take_outcome(self, outcome: Outcome) -> None:
        self.outcome = outcome
        if not self.standing:
            return
        log = self.base.query_one(ExperimentPane)
        for name, state in outcome.answered.items():
            log.log_line("stop all", f"in its safe state, {state}", name)
        for name, why in outcome.failed.items():
            log.log_line("stop all", f"did not stop properly: {why}", name)
        for name in outcome.silent:
            log.log_line("stop all", "NO ANSWER: switch its power off", name)
        self._look_at_latch(again=True)

    def _look_at_latch(self, *, again: bool = False) -> None:
        """Show the emergency stop, whoever pressed it."""
        standing = self.lab.latch
        if standing == self.stopped and not again:
            return
        self.stopped = standing
        note = self.base.query_one("#stop-note", Static)
        note.display = standing is not None
        if standing is None:
            self.outcome = None
        else:
            note.update(stop_note(standing, self.outcome))
        self.refresh_bindings()

    def action_release(self) -> None:
        """Allow runs again, once somebody has said so."""

        def go(yes: bool | None) -> None:
            if yes:
                self.run_worker(self._release, thread=True, group="stop", exit_on_error=False)

        question = "Release the emergency stop?\n\nNothing moves by that; devices may be commanded again."
        self.push_screen(Confirm(question, "Release", "Keep it"), go)

    def _release(self) -> None:
        try:
            self.lab.release()
        except LabhilError as error:
            self.call_later(self.notify, str(error), severity="error")
        self.call_later(self.base.query_one(ExperimentPane).log_line, "released", "runs may be started again")
        self.call_later(self._look_at_latch)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """There is something to release only after a stop."""
        if action == "release":
            return self.stopped is not None and len(self.screen_stack) == 1
        return True

    # leaving

    def action_leave(self) -> None:
        """Quit; with a run on, only after a question, and after the run has ended in order."""
        if self.leaving:
            self.exit()
            return
        if self.runner.active:
            question = (
                "A run is on.\n\nStop it and quit? Devices go to their safe state, the recording is kept."
            )
        elif self.jobs.at_work:
            titles = "\n  ".join(job.title for job in self.jobs.at_work)
            question = f"Still at work:\n\n  {titles}\n\nCancel and quit?"
        else:
            self.exit()
            return
        if isinstance(self.screen, Confirm):
            return
        self.push_screen(Confirm(question, "Stop and quit", "Stay"), self._leave)

    def _leave(self, yes: bool | None) -> None:
        if not yes:
            return
        if not self.runner.active:
            self.exit()
            return
        self.leaving = "stopping"
        self.runner.ask("stop", "the terminal UI is quit")
        self.notify("Stopping the run …", timeout=30)

    def action_keys(self) -> None:
        """Show all keys of the screen in front, or put them away again."""
        if self.screen.query(HelpPanel):
            self.action_hide_help_panel()
        else:
            self.action_show_help_panel()

    def action_toggle_theme(self) -> None:
        """From dark to light, and back."""
        self.theme = LIGHT.name if self.theme == DARK.name else DARK.name

    # the command palette

    def get_system_commands(self, screen: Screen[Any]) -> Iterable[SystemCommand]:
        """Only what makes sense now; names of files and experiments in it are no markup."""
        for name, about, action, *_ in commands(self, self.base.query_one(ExperimentPane)):
            yield SystemCommand(escape(name), escape(about), action)
