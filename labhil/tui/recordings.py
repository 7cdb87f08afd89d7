"""The tab of recordings: their outcome and contents, and the studies of them."""

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
from labhil.terminal import printable
from labhil.tui.analysis import AnalysisDialog
from labhil.tui.dialogs import Choose
from labhil.tui.formatting import format_size
from labhil.tui.lists import LabTable
from labhil.tui.messages import StudyRequested
from labhil.tui.panes import Pane
from labhil.tui.recording import RecordingScreen
from labhil.tui.recording_columns import COLUMNS, cells, fit_columns, row_of
from labhil.tui.recording_library import LibraryEntry, list_models
from labhil.tui.recordings_overlay import MOST_OVERLAID, RecordingsOverlay

LONGEST_WORDS = 220
"""Characters of a note that the details show; the screen of the recording shows all of it."""
SIDES = 2
"""Blanks on both sides of the table."""

EMPTY = """[b]No recordings in this folder yet.[/b]

  [$muted]{folder}[/]

  [b $accent]3[/] then [b $accent]Enter[/]   records the example on a simulated bench
  [$muted]labhil import DATA.csv --rig RIG.toml -o REC.mcap  makes one of a table[/]"""


class RecordingsPane(Vertical, Pane):
    """Show a table of recordings, with marks for those that a study uses together."""

    MAIN_WIDGET = "#recordings-table"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "open", "Open", id="rec.open", tooltip="Look at its channels and events"),
        Binding("space", "mark('+')", "Mark", id="rec.mark", tooltip="Use several together"),
        Binding("t", "mark('T')", "Test", id="rec.test", tooltip="Mark as the recording to judge on"),
        Binding("f", "study('fit')", "Fit", id="rec.fit", tooltip="Fit the rig's general model"),
        Binding("d", "study('diagnose')", "Diagnose", id="rec.diagnose", tooltip="What physics is missing?"),
        Binding("h", "analyse", "How", id="rec.analyse", tooltip="Choose terms, estimator, test, time"),
        Binding("v", "verify", "Verify", id="rec.verify", tooltip="Hold it against an accepted model"),
        Binding("o", "overlay", "Overlay", id="rec.overlay", tooltip="The marked recordings over each other"),
        Binding("x", "study('export')", "CSV", id="rec.export", tooltip="Write its samples as CSV"),
    ]

    def __init__(self, folder: Path) -> None:
        super().__init__(id="recordings-pane")
        self._folder = folder
        self._entries: list[LibraryEntry] = []
        self._marks: dict[Path, str] = {}
        self._widths: dict[str, int] = {}
        self._room = 0
        self._detail = Text()

    def compose(self) -> ComposeResult:
        """Lay out the table, and the text for an empty folder."""
        yield Static(
            EMPTY.format(folder=str(self._folder.absolute()).replace("[", r"\[")), id="recordings-empty"
        )
        yield LabTable(id="recordings-table", cursor_type="row", cursor_foreground_priority="renderable")
        yield Static(id="recordings-detail")

    def on_mount(self) -> None:
        """Make the columns."""
        self.show_entries([])

    def on_resize(self, event: Resize) -> None:
        """Show the columns that have room."""
        self._room = event.size.width - SIDES
        self._fit_columns()

    def show_entries(self, entries: list[LibraryEntry]) -> None:
        """Show these recordings."""
        same = [entry.path for entry in entries] == [entry.path for entry in self._entries]
        self._entries = entries
        self._marks = {
            path: mark for path, mark in self._marks.items() if any(entry.path == path for entry in entries)
        }
        self.query_one("#recordings-empty").display = not entries
        self.query_one(DataTable).display = bool(entries)
        if not self._fit_columns():
            if not same:
                self._fill()
            else:
                for entry in entries:
                    self._update(entry)
        self._show_detail()

    def _fit_columns(self) -> bool:
        """Make the columns anew where others have room than before; return whether that was so."""
        widths = fit_columns([self._row(entry) for entry in self._entries], self._room)
        if widths == self._widths:
            return False
        self._widths = widths
        chosen, table = self._chosen_entry(), self.query_one(DataTable)
        table.clear(columns=True)
        for key, width in widths.items():
            table.add_column(COLUMNS[key][0], key=key, width=width)
        self._fill(chosen)
        return True

    def _fill(self, chosen: LibraryEntry | None = None) -> None:
        """Fill the table; the cursor stays on the chosen recording."""
        table, chosen = self.query_one(DataTable), chosen or self._chosen_entry()
        table.clear()
        for entry in self._entries:
            table.add_row(*cells(self._row(entry), self._widths), key=str(entry.path))
        if chosen is not None and any(entry.path == chosen.path for entry in self._entries):
            table.move_cursor(row=table.get_row_index(str(chosen.path)))

    def _update(self, entry: LibraryEntry) -> None:
        table = self.query_one(DataTable)
        for key, cell in zip(self._widths, cells(self._row(entry), self._widths), strict=True):
            if table.get_cell(str(entry.path), key) != cell:
                table.update_cell(str(entry.path), key, cell)

    def _row(self, entry: LibraryEntry) -> dict[str, Text]:
        return row_of(entry, self._marks.get(entry.path, ""), self.app.theme_variables)

    def on_data_table_row_highlighted(self, _event: DataTable.RowHighlighted) -> None:
        """Show details of the chosen recording."""
        self._show_detail()

    def on_data_table_row_selected(self, event: DataTable.RowSelected) -> None:
        """Open the chosen recording."""
        event.stop()
        self.action_open()

    def _show_detail(self) -> None:
        """Show what a narrow table has no room for, and the input of a study."""
        entry, colours = self._chosen_entry(), self.app.theme_variables
        line = Text()
        if entry is not None:
            line.append(entry.path.name, style="bold")
            line.append(f"  {format_size(entry.size)}, {entry.when}  ", style=colours["muted"])
            line.append(f"{entry.fault or entry.reason or entry.status}\n", style=colours["muted"])
            recordings, tests = self._study_inputs()
            what = ", ".join(path.name.removesuffix(".mcap") for path in recordings)
            line.append("f d x: ", style=colours["muted"]).append(what)
            if tests:
                line.append(f"; judged on {', '.join(path.name.removesuffix('.mcap') for path in tests)}")
            for key, text in entry.words:
                line.append(f"\n{key}: ", style=colours["muted"]).append(in_a_paragraph(text))
        if line != self._detail:
            self._detail = line
            self.query_one("#recordings-detail", Static).update(line)

    def _chosen_entry(self) -> LibraryEntry | None:
        table = self.query_one(DataTable)
        try:
            key = table.coordinate_to_cell_key(table.cursor_coordinate).row_key.value
        except CellDoesNotExist:
            return None
        return next((entry for entry in self._entries if str(entry.path) == key), None)

    def _study_inputs(self) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
        """The recordings of a study (the marked ones, else the chosen one), and its test recordings."""
        tests = tuple(path for path, mark in self._marks.items() if mark == "T")
        recordings = tuple(entry.path for entry in self._entries if self._marks.get(entry.path) == "+")
        chosen = self._chosen_entry()
        if not recordings and chosen is not None and chosen.path not in tests:
            recordings = (chosen.path,)
        return recordings, tests

    def action_mark(self, mark: str) -> None:
        """Mark the chosen recording, or remove the mark."""
        entry = self._chosen_entry()
        if entry is None:
            return
        if self._marks.pop(entry.path, "") != mark:
            self._marks[entry.path] = mark
        self.refresh_bindings()
        self._update(entry)
        self._show_detail()

    def action_open(self) -> None:
        """Open the chosen recording."""
        entry = self._chosen_entry()
        if entry is not None:
            self.app.push_screen(RecordingScreen(entry.path))

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Enable the overlay only for several marked recordings."""
        return len(self._marks) > 1 if action == "overlay" else True

    def action_overlay(self) -> None:
        """Draw the marked recordings over each other."""
        entries = [entry for entry in self._entries if entry.path in self._marks]
        if len({entry.rig for entry in entries}) > 1:
            self.app.notify("Only recordings of one rig are drawn over each other.", severity="warning")
        elif len(entries) > MOST_OVERLAID:
            self.app.notify(
                f"At most {MOST_OVERLAID} recordings are drawn over each other.", severity="warning"
            )
        else:
            self.app.push_screen(RecordingsOverlay([entry.path for entry in entries]))

    def action_study(self, kind: str) -> None:
        """Fit, diagnose or export the marked recordings, or the chosen one."""
        recordings, tests = self._study_inputs()
        if recordings:
            self.post_message(StudyRequested(Task(kind, recordings, () if kind == "export" else tests)))

    def action_analyse(self) -> None:
        """Choose terms, test recording, estimator and time, then fit or diagnose."""
        recordings, tests = self._study_inputs()
        first = next((entry for entry in self._entries if entry.path in recordings), None)
        if first is None:
            return

        def on_answer(task: Task | None) -> None:
            if task is not None:
                self.post_message(StudyRequested(task))

        others = [
            entry.path for entry in self._entries if entry.path not in recordings and entry.rig == first.rig
        ]
        self.app.push_screen(AnalysisDialog(Task("fit", recordings, tests), first.rig, others), on_answer)

    def action_verify(self) -> None:
        """Verify a model on the chosen recording."""
        entry = self._chosen_entry()
        choices = list_models(self._folder)
        if entry is None:
            return
        if not choices:
            self.notify("There is no fit or diagnosis in this folder yet: f makes one.", severity="warning")
            return

        def on_answer(choice: str | None) -> None:
            if choice is not None:
                self.post_message(StudyRequested(Task("verify", (entry.path,), (), Path(choice))))

        names = [(str(result.path), result.path.name) for result in choices]
        self.app.push_screen(Choose(f"Verify {entry.path.name} against", names), on_answer)


def in_a_paragraph(text: str) -> str:
    """Return a text in one paragraph of printable characters, its end left out where it is long."""
    paragraph = printable(" ".join(text.split()))
    return paragraph if len(paragraph) <= LONGEST_WORDS else f"{paragraph[:LONGEST_WORDS]}…"
