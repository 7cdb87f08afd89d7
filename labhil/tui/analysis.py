"""What a fit or a diagnosis is asked for: terms in the catalogue's words, test recording, estimator, time."""

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
from labhil.tui.words import duration

LIMITS = (None, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0)
"""How long the work may take, s."""
KINDS = {"fit": "Fit", "diagnose": "Diagnose"}


@dataclass
class CatalogueRead(Message):
    """A line of the process that reads the catalogue."""

    line: dict[str, Any]


class AnalysisDialog(ModalScreen[Task | None]):
    """Terms or baseline, test recording, estimator and time, before a fit or a diagnosis begins.

    Args:
        task: What is asked for otherwise; its recordings and tests.
        rig: The rig kind of the recording, None where it says none.
        others: Recordings that could judge the result.
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
        self._given, self._rig = task, rig
        self._kind = "fit"
        self._tests: list[tuple[Path, ...]] = [(), *((path,) for path in others if (path,) != task.tests)]
        if task.tests:
            self._tests.insert(0, task.tests)
        self._test = self._limit = self._estimator = 0
        self._trouble = "" if rig else "the recording has no rig file: its default terms are taken"
        self.catalogue: Catalogue | None = None
        self._helper: Helper | None = None

    def compose(self) -> ComposeResult:
        """What is chosen, the terms, and what the chosen one is."""
        with Vertical(classes="dialog dialog-wide", id="analysis-box"):
            yield Static(id="analysis-how")
            yield SelectionList[str](id="analysis-terms")
            yield Static(id="analysis-about")
            yield Static("g starts   Space takes a term or leaves it   Escape leaves", classes="dialog-note")

    def on_mount(self) -> None:
        """Have the catalogue read."""
        if self._rig:
            told = {"rig": self._rig}
            self._helper = Helper("the catalogue", MODULE, told, self._hear)
        self._tell()

    def _hear(self, line: dict[str, Any]) -> None:
        self.post_message(CatalogueRead(line))

    def on_unmount(self) -> None:
        """Nobody needs it any more."""
        if self._helper is not None:
            self._helper.close(0.2)

    def on_catalogue_read(self, message: CatalogueRead) -> None:
        """The terms, or why there are none."""
        message.stop()
        line = message.line
        if "done" in line:
            self.catalogue = Catalogue.from_json(line["done"])
            self._fill()
        elif "failed" in line or ("ended" in line and self.catalogue is None and not self._trouble):
            self._trouble = str(line.get("failed") or line.get("complaint") or "the catalogue cannot be read")
        self._tell()

    def _fill(self) -> None:
        """List the terms, those chosen that are taken where nobody says otherwise."""
        if self.catalogue is None:
            return
        chosen = self.catalogue.general if self._kind == "fit" else self.catalogue.baseline
        listed = self.query_one(SelectionList)
        listed.clear_options()
        for effect in self.catalogue.effects:
            listed.add_option(Selection(Content(effect.name), effect.name, effect.name in chosen))
        listed.highlighted = 0
        listed.focus()

    def on_selection_list_selection_highlighted(self, _event: Any) -> None:
        """Say what this term is."""
        self._about()

    def on_selection_list_selected_changed(self, _event: Any) -> None:
        """Say how many are taken."""
        self._tell()

    @property
    def chosen(self) -> tuple[str, ...]:
        """The terms that are taken, in the catalogue's order."""
        selected = set(self.query_one(SelectionList).selected)
        return (
            tuple(effect.name for effect in self.catalogue.effects if effect.name in selected)
            if (self.catalogue)
            else ()
        )

    @property
    def wanted(self) -> Task:
        """What would be started now."""
        known = self.catalogue
        estimator = known.estimators[self._estimator] if known and self._kind == "fit" else None
        return replace(
            self._given,
            kind=self._kind,
            tests=self._tests[self._test],
            terms=self.chosen if known else None,
            estimator=estimator,
            seconds=LIMITS[self._limit],
        )

    def _tell(self) -> None:
        colours, task = self.app.theme_variables, self.wanted
        text = Text()
        names = ", ".join(path.name.removesuffix(".mcap") for path in task.recordings)
        text.append(f"{KINDS[self._kind]} {names}\n", style="bold")
        judged = ", ".join(path.name.removesuffix(".mcap") for path in task.tests)
        rows = [("w", "what", f"{self._kind} (or {'diagnose' if self._kind == 'fit' else 'fit'})")]
        if self._kind == "fit":
            rows.append(("e", "estimator", task.estimator or "hybrid"))
        rows.append(("t", "judged on", judged or "the last 30 % of each recording"))
        limit = "as long as it takes"
        if task.seconds is not None:
            limit = f"at most {duration(task.seconds)}, then the best so far"
        rows.append(("s", "time", limit))
        for key, name, value in rows:
            text.append(f"{key} ", style=f"bold {colours['accent']}")
            text.append(f"{name:<11}", style=colours["muted"])
            text.append(f"{value}\n")
        what = "terms of the model" if self._kind == "fit" else "terms that your simulation has (baseline)"
        if self.catalogue is not None:
            text.append(f"{what}: {len(self.chosen)} of {len(self.catalogue.effects)}", style="bold")
            text.append("   d takes the default", style=colours["muted"])
        else:
            text.append(self._trouble or "reading the catalogue …", style=colours["muted"])
        self.query_one("#analysis-how", Static).update(text)
        self._about()

    def _about(self) -> None:
        """The highlighted term in the catalogue's words."""
        colours, listed = self.app.theme_variables, self.query_one(SelectionList)
        text = Text()
        if self.catalogue is not None and listed.highlighted is not None:
            effect = self.catalogue.effects[listed.highlighted]
            text.append(f"{effect.statement}\n")
            text.append(f"{effect.equation}\n", style="italic")
            text.append(f"shown by {effect.revealed_by}", style=colours["muted"])
            if effect.needs:
                text.append(f"; needs {', '.join(effect.needs)}", style=colours["muted"])
        self.query_one("#analysis-about", Static).update(text)

    def action_what(self) -> None:
        """A fit, or a diagnosis."""
        self._kind = "diagnose" if self._kind == "fit" else "fit"
        self._fill()
        self._tell()

    def action_defaults(self) -> None:
        """Take the terms that are taken where nobody says otherwise."""
        self._fill()
        self._tell()

    def action_estimator(self) -> None:
        """The next estimator."""
        if self.catalogue is not None and self._kind == "fit":
            self._estimator = (self._estimator + 1) % len(self.catalogue.estimators)
            self._tell()

    def action_test(self) -> None:
        """The next recording to judge on."""
        self._test = (self._test + 1) % len(self._tests)
        self._tell()

    def action_limit(self) -> None:
        """The next limit of time."""
        self._limit = (self._limit + 1) % len(LIMITS)
        self._tell()

    def action_start(self) -> None:
        """Begin, unless a fit would have no term at all."""
        if self.catalogue is not None and self._kind == "fit" and not self.chosen:
            self.app.notify("Take at least one term: Space.", severity="warning")
            return
        self.dismiss(self.wanted)

    def action_leave(self) -> None:
        """Begin nothing."""
        self.dismiss(None)
