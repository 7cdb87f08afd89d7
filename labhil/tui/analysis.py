"""The dialog before a fit or a diagnosis: terms, test recording, estimator, time limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content
from textual.message import Message
from textual.screen import ModalScreen
from textual.widgets import SelectionList, Static
from textual.widgets.selection_list import Selection

from labhil.campaign.studies.catalogue import MODULE, Catalogue
from labhil.campaign.studies.process import Helper
from labhil.campaign.studies.study import Task
from labhil.tui.formatting import format_duration
from labhil.tui.lists import LabSelection
from labhil.tui.top_bar import WithBar

LIMITS = (None, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0)
"""Time limits to choose from, s; None for none."""
KINDS = {"fit": "Fit", "diagnose": "Diagnose"}


@dataclass
class CatalogueLine(Message):
    """Carry a line of the process that reads the catalogue of terms."""

    line: dict[str, Any]


class AnalysisDialog(ModalScreen[Task | None], WithBar):
    """Choose terms or baseline, test recording, estimator and time before a fit or a diagnosis.

    Args:
        task: Recordings and test recordings, and what the dialog does not choose.
        rig: Rig kind of the recording; None where it has none.
        others: Recordings that the result could be tested on.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("g", "start", "Start", id="analysis.start"),
        Binding("w", "what", "Fit or diagnose", id="analysis.what"),
        Binding("e", "estimator", "Estimator", id="analysis.estimator"),
        Binding("t", "test", "Judged on", id="analysis.test"),
        Binding("s", "limit", "Time", id="analysis.limit"),
        Binding("d", "defaults", "Default terms", id="analysis.defaults"),
        Binding("escape", "leave", "Leave", id="analysis.leave"),
    ]

    def __init__(self, task: Task, rig: str | None, others: Sequence[Path]) -> None:
        super().__init__(id="analysis")
        self._template, self._rig = task, rig
        self._kind = "fit"
        self._tests: list[tuple[Path, ...]] = [(), *((path,) for path in others if (path,) != task.tests)]
        if task.tests:
            self._tests.insert(0, task.tests)
        self._test = self._limit = self._estimator = 0
        self._problem = "" if rig else "the recording has no rig file: its default terms are taken"
        self.catalogue: Catalogue | None = None
        self._helper: Helper | None = None

    def compose(self) -> ComposeResult:
        """Lay out the choices, the terms, and the description of the highlighted term."""
        with Vertical(classes="dialog dialog-wide", id="analysis-box"):
            yield Static(id="analysis-how")
            yield LabSelection(id="analysis-terms")
            yield Static(id="analysis-about")
            yield Static("g starts   Space takes a term or leaves it   Escape leaves", classes="dialog-note")

    def on_mount(self) -> None:
        """Start to read the catalogue."""
        if self._rig:
            request = {"rig": self._rig}
            self._helper = Helper("the catalogue", MODULE, request, self._forward_line)
        self._show_choices()

    def _forward_line(self, line: dict[str, Any]) -> None:
        self.post_message(CatalogueLine(line))

    def on_unmount(self) -> None:
        """End the process that reads the catalogue."""
        if self._helper is not None:
            self._helper.close(0.2)

    def on_catalogue_line(self, message: CatalogueLine) -> None:
        """Show the terms, or why there are none."""
        message.stop()
        line = message.line
        if "done" in line:
            self.catalogue = Catalogue.from_json(line["done"])
            self._fill()
        elif "failed" in line or ("ended" in line and self.catalogue is None and not self._problem):
            self._problem = str(line.get("failed") or line.get("complaint") or "the catalogue cannot be read")
        self._show_choices()

    def _fill(self) -> None:
        """List the terms, with the default ones selected."""
        if self.catalogue is None:
            return
        defaults = self.catalogue.general if self._kind == "fit" else self.catalogue.baseline
        selection_list = self.query_one(SelectionList)
        selection_list.clear_options()
        for effect in self.catalogue.effects:
            selection_list.add_option(Selection(Content(effect.name), effect.name, effect.name in defaults))
        selection_list.highlighted = 0
        selection_list.focus()

    def on_selection_list_selection_highlighted(self, _event: Any) -> None:
        """Describe the highlighted term."""
        self._show_term()

    def on_selection_list_selected_changed(self, _event: Any) -> None:
        """Show the number of selected terms."""
        self._show_choices()

    @property
    def selected_terms(self) -> tuple[str, ...]:
        """The selected terms, in the catalogue's order."""
        selected = set(self.query_one(SelectionList).selected)
        if not self.catalogue:
            return ()
        return tuple(effect.name for effect in self.catalogue.effects if effect.name in selected)

    @property
    def selected_task(self) -> Task:
        """The task with the present choices."""
        catalogue = self.catalogue
        estimator = catalogue.estimators[self._estimator] if catalogue and self._kind == "fit" else None
        return replace(
            self._template,
            kind=self._kind,
            tests=self._tests[self._test],
            terms=self.selected_terms if catalogue else None,
            estimator=estimator,
            seconds=LIMITS[self._limit],
        )

    def _show_choices(self) -> None:
        colours, task = self.app.theme_variables, self.selected_task
        text = Text()
        names = ", ".join(path.name.removesuffix(".mcap") for path in task.recordings)
        text.append(f"{KINDS[self._kind]} {names}\n", style="bold")
        tests = ", ".join(path.name.removesuffix(".mcap") for path in task.tests)
        rows = [("w", "what", f"{self._kind} (or {'diagnose' if self._kind == 'fit' else 'fit'})")]
        if self._kind == "fit":
            rows.append(("e", "estimator", task.estimator or "hybrid"))
        rows.append(("t", "judged on", tests or "the last 30 % of each recording"))
        limit = "as long as it takes"
        if task.seconds is not None:
            limit = f"at most {format_duration(task.seconds)}, then the best so far"
        rows.append(("s", "time", limit))
        for key, name, value in rows:
            text.append(f"{key} ", style=f"bold {colours['accent']}")
            text.append(f"{name:<11}", style=colours["muted"])
            text.append(f"{value}\n")
        what = "terms of the model" if self._kind == "fit" else "terms that your simulation has (baseline)"
        if self.catalogue is not None:
            text.append(f"{what}: {len(self.selected_terms)} of {len(self.catalogue.effects)}", style="bold")
            text.append("   d takes the default", style=colours["muted"])
        else:
            text.append(self._problem or "reading the catalogue …", style=colours["muted"])
        self.query_one("#analysis-how", Static).update(text)
        self._show_term()

    def _show_term(self) -> None:
        """Show statement and equation of the highlighted term."""
        colours, selection_list = self.app.theme_variables, self.query_one(SelectionList)
        text = Text()
        if self.catalogue is not None and selection_list.highlighted is not None:
            effect = self.catalogue.effects[selection_list.highlighted]
            text.append(f"{effect.statement}\n")
            text.append(f"{effect.equation}\n", style="italic")
            text.append(f"shown by {effect.revealed_by}", style=colours["muted"])
            if effect.needs:
                text.append(f"; needs {', '.join(effect.needs)}", style=colours["muted"])
        self.query_one("#analysis-about", Static).update(text)

    def action_what(self) -> None:
        """Change between fit and diagnosis."""
        self._kind = "diagnose" if self._kind == "fit" else "fit"
        self._fill()
        self._show_choices()

    def action_defaults(self) -> None:
        """Select the default terms."""
        self._fill()
        self._show_choices()

    def action_estimator(self) -> None:
        """Take the next estimator."""
        if self.catalogue is not None and self._kind == "fit":
            self._estimator = (self._estimator + 1) % len(self.catalogue.estimators)
            self._show_choices()

    def action_test(self) -> None:
        """Take the next test recording."""
        self._test = (self._test + 1) % len(self._tests)
        self._show_choices()

    def action_limit(self) -> None:
        """Take the next time limit."""
        self._limit = (self._limit + 1) % len(LIMITS)
        self._show_choices()

    def action_start(self) -> None:
        """Start, unless a fit has no terms."""
        if self.catalogue is not None and self._kind == "fit" and not self.selected_terms:
            self.app.notify("Take at least one term: Space.", severity="warning")
            return
        self.dismiss(self.selected_task)

    def action_leave(self) -> None:
        """Close without a task."""
        self.dismiss(None)
