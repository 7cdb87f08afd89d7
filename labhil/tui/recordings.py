"""The recordings of the folder: how each ended, what is in it, and what can be made of it."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.events import Resize
from textual.widgets import DataTable, Static
from textual.widgets.data_table import CellDoesNotExist

from labhil.campaign.studies.study import Task
from labhil.tui.analysis import AnalysisDialog
from labhil.tui.dialogs import Choose
from labhil.tui.messages import StudyWanted
from labhil.tui.recording import RecordingScreen
from labhil.tui.recording_library import LibraryEntry, results
from labhil.tui.words import count, duration, ended_look, size

COLUMNS = (
    ("mark", "", 1),
    ("name", "recording", 24),
    ("status", "ended", 11),
    ("rig", "rig", 9),
    ("duration", "duration", 8),
    ("samples", "samples", 7),
    ("gaps", "gaps", 4),
    ("size", "size", 7),
    ("when", "written", 12),
    ("reason", "reason", None),
)
NARROW, WIDE = 24, 40
"""Columns for a recording's name."""

EMPTY = """[b]No recordings in this folder yet.[/b]

  [$muted]{folder}[/]

  [b $accent]3[/] then [b $accent]Enter[/]   records the example on a simulated bench
  [$muted]labhil import DATA.csv --rig RIG.toml -o REC.mcap  makes one of a table[/]"""


