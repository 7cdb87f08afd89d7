"""The tab of experiments: choose one, read its plan, and run it."""

from __future__ import annotations

from collections import deque
from datetime import datetime
from pathlib import Path
from shlex import quote
from typing import Any, ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Horizontal, Vertical, VerticalScroll
from textual.widgets import Button, OptionList, ProgressBar, Static
from textual.widgets.button import ButtonVariant
from textual.widgets.option_list import Option

from labhil.errors import LabhilError
from labhil.experiment.control import MAX_MARK_LENGTH, RECORDED
from labhil.experiment.experiment import TWIN, Experiment, load_experiment
from labhil.experiment.plan import Plan, make_plan
from labhil.experiment.points import count_runs, is_campaign
from labhil.host_clock import steady_ns
from labhil.tui.dialogs import TextPrompt
from labhil.tui.formatting import RUN_STATES, format_duration
from labhil.tui.lists import LabOptions
from labhil.tui.messages import StartRequested
from labhil.tui.panes import Pane
from labhil.tui.recording_library import ExperimentFile, list_experiments
from labhil.tui.runner import Runner
from labhil.tui.session import Session

BUTTONS: tuple[tuple[str, str, ButtonVariant], ...] = (
    ("start", "Start ⏎", "success"),
    ("pause", "Pause p", "warning"),
    ("resume", "Resume r", "success"),
    ("stop", "Stop s", "primary"),
    ("abort", "Abort a", "error"),
)
ALLOWED = {
    "start": ("idle", "finished", "failed"),
    "pause": ("running",),
    "resume": ("paused",),
    "stop": ("starting", "running", "paused"),
    "abort": ("starting", "running", "paused"),
}
"""States of a run in which each control is enabled."""

MARKABLE = tuple(state.value for state in RECORDED)
"""States of a run in which a marker is recorded."""

MOST_VALUES = 8
"""Values of a swept place that are shown."""

MOST_LINES = 200
"""Lines kept in the log; the recording holds every event."""


