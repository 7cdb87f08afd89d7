"""The tab of results: studies at work with their progress, and finished ones as text and charts."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Vertical, VerticalScroll
from textual.events import Resize
from textual.widgets import DataTable, Static
from textual.widgets.data_table import CellDoesNotExist

from labhil.campaign.studies.curves import read_curves
from labhil.campaign.studies.jobs import Job, Jobs
from labhil.campaign.studies.study import Task
from labhil.tui.formatting import format_duration
from labhil.tui.lists import LabTable
from labhil.tui.messages import StudyRequested
from labhil.tui.overlay import ModelsScreen, OverlayScreen
from labhil.tui.panes import Pane
from labhil.tui.plot import PLOT_HELP, Chart
from labhil.tui.recording_library import ResultFile, list_results
from labhil.tui.result_files import (
    NO_CURVES,
    ResultPart,
    charts_of,
    has_model,
    in_a_line,
    in_full,
    read_part,
    shorten,
)
from labhil.tui.studies import has_result

EMPTY = """[b]No fit and no diagnosis in this folder yet.[/b]

  [b $accent]4[/] then [b $accent]f[/]   fits the chosen recording
  [b $accent]4[/] then [b $accent]d[/]   asks what physics the model leaves out"""

NAME_WIDTH = 25
COLUMNS = {"sign": 2, "kind": 9, "of": NAME_WIDTH, "result": 20}
"""Width of each column; the last has what is left, but never less than this."""
PADDING = SIDES = 2
"""Blanks around a cell, and on both sides of the table."""
ENDS_EARLY = ("fit", "diagnose")
"""Kinds of studies that have a best result so far."""
MOST_COMPARED = 8
KINDS = {"comparison": "compared", "verification": "verified"}
SIGNS = {"at work": "…", "done": "✓", "failed": "✕", "cancelled": "■"}


class ResultsPane(Vertical, Pane):
    """Show the list of results, and the chosen one below."""

    MAIN_WIDGET = "#results-table"
    HELP = PLOT_HELP
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(
            "g",
            "charts",
            "Charts",
            id="result.charts",
            tooltip="Text or charts, where there is no room for both",
        ),
        Binding(
            "o",
            "overlay",
            "Overlay",
            id="result.overlay",
            tooltip="The marked models, or each term of the chosen one, on and off over the measurement",
        ),
        Binding(
            "space",
            "mark",
            "Mark",
            id="result.mark",
            tooltip="Take this model into a comparison, or out of it",
        ),
        Binding(
            "k",
            "compare",
            "Compare",
            id="result.compare",
            tooltip="Which of the marked models explains the recording best",
        ),
        Binding("e", "end", "End now", id="job.end", tooltip="End this work with the best so far"),
        Binding(
            "c,delete", "cancel", "Cancel", id="job.cancel", tooltip="End this work; files stay as they were"
        ),
    ]

    def __init__(self, folder: Path, jobs: Jobs) -> None:
        super().__init__(id="results-pane")
        self._folder, self._jobs = folder, jobs
        self._files: list[ResultFile] = []
        self._parts: dict[tuple[Path, float], ResultPart | str] = {}
        self._shown = ""
        self._keys: list[str] = []
        self._marks: set[Path] = set()

    def compose(self) -> ComposeResult:
        """Lay out the list, the text and the charts."""
        yield Static(EMPTY, id="results-empty")
        yield LabTable(id="results-table", cursor_type="row", cursor_foreground_priority="renderable")
        with Container(id="result-split"):
            with VerticalScroll(id="result-scroll"):
                yield Static(id="result-text")
            yield VerticalScroll(id="result-charts", can_focus=False)

    def on_mount(self) -> None:
        """Make the columns."""
        table = self.query_one(DataTable)
        for key, width in COLUMNS.items():
            table.add_column("" if key == "sign" else key, key=key, width=width)
        self.refresh_list()

    def on_resize(self, event: Resize) -> None:
        """Give the results the width that the other columns leave."""
        table, chosen = self.query_one(DataTable), self._chosen_key()
        used = sum(width + PADDING for key, width in COLUMNS.items() if key != "result")
        width = max(COLUMNS["result"], event.size.width - SIDES - used - PADDING)
        column = next(column for key, column in table.columns.items() if key == "result")
        if width != column.width:
            column.width = width
            self._fill(dict(self._rows()))
            if chosen in self._keys:
                table.move_cursor(row=self._keys.index(chosen))

    def _fill(self, rows: dict[str, tuple[Text, ...]]) -> None:
        table = self.query_one(DataTable)
        table.clear()
        for key, row in rows.items():
            table.add_row(*row, key=key)
        self._keys = list(rows)

    def refresh_list(self) -> None:
        """List the results again, and show the progress of the jobs."""
        self._files = list_results(self._folder)
        for file in self._files:
            key = (file.path, file.modified)
            if key not in self._parts:
                self._parts[key] = read_part(file.path)
        self.refresh_view()

    def refresh_view(self) -> None:
        """Show the progress of the jobs."""
        rows = dict(self._rows())
        self.query_one("#results-empty").display = not rows
        self.query_one("#result-split").display = bool(rows)
        table = self.query_one(DataTable)
        table.display = bool(rows)
        if list(rows) == self._keys:
            for key, row in rows.items():
                for column, cell in zip(COLUMNS, row, strict=True):
                    if table.get_cell(key, column) != cell:
                        table.update_cell(key, column, cell)
            job = self._job(self._chosen_key())
            if job is not None:
                self._show_job(job)
            return
        chosen = self._chosen_key()
        new = [key for key in rows if key not in self._keys]
        self._fill(rows)
        if new and self._shown:  # the user waits for the newest row
            table.move_cursor(row=self._keys.index(new[0]))
        elif chosen in rows:
            table.move_cursor(row=self._keys.index(chosen or ""))

    def _rows(self) -> Iterator[tuple[str, tuple[Text, ...]]]:
        colours = self.app.theme_variables
        for job in reversed(self._jobs.all):
            if has_result(job):
                continue  # its file is in the list
            colour = {"failed": "error", "at work": "accent"}.get(job.state, "muted")
            names = job.title.partition(" ")[2]
            yield (
                f"job {job.number}",
                (
                    Text(SIGNS[job.state], style=f"bold {colours[colour]}"),
                    Text(job.task.kind),
                    Text(shorten(names, NAME_WIDTH)),
                    Text(self._job_line(job), style=colours[colour], no_wrap=True, overflow="ellipsis"),
                ),
            )
        for file in self._files:
            part = self._parts[file.path, file.modified]
            sign, colour = ("✕", "error") if isinstance(part, str) else ("✓", "success")
            if file.path in self._marks:
                sign, colour = "●", "accent"
            yield (
                f"file {file.path} {file.modified}",
                (
                    Text(sign, style=f"bold {colours[colour]}"),
                    Text(KINDS.get(file.kind, file.kind)),
                    Text(
                        shorten(
                            file.path.name.removesuffix(".json").replace(f".{file.kind}", "", 1), NAME_WIDTH
                        )
                    ),
                    Text(
                        part if isinstance(part, str) else in_a_line(part), no_wrap=True, overflow="ellipsis"
                    ),
                ),
            )

    def _job_line(self, job: Job) -> str:
        if job.state == "at work":
            elapsed, limit = time.monotonic() - job.started, job.task.seconds
            remaining = (
                "" if limit is None else f", at most {format_duration(max(limit - elapsed, 0.0))} left"
            )
            return f"{format_duration(elapsed)}{remaining}: {job.message}"
        return str(job.message).splitlines()[0] if job.message else job.state

    def _chosen_key(self) -> str | None:
        table = self.query_one(DataTable)
        try:
            return table.coordinate_to_cell_key(table.cursor_coordinate).row_key.value
        except CellDoesNotExist:
            return None

    def _job(self, key: str | None) -> Job | None:
        return self._jobs.all[int(key[4:])] if key and key.startswith("job ") else None

    def show_file(self, path: Path) -> None:
        """Choose the result in this file."""
        self.refresh_list()
        for index, key in enumerate(self._keys):
            if key.startswith(f"file {path} "):
                self.query_one(DataTable).move_cursor(row=index)

    async def on_data_table_row_highlighted(self, _event: DataTable.RowHighlighted) -> None:
        """Show the chosen result."""
        await self.show_chosen()

    async def show_chosen(self) -> None:
        """Show the chosen result or job."""
        key = self._chosen_key()
        self.refresh_bindings()
        job = self._job(key)
        if job is not None:
            await self.query_one("#result-charts").remove_children()
            self._shown = key or ""
            self._show_job(job)
        elif key is not None and key != self._shown:
            self._shown = key
            for file in self._files:
                if key == f"file {file.path} {file.modified}":
                    await self._show_part(file.path, self._parts[file.path, file.modified])

    def _show_job(self, job: Job) -> None:
        colours = self.app.theme_variables
        text = Text(f"{SIGNS[job.state]} {job.title}\n", style="bold")
        text.append(f"{self._job_line(job)}\n\n", style="not bold")
        if job.state == "at work":
            text.append(
                "It works in a process of its own: go on with anything else.\n", style=colours["muted"]
            )
            if job.task.kind in ENDS_EARLY:
                text.append("e ends it now with the best so far. ", style=colours["muted"])
            text.append("c cancels it; files stay as they were.", style=colours["muted"])
        elif job.done is not None:
            answer = (
                job.done if isinstance(job.done, str) else "\n".join(f"written: {path}" for path in job.done)
            )
            text.append(answer, style="not bold")
        else:
            text.append(job.message, style="not bold")
        self.query_one("#result-text", Static).update(text)

    async def _show_part(self, path: Path, part: ResultPart | str) -> None:
        colours = self.app.theme_variables
        area, text = self.query_one("#result-charts"), self.query_one("#result-text", Static)
        await area.remove_children()
        self.set_class(not has_model(part), "without-charts")
        if isinstance(part, str):
            text.update(Text(f"✕ {part}", style=colours["error"]))
            return
        text.update(in_full(part, colours))
        self.query_one("#result-scroll").scroll_home(animate=False)
        if not has_model(part):
            return
        charts: list[Chart] = []
        for title, curves in charts_of(part, read_curves(path)):
            charts.append(Chart(classes="result-chart"))
            charts[-1].show(title, curves)
        if area.is_attached:  # the screen may be left while a thread reads
            await area.mount_all(charts or [Static(NO_CURVES, classes="result-note")])

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Enable only the keys that apply to the chosen row and the marks."""
        if action == "charts":
            is_model = self.is_mounted and self._chosen_file() is not None
            return is_model and self.screen.has_class("-narrow")
        several = len(self._marked_files()) > 1
        if action in ("overlay", "mark"):
            return self.is_mounted and (self._chosen_file() is not None or (several and action == "overlay"))
        if action == "compare":
            return several
        if action in ("cancel", "end"):
            job = self._job(self._chosen_key()) if self.is_mounted else None
            at_work = job is not None and job.state == "at work"
            return at_work and (action == "cancel" or (job is not None and job.task.kind in ENDS_EARLY))
        return True

    def _chosen_file(self) -> Path | None:
        """The chosen result, where it has a model."""
        key = self._chosen_key()
        for file in self._files:
            if key == f"file {file.path} {file.modified}":
                return file.path if has_model(self._parts[file.path, file.modified]) else None
        return None

    def _marked_files(self) -> Sequence[Path]:
        """The marked results that still exist, in the order of the list."""
        return [file.path for file in self._files if file.path in self._marks]

    def action_mark(self) -> None:
        """Mark the chosen model, or remove its mark."""
        path = self._chosen_file()
        if path is not None:
            self._marks ^= {path}
            self.refresh_view()
            self.refresh_bindings()

    def action_compare(self) -> None:
        """Compare the marked models on the recording that the first was tested on."""
        paths = self._marked_files()
        if len(paths) > 1 and not self._refuse_excess(paths):
            self.post_message(StudyRequested(Task("compare", tuple(paths))))
            self._marks.clear()

    def _refuse_excess(self, paths: Sequence[Path]) -> bool:
        """Whether these are too many to compare at once; if so, a warning is shown."""
        if len(paths) > MOST_COMPARED:
            self.app.notify(f"At most {MOST_COMPARED} models are compared at once.", severity="warning")
        return len(paths) > MOST_COMPARED

    def action_overlay(self) -> None:
        """Show the marked models over the measurement, or the terms of the chosen one."""
        path, marked = self._chosen_file(), self._marked_files()
        if len(marked) > 1:
            if not self._refuse_excess(marked):
                self.app.push_screen(ModelsScreen(marked))
        elif path is not None:
            self.app.push_screen(OverlayScreen(path))

    def action_charts(self) -> None:
        """Change between text and charts where there is no room for both."""
        self.toggle_class("charts-first")

    def action_end(self) -> None:
        """End the chosen job with its best result so far."""
        job = self._job(self._chosen_key())
        if job is not None:
            self._jobs.finish_early(job)
            self.refresh_view()

    def action_cancel(self) -> None:
        """Cancel the chosen job."""
        job = self._job(self._chosen_key())
        if job is not None:
            self._jobs.cancel(job)
            self.refresh_view()
            self.refresh_bindings()