class RecordingsPane(Vertical):
    """The table of recordings, with marks for those that belong together."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "open", "Open", id="rec.open", tooltip="Look at its channels and events"),
        Binding("space", "mark('+')", "Mark", id="rec.mark", tooltip="Use several together"),
        Binding("t", "mark('T')", "Test", id="rec.test", tooltip="Mark as the recording to judge on"),
        Binding("f", "study('fit')", "Fit", id="rec.fit", tooltip="Fit the rig's general model"),
        Binding("d", "study('diagnose')", "Diagnose", id="rec.diagnose", tooltip="What physics is missing?"),
        Binding("a", "analyse", "Terms", id="rec.analyse", tooltip="Choose terms, estimator, test, time"),
        Binding("v", "verify", "Verify", id="rec.verify", tooltip="Hold it against an accepted model"),
        Binding("x", "study('export')", "CSV", id="rec.export", tooltip="Write its samples as CSV"),
    ]

    def __init__(self, folder: Path) -> None:
        super().__init__(id="recordings-pane")
        self._folder = folder
        self._shelved: list[LibraryEntry] = []
        self._marks: dict[Path, str] = {}
        self._name_width = NARROW

    def compose(self) -> ComposeResult:
        """The table, and what is said when there is nothing."""
        yield Static(
            EMPTY.format(folder=str(self._folder.absolute()).replace("[", r"\[")), id="recordings-empty"
        )
        yield DataTable(id="recordings-table", cursor_type="row", cursor_foreground_priority="renderable")
        yield Static(id="recordings-detail")

    def on_mount(self) -> None:
        """Make the columns."""
        table = self.query_one(DataTable)
        for key, label, width in COLUMNS:
            table.add_column(label, key=key, width=width)
        self.take([])

    def on_resize(self, event: Resize) -> None:
        """Names get the room that there is."""
        width = WIDE if event.size.width >= 110 else NARROW
        if width != self._name_width:
            self._name_width = width
            table = self.query_one(DataTable)
            next(column for key, column in table.columns.items() if key == "name").width = width
            shelved, self._shelved = self._shelved, []
            self.take(shelved)

    def take(self, shelved: list[LibraryEntry]) -> None:
        """Show these."""
        same = [one.path for one in shelved] == [one.path for one in self._shelved]
        self._shelved = shelved
        self._marks = {
            path: mark for path, mark in self._marks.items() if any(s.path == path for s in shelved)
        }
        self.query_one("#recordings-empty").display = not shelved
        table = self.query_one(DataTable)
        table.display = bool(shelved)
        if not same:
            at = self._chosen()
            table.clear()
            for one in shelved:
                table.add_row(*self._row(one), key=str(one.path))
            if at is not None and any(one.path == at.path for one in shelved):
                table.move_cursor(row=table.get_row_index(str(at.path)))
        else:
            for one in shelved:
                self._update(one)
        self._tell()

    def _update(self, one: LibraryEntry) -> None:
        table = self.query_one(DataTable)
        for (key, _, _), cell in zip(COLUMNS, self._row(one), strict=True):
            if table.get_cell(str(one.path), key) != cell:
                table.update_cell(str(one.path), key, cell, update_width=key == "reason")

    def _row(self, one: LibraryEntry) -> list[Text]:
        colours = self.app.theme_variables
        mark = self._marks.get(one.path, "")
        name = one.path.name.removesuffix(".mcap")
        width = self._name_width
        if len(name) > width:
            name = f"{name[: width - 16]}…{name[-15:]}"
        gaps = Text(count(one.gaps), justify="right")
        if one.gaps:
            gaps.stylize(f"bold {colours['warning']}")
        status = ended_look(one.status).text(colours) if one.status else Text("…", style=colours["muted"])
        return [
            Text(mark, style=f"bold {colours['accent']}"),
            Text(name),
            status,
            Text(one.rig or "–"),
            Text(duration(one.duration), justify="right"),
            Text(count(one.samples), justify="right"),
            gaps,
            Text(size(one.size), justify="right"),
            Text(one.when, style=colours["muted"]),
            Text(one.fault or one.reason, style=colours["muted"]),
        ]

    def on_data_table_row_highlighted(self, _event: DataTable.RowHighlighted) -> None:
        """Another recording was chosen."""
        self._tell()

    def on_data_table_row_selected(self, event: DataTable.RowSelected) -> None:
        """Enter opens it."""
        event.stop()
        self.action_open()

    def _tell(self) -> None:
        """What the narrow table has no room for, and what the keys would do."""
        one, colours = self._chosen(), self.app.theme_variables
        line = Text()
        if one is not None:
            line.append(one.path.name, style="bold")
            line.append(f"  {size(one.size)}, {one.when}  ", style=colours["muted"])
            line.append(f"{one.fault or one.reason or one.status}\n", style=colours["muted"])
            use, tests = self._use()
            what = ", ".join(path.name.removesuffix(".mcap") for path in use)
            line.append("f d x: ", style=colours["muted"]).append(what)
            if tests:
                line.append(f"; judged on {', '.join(path.name.removesuffix('.mcap') for path in tests)}")
        self.query_one("#recordings-detail", Static).update(line)

    def _chosen(self) -> LibraryEntry | None:
        table = self.query_one(DataTable)
        try:
            key = table.coordinate_to_cell_key(table.cursor_coordinate).row_key.value
        except CellDoesNotExist:
            return None
        return next((one for one in self._shelved if str(one.path) == key), None)

    def _use(self) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
        """What a study would take: the marked ones, or the chosen one; and what it is judged on."""
        tests = tuple(path for path, mark in self._marks.items() if mark == "T")
        use = tuple(one.path for one in self._shelved if self._marks.get(one.path) == "+")
        chosen = self._chosen()
        if not use and chosen is not None and chosen.path not in tests:
            use = (chosen.path,)
        return use, tests

    def action_mark(self, mark: str) -> None:
        """Mark the chosen recording, or take the mark away."""
        one = self._chosen()
        if one is None:
            return
        if self._marks.pop(one.path, "") != mark:
            self._marks[one.path] = mark
        self._update(one)
        self._tell()

    def action_open(self) -> None:
        """Look into the chosen recording."""
        one = self._chosen()
        if one is not None:
            self.app.push_screen(RecordingScreen(one.path))

    def action_study(self, kind: str) -> None:
        """Fit, diagnose or export what is marked, or the chosen one."""
        use, tests = self._use()
        if use:
            self.post_message(StudyWanted(Task(kind, use, () if kind == "export" else tests)))

    def action_analyse(self) -> None:
        """Choose terms, test recording, estimator and time, then fit or diagnose."""
        use, tests = self._use()
        first = next((one for one in self._shelved if one.path in use), None)
        if first is None:
            return

        def go(task: Task | None) -> None:
            if task is not None:
                self.post_message(StudyWanted(task))

        others = [one.path for one in self._shelved if one.path not in use and one.rig == first.rig]
        self.app.push_screen(AnalysisDialog(Task("fit", use, tests), first.rig, others), go)

    def action_verify(self) -> None:
        """Hold the chosen recording against a model that is chosen now."""
        one = self._chosen()
        found = results(self._folder)
        if one is None:
            return
        if not found:
            self.notify("There is no fit or diagnosis in this folder yet: f makes one.", severity="warning")
            return

        def go(choice: str | None) -> None:
            if choice is not None:
                self.post_message(StudyWanted(Task("verify", (one.path,), (), Path(choice))))

        names = [(str(result.path), result.path.name) for result in found]
        self.app.push_screen(Choose(f"Verify {one.path.name} against", names), go)
