"""A fit and a diagnosis as they are asked for on the screen, and their early end."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.widgets import DataTable, SelectionList, Static

from labhil.campaign.studies.process import Helper
from labhil.campaign.studies.study import Task
from labhil.tui.analysis import AnalysisDialog
from labhil.tui.app import LabApp
from labhil.tui.session import Session

PATIENCE = 100.0
pytestmark = pytest.mark.timeout(300)


async def until(pilot: Pilot[None], condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not come to that"
        await pilot.pause(0.05)


async def open_dialog(pilot: Pilot[None], app: LabApp) -> AnalysisDialog:
    await pilot.press("4")
    table = app.query_one("#recordings-table", DataTable)
    await until(pilot, lambda: table.row_count == 2 and "…" not in str(table.get_row_at(0)[2]))
    await until(pilot, lambda: "…" not in str(table.get_row_at(1)[2]))
    await pilot.press("h")
    await until(pilot, lambda: isinstance(app.screen, AnalysisDialog) and app.screen.catalogue)
    assert isinstance(app.screen, AnalysisDialog)
    return app.screen


def shown(dialog: AnalysisDialog, name: str) -> str:
    return str(dialog.query_one(name, Static).render())


@pytest.mark.extended
@pytest.mark.parametrize("size", [(80, 24), (160, 50)])
def test_the_terms_stand_there_in_the_words_of_the_catalogue(folder: Path, size: tuple[int, int]) -> None:
    async def drive(pilot: Pilot[None], app: LabApp) -> None:
        dialog = await open_dialog(pilot, app)
        assert dialog.catalogue is not None
        assert set(dialog.selected_task.terms or ()) == set(dialog.catalogue.general)
        for number, effect in enumerate(dialog.catalogue.effects):
            dialog.query_one(SelectionList).highlighted = number
            await pilot.pause()
            about = dialog.query_one("#analysis-about", Static)
            assert effect.statement in shown(dialog, "#analysis-about")
            assert about.get_content_height(about.size, about.size, about.size.width) <= about.size.height, (
                f"{effect.name} is cut"
            )
        await pilot.press("w")
        assert (dialog.selected_task.kind, dialog.selected_task.terms) == (
            "diagnose",
            dialog.catalogue.baseline,
        )
        await pilot.press("s", "t", "w", "e")
        wanted = dialog.selected_task
        assert (wanted.seconds, wanted.estimator) == (10.0, dialog.catalogue.estimators[1])
        assert [path.name for path in wanted.tests] != [wanted.recordings[0].name]
        assert len(wanted.tests) == 1
        await pilot.press("escape")
        assert not app.studies.jobs.all

    on_screen(folder, drive, size)


@pytest.mark.extended
def test_a_fit_takes_what_was_chosen(folder: Path) -> None:
    async def drive(pilot: Pilot[None], app: LabApp) -> None:
        dialog = await open_dialog(pilot, app)
        listed = dialog.query_one(SelectionList)
        listed.deselect_all()
        await pilot.press("home", "space", "down", "space", "e", "t", "g")
        await until(pilot, lambda: app.studies.jobs.all and app.studies.jobs.all[0].state != "at work")
        assert app.studies.jobs.all[0].state == "done", app.studies.jobs.all[0].message
        found = json.loads(Path(app.studies.jobs.all[0].done).read_text(encoding="utf-8"))
        assert found["terms"] == ["viscous_friction", "coulomb_friction"]
        assert found["estimator"] == "nlse"
        assert [one["role"] for one in found["recordings"]] == ["train", "test"]

    on_screen(folder, drive, (80, 24))


@pytest.mark.extended
def test_a_diagnosis_that_is_ended_leaves_the_best_so_far(folder: Path) -> None:
    said: list[dict[str, Any]] = []
    task = Task("diagnose", (folder / "ball_beam_identify.mcap",))
    helper = Helper("a study", "labhil.campaign.studies.study", task.to_json(), said.append)
    deadline = time.monotonic() + PATIENCE
    while sum("progress" in line for line in said) < 6 and time.monotonic() < deadline:
        time.sleep(0.02)
    helper.send({"end": True})
    while helper.running and time.monotonic() < deadline:
        time.sleep(0.02)
    helper.close(5.0)
    done = next(line["done"] for line in said if "done" in line)
    assert json.loads(Path(done).read_text(encoding="utf-8"))["complete"] is False


@pytest.mark.extended
def test_the_end_of_its_time_leaves_the_best_so_far(folder: Path) -> None:
    said: list[dict[str, Any]] = []
    task = Task("diagnose", (folder / "ball_beam_identify.mcap",), seconds=0.5)
    helper = Helper("a study", "labhil.campaign.studies.study", task.to_json(), said.append)
    deadline = time.monotonic() + PATIENCE
    while helper.running and time.monotonic() < deadline:
        time.sleep(0.02)
    helper.close(5.0)
    done = next(line["done"] for line in said if "done" in line)
    assert json.loads(Path(done).read_text(encoding="utf-8"))["complete"] is False


def on_screen(folder: Path, drive: Callable[[Pilot[None], LabApp], Any], size: tuple[int, int]) -> None:
    async def go() -> None:
        with Session() as lab:
            app = LabApp(folder, lab)
            async with app.run_test(size=size) as pilot:
                await drive(pilot, app)

    asyncio.run(go())