class ExperimentPane(Vertical, Pane):
    """Show the list of experiments, the plan of the chosen one, the run, and its events."""

    MAIN_WIDGET = "#experiment-list"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("p", "control('pause')", "Pause", id="run.pause", tooltip="Devices safe, the run waits"),
        Binding("r", "control('resume')", "Resume", id="run.resume", tooltip="Go on where it was paused"),
        Binding("s", "control('stop')", "Stop", id="run.stop", tooltip="End now; what is recorded is kept"),
        Binding("a", "control('abort')", "Abort", id="run.abort", tooltip="End now; marked as failed"),
        Binding("m", "mark", "Mark", id="run.mark", tooltip="A marker at this moment of the recording"),
    ]

    def __init__(self, folder: Path, runner: Runner, session: Session) -> None:
        super().__init__(id="experiment-pane")
        self._folder, self._runner, self._session = folder, runner, session
        self._files: list[ExperimentFile] = []
        self.plan: Plan | None = None
        """Plan of the chosen experiment; None where it cannot be started here."""
        self._refusal = ""
        self._logged_ns = 0
        self._log: deque[Text] = deque(maxlen=MOST_LINES)
        self._shown_buttons: dict[str, bool] = {}

    def compose(self) -> ComposeResult:
        """Lay out the list, the plan, the controls and the log."""
        with Container(id="experiment-choice"):
            yield LabOptions(id="experiment-list", markup=False)
            with VerticalScroll(id="plan-scroll"):
                yield Static(id="plan")
        with Horizontal(id="run-line"):
            yield Static(id="run-state")
            yield ProgressBar(id="run-progress", show_eta=False, show_percentage=False)
            yield Static(id="run-elapsed")
        with Horizontal(id="run-buttons"):
            for name, label, variant in BUTTONS:
                yield Button(label, id=f"run-{name}", variant=variant, compact=True)
            yield Static(id="run-reason")
        with VerticalScroll(id="run-log"):
            yield Static(id="run-log-lines")

    def on_mount(self) -> None:
        """Fill the list."""
        self.refresh_list()
        self.refresh_view()

    def refresh_list(self) -> None:
        """List the experiment files again."""
        files = list_experiments(self._folder)
        if files == self._files:
            return
        self._files = files
        options = self.query_one(OptionList)
        options.clear_options()
        local_files = [file for file in files if not file.packaged]
        muted = self.app.theme_variables["muted"]
        if local_files:
            options.add_option(Option(Text("in this folder", style=f"italic {muted}"), disabled=True))
        for index, file in enumerate(files):
            if file.packaged and (index == 0 or not files[index - 1].packaged):
                options.add_option(Option(Text("examples, simulated", f"italic {muted}"), disabled=True))
            sign = " " if file.readable else "✕"
            options.add_option(Option(f"{sign} {file.name}", id=str(index)))
        options.highlighted = 1 if files else None

    def on_option_list_option_highlighted(self, event: OptionList.OptionHighlighted) -> None:
        """Show the plan of the chosen experiment."""
        if event.option.id is not None:
            self._show_plan(self._files[int(event.option.id)])

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Start the chosen experiment."""
        if event.option.id is not None:
            self.action_control("start")

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Do the same as the key of the button."""
        event.stop()
        self.action_control((event.button.id or "").removeprefix("run-"))

    def action_control(self, name: str) -> None:
        """Start, pause, resume, stop or abort the run, where its state allows it."""
        if self._runner.state not in ALLOWED[name]:
            return
        if name != "start":
            self._runner.request(name)
        elif self.plan is not None:
            self.post_message(StartRequested(str(self.plan.experiment.path)))
        elif self._refusal:
            self.app.notify(self._refusal, severity="warning")

    def action_mark(self) -> None:
        """Ask for the text of a marker, which is recorded at the time of the key."""
        if self._runner.state not in MARKABLE:
            return
        pressed_ns = steady_ns()

        def mark(text: str | None) -> None:
            if text is not None:
                self._runner.mark(text, pressed_ns)

        self.app.push_screen(TextPrompt("What happened at this moment?", MAX_MARK_LENGTH), mark)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Enable only the keys that have an effect now."""
        if action == "control":
            return self._allows(str(parameters[0]))
        if action == "mark":
            return self._runner.state in MARKABLE
        return True

    def _allows(self, name: str) -> bool:
        """Whether a control has an effect now."""
        return self._runner.state in ALLOWED[name] and (name != "start" or self.plan is not None)

    def moves_hardware(self) -> list[str]:
        """Return the addresses of real devices that the chosen experiment would move."""
        if self.plan is None:
            return []
        return [d.section.address for d in self.plan.devices if d.section.address != TWIN]

    def _show_plan(self, file: ExperimentFile) -> None:
        colours = self.app.theme_variables
        text = Text()
        self.plan, self._refusal = None, f"{file.path.name} cannot be run: its plan says why."
        try:
            experiment = load_experiment(file.path)
            plan = make_plan(experiment)
        except LabhilError as error:
            text.append("✕ cannot be run\n", style=f"bold {colours['error']}")
            text.append(str(error))
        else:
            if is_campaign(experiment):
                self._refusal = f"Not started here: `{command(file.path)}` makes all runs of this file."
                text.append_text(campaign_text(experiment, file.path, colours))
            else:
                self.plan = plan
            text.append_text(plan_text(plan, colours))
        place = f"comes with labhil as {file.path.name}" if file.packaged else str(file.path)
        text.append(f"\n\n{place}", style=colours["muted"])
        self.query_one("#plan", Static).update(text)
        self._refresh_buttons()

    # the run

    def refresh_view(self) -> None:
        """Show the progress of the run, and the new events."""
        runner, colours = self._runner, self.app.theme_variables
        self.query_one("#run-state", Static).update(RUN_STATES[runner.state].text(colours))
        bar = self.query_one(ProgressBar)
        bar.update(total=max(runner.duration, 1e-9), progress=runner.elapsed)
        has_duration = runner.duration > 0
        elapsed = f"{runner.elapsed:.1f} of {format_duration(runner.duration)}" if has_duration else ""
        self.query_one("#run-elapsed", Static).update(elapsed)
        self.query_one("#run-reason", Static).update(Text(runner.reason, style=colours["muted"]))
        self._log_events()
        self._refresh_buttons()

    def _refresh_buttons(self) -> None:
        """Enable the buttons of the controls that have an effect now."""
        allowed = {name: self._allows(name) for name, _, _ in BUTTONS}
        if allowed != self._shown_buttons:
            self._shown_buttons = allowed
            for name, is_allowed in allowed.items():
                self.query_one(f"#run-{name}", Button).disabled = not is_allowed
            self.refresh_bindings()

    def _log_events(self) -> None:
        events = [event for event in self._session.events() if event.t_ns > self._logged_ns]
        for event in events:
            self._logged_ns = event.t_ns
            self.log_line(event.kind, event.message, event.device, event.t_ns)

    def log_line(self, kind: str, message: str, device: str = "", t_ns: int | None = None) -> None:
        """Add a line to the log.

        Args:
            kind: Kind of the event.
            message: Its text.
            device: The device; empty for the screen itself.
            t_ns: Unix time, ns; None for now.
        """
        colours = self.app.theme_variables
        moment = datetime.now() if t_ns is None else datetime.fromtimestamp(t_ns * 1e-9)
        line = Text()
        line.append(f"{moment:%H:%M:%S} ", style=colours["muted"])
        line.append(f"{device or 'screen':<8.8} ", style="bold")
        is_alarm = kind in ("tripped", "failed", "watchdog", "refused", "aborting", "stop all")
        sign = "▲ " if is_alarm else ""
        line.append(f"{sign}{kind}", style=colours["error" if is_alarm else "primary"])
        line.append(f"  {message}")
        self._log.append(line)
        self.query_one("#run-log-lines", Static).update(Text("\n").join(self._log))
        self.query_one("#run-log").scroll_end(animate=False)

    def take_result(self, result: dict[str, Any] | None, error: str | None) -> None:
        """Log the result of a run."""
        if error:
            self.log_line("failed", error)
        if result is not None and result["path"] is not None:
            self.log_line("recorded", f"{result['path']}  (4 shows it)")


def command(path: Path) -> str:
    """Return the command that makes the runs of a file, as a shell takes it."""
    return f"labhil run {quote(str(path))}"


def campaign_text(experiment: Experiment, path: Path, colours: dict[str, str]) -> Text:
    """Return how many runs a file with ``repeat`` or [sweep] has, and the command that makes them.

    Args:
        experiment: The file's contents.
        path: The file.
        colours: Colours of the theme.
    """
    text = Text(f"◆ {count_runs(experiment)} runs", style=f"bold {colours['accent']}")
    text.append("; not started here\n", style="not bold")
    text.append(f"{command(path)}\n")
    text.append("makes them all, with --dry-run it lists them\n\n", style=colours["muted"])
    if experiment.sweep is not None:
        for place, values in experiment.sweep.over.items():
            shown = [str(value) for value in values[:MOST_VALUES]]
            more = f" … {len(values)} values" if len(values) > MOST_VALUES else ""
            text.append(f"{place}: {', '.join(shown)}{more}\n", style="not bold")
    if experiment.experiment.repeat > 1:
        text.append(f"each {experiment.experiment.repeat} times\n", style="not bold")
    return text.append("\nWith the values of the file itself:\n", style=colours["muted"])


def plan_text(plan: Plan, colours: dict[str, str]) -> Text:
    """Return the text of ``labhil run --dry-run``, with its warnings first."""
    text = Text()
    for warning in plan.warnings():
        text.append(f"▲ {warning}\n", style=colours["warning"])
    heading, *lines = plan.describe().splitlines()
    text.append(f"{heading}\n", style="bold")
    notes = {f"  note: {warning}" for warning in plan.warnings()}
    text.append("\n".join(line for line in lines if line not in notes))
    return text
