"""The tab of live plots: the chosen signals, drawn from the newest samples of their streams."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.widgets import SelectionList, Static
from textual.widgets.selection_list import Selection

from labhil.signals import Direction, FloatArray
from labhil.tui import clock
from labhil.tui.background import work_in_background
from labhil.tui.curve import column_curves
from labhil.tui.dialogs import Choose
from labhil.tui.formatting import format_duration
from labhil.tui.lists import LabSelection
from labhil.tui.panes import Pane
from labhil.tui.plot import PLOT_HELP, Chart
from labhil.tui.recording_library import list_models
from labhil.tui.replay_control import control_replays, replay_line
from labhil.tui.session import Session, SignalSource
from labhil.tui.shadow import ShadowView
from labhil.tui.stream_watch import trace
from labhil.tui.themes import CURVES
from labhil.tui.ticks import Limits, axis_limits

WINDOWS = (2.0, 5.0, 10.0, 20.0, 60.0)
MOST_CHARTS = 6
MOST_CURVES = 6

EMPTY = """[b]Nothing to plot yet.[/b]

Signals of every device on the bus appear here by themselves.
[b $accent]3[/] then [b $accent]Enter[/] runs the example on a simulated bench."""


class LivePane(Horizontal, Pane):
    """Show a list of signals, and a chart for each chosen one."""

    MAIN_WIDGET = "#live-signals"
    HELP = f"{PLOT_HELP} First press z, which holds the picture still."
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("z", "freeze", "Freeze", id="live.freeze", tooltip="Hold the picture still, to look around"),
        Binding("full_stop", "window(1)", "More", id="live.longer", tooltip="Show more of the past"),
        Binding("comma", "window(-1)", "Less", id="live.shorter", tooltip="Show less of the past"),
        Binding("y", "rescale", "Fit y", id="live.rescale", tooltip="Limits from what is shown now"),
        Binding("p", "replay('toggle')", "Pause", id="replay.pause", tooltip="Hold the replay, or go on"),
        Binding("greater_than_sign", "replay('speed', 1)", "Faster", id="replay.faster", show=False),
        Binding("less_than_sign", "replay('speed', -1)", "Slower", id="replay.slower", show=False),
        Binding("j", "replay('back')", "10 s back", id="replay.back", show=False),
        Binding("b", "shadow", "Model", id="live.shadow", tooltip="An accepted model beside the device"),
        Binding("l", "list", "Signals", id="live.list", tooltip="Show or hide the list of signals"),
    ]

    def __init__(self, session: Session, folder: Path) -> None:
        super().__init__(id="live-pane")
        self._session, self._folder = session, folder
        self._sources: dict[str, SignalSource] = {}
        self._charts: dict[str, Chart] = {}
        self._limits: dict[str, Limits] = {}
        self._window = 2
        self._state_line = Text()
        self.frozen = self._replayed = False

    def compose(self) -> ComposeResult:
        """Lay out the list, the state and the charts."""
        yield LabSelection(id="live-signals")
        with Vertical(id="live-main"):
            yield Static(id="live-state")
            yield Static(EMPTY, id="live-empty")
            yield VerticalScroll(id="live-charts", can_focus=False)
            yield ShadowView()

    @property
    def window(self) -> float:
        """Length of the time axis, s."""
        return WINDOWS[self._window]

    def refresh_view(self) -> None:
        """Add signals that appeared, and remove those that are gone."""
        if self.frozen:
            return  # a frozen picture stays, whatever comes and goes meanwhile
        replayed = bool(self._session.replays())
        if replayed != self._replayed:
            self._replayed = replayed
            self.refresh_bindings()
        sources = {source.key: source for source in self._session.signal_sources()}
        if sources.keys() == self._sources.keys():
            return
        signal_list = self.query_one(SelectionList)
        chosen = set(signal_list.selected)
        new = [source for key, source in sources.items() if key not in self._sources]
        self._sources = sources
        signal_list.clear_options()
        several = len({(source.endpoint, source.device) for source in sources.values()}) > 1
        chosen |= {source.key for source in _first_choice(new)}
        for key, source in sources.items():
            name = f"{source.device} {source.signal.name}" if several else source.signal.name
            signal_list.add_option(Selection(Content(f"{name}, {source.signal.unit}"), key, key in chosen))
        self.call_after_refresh(self._choose)

    def on_selection_list_selected_changed(self, _event: SelectionList.SelectedChanged[str]) -> None:
        """Show charts of the chosen signals."""
        self.call_after_refresh(self._choose)

    async def _choose(self) -> None:
        signal_list = self.query_one(SelectionList)
        chosen = [key for key in self._sources if key in set(signal_list.selected)][:MOST_CHARTS]
        if chosen == list(self._charts):
            return
        area = self.query_one("#live-charts")
        await area.remove_children()
        self._charts = {key: Chart(classes="live-chart") for key in chosen}
        await area.mount_all(self._charts.values())
        self.draw()

    def draw(self) -> None:
        """Draw the newest samples, unless the charts are frozen."""
        self._show_state()
        if self.frozen:
            return
        now_ns = clock.clock_ns()
        for number, (key, chart) in enumerate(self._charts.items()):
            source = self._sources.get(key)  # a signal that has just gone has its chart until the next layout
            if source is not None and chart.is_attached:
                self._draw_chart(chart, source, now_ns, number)
        self.query_one(ShadowView).draw(self.window)

    def _draw_chart(self, chart: Chart, source: SignalSource, now_ns: int, number: int) -> None:
        stream_watch = self._session.stream(source)
        if stream_watch is None:
            return
        ago, values = trace(stream_watch, source.signal.name, self.window, now_ns)
        shown = ago >= -self.window
        ago, values = ago[shown], values[shown]
        limits = self._grow_limits(source.key, values)
        gap = 5.0 / (stream_watch.stream.rate * stream_watch.speed)
        columns = min(source.signal.width, MOST_CURVES)
        curves = column_curves(ago, values, columns, number, max(gap, 0.05))
        value = self._value(ago, values)
        chart.show(self._title(source, number), curves, (-self.window, 0.0), limits, value=value)

    def _title(self, source: SignalSource, number: int) -> Text:
        colours = self.app.theme_variables
        name = (source.signal.name, f"bold {colours[f'curve-{number % CURVES}']}")
        place = (f" of {source.device}, {source.signal.unit}", colours["muted"])
        return Text.assemble(name, place)

    def _value(self, ago: FloatArray, values: FloatArray) -> Text | None:
        """The newest value, or that none comes in; nothing for a vector."""
        if not len(ago) or ago[-1] < -1.0:
            return Text("◌ nothing comes in", style=f"bold {self.app.theme_variables['warning']}")
        if values.shape[1] == 1:
            return Text(f"{values[-1, 0]:+.4f}".replace("-", "−"), style="bold")
        return None

    def _grow_limits(self, key: str, values: FloatArray) -> Limits:
        """Limits that grow with the data and never shrink by themselves: changing axes are hard to read."""
        limits = self._limits.get(key)
        if not values.size:
            return limits or (-1.0, 1.0)
        low, high = axis_limits([values])
        if limits is not None:
            low, high = min(low, limits[0]), max(high, limits[1])
        self._limits[key] = (low, high)
        return low, high

    def _show_state(self) -> None:
        colours = self.app.theme_variables
        self.query_one("#live-empty").display = not self._sources
        line = Text(no_wrap=True, overflow="ellipsis")
        if self.frozen:
            line.append("‖ FROZEN ", style=f"bold {colours['warning']}")
            line.append("the recording goes on; z goes on here, arrows and + − look around", colours["muted"])
        elif replays := self._session.replays():
            line.append_text(replay_line(replays[0][1], colours))
        elif self._sources:
            line.append(f"▶ the last {format_duration(self.window)}", style="bold")
            line.append(f", {len(self._charts)} of {len(self._sources)} signals", style=colours["muted"])
        if line != self._state_line:
            self._state_line = line
            self.query_one("#live-state", Static).update(line, layout=False)

    def action_freeze(self) -> None:
        """Freeze the charts, or go on."""
        self.frozen = not self.frozen
        self.refresh_view()
        self.draw()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Enable the keys of a replay only during one."""
        return bool(self._session.replays()) if action == "replay" else True

    def action_replay(self, what: str, way: int = 0) -> None:
        """Control the replay; a thread waits for its answer.

        Args:
            what: "toggle", "speed" or "back".
            way: Faster (1) or slower (−1).
        """

        def control() -> None:
            error = control_replays(self._session, what, way)
            if error:
                self.app.call_later(self.app.notify, error, severity="error")

        work_in_background(self, control, "controlling the replay", "replay")

    def action_shadow(self) -> None:
        """Simulate an accepted model beside the device of the chosen signal, or stop it."""
        view = self.query_one(ShadowView)
        if view.state is not None:
            view.stop()
            return
        source = self._model_source()
        choices = list_models(self._folder)
        if source is None or not choices:
            lacking = (
                "a device that sends samples" if source is None else "a fit or a diagnosis in this folder"
            )
            self.notify(f"A model beside a device needs {lacking}.", severity="warning")
            return

        def on_answer(choice: str | None) -> None:
            if choice is not None:
                view.start(source, Path(choice))

        names = [(str(result.path), result.path.name) for result in choices]
        self.app.push_screen(Choose(f"Which model runs beside {source.device}?", names), on_answer)

    def _model_source(self) -> SignalSource | None:
        """The first measured signal of the highlighted device, or else of any."""
        signal_list = self.query_one(SelectionList)
        outputs = [p for p in self._sources.values() if p.signal.direction is Direction.OUTPUT]
        if signal_list.highlighted is None or not outputs:
            return next(iter(outputs), None)
        source = self._sources.get(signal_list.get_option_at_index(signal_list.highlighted).value)
        of_device = [
            p
            for p in outputs
            if source is not None and (p.endpoint, p.device) == (source.endpoint, source.device)
        ]
        return next(iter(of_device or outputs))

    def action_window(self, change: int) -> None:
        """Lengthen or shorten the time axis."""
        self._window = min(max(self._window + change, 0), len(WINDOWS) - 1)
        self.draw()

    def action_rescale(self) -> None:
        """Fit the limits to the visible samples."""
        self._limits.clear()
        self.draw()

    def action_list(self) -> None:
        """Show or hide the list of signals."""
        self.toggle_class("list-toggled")


def _first_choice(sources: list[SignalSource]) -> list[SignalSource]:
    """The default plots: outputs and inputs of the first device's first stream."""
    wanted = [p for p in sources if p.signal.direction in (Direction.OUTPUT, Direction.INPUT)]
    return sorted(wanted, key=lambda source: source.signal.direction is not Direction.OUTPUT)[:3]
