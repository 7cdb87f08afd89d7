"""The list of experiments: what cannot be started is listed too, and says why before a key is pressed."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from experiment_text import held_voltage
from textual.pilot import Pilot
from textual.widgets import Button, OptionList, Static

from labhil.tui.app import LabApp

sys.path.insert(0, str(Path(__file__).parent))

from still import StillLab

SETTLED = 0.15
SINGLE = held_voltage("levels")
SWEEP = '\n[sweep.over]\n"steps.0.level" = [2.0, 4.0, 5.0]\n'
LEVELS = SINGLE.replace("[devices", "repeat = 2\n[devices") + SWEEP


def shown(folder: Path, *keys: str) -> tuple[list[str], str, bool, LabApp]:
    """The names in the list, the text beside it, whether a start is offered, and the app."""

    async def go() -> tuple[list[str], str, bool, LabApp]:
        app = LabApp(folder, StillLab(), tab="experiment")  # type: ignore[arg-type]
        async with app.run_test(size=(120, 40)) as pilot:
            await press(pilot, *keys)
            names = [str(option.prompt) for option in app.query_one("#experiment-list", OptionList).options]
            plan = str(app.query_one("#plan", Static).content)
            return names, plan, not app.query_one("#run-start", Button).disabled, app

    return asyncio.run(go())


async def press(pilot: Pilot[None], *keys: str) -> None:
    await pilot.pause(SETTLED)
    for key in keys:
        await pilot.press(key)
        await pilot.pause(SETTLED)


def test_a_sweep_says_how_many_runs_it_has_and_is_not_started(folder: Path) -> None:
    (folder / "levels.toml").write_text(LEVELS)
    names, plan, is_offered, app = shown(folder, "enter")
    assert names[1] == "  levels"
    assert plan.startswith("◆ 6 runs; not started here\nlabhil run bench/levels.toml\nmakes them all")
    assert "steps.0.level: 2.0, 4.0, 5.0\neach 2 times" in plan
    assert not is_offered
    assert app.runner.state == "idle"
    assert [n.message for n in app._notifications] == [
        "Not started here: `labhil run bench/levels.toml` makes all runs of this file."
    ]


def test_a_single_run_is_offered(folder: Path) -> None:
    (folder / "levels.toml").write_text(SINGLE)
    _, plan, is_offered, _ = shown(folder)
    assert "runs" not in plan.partition("\n")[0]
    assert is_offered


def test_a_file_that_is_no_toml_is_listed_with_its_error(folder: Path) -> None:
    (folder / "levels.toml").write_text("[experiment\nname = 'levels'\n")
    names, plan, is_offered, _ = shown(folder)
    assert names[1] == "✕ levels.toml"
    assert plan.startswith("✕ cannot be run\n")
    assert "TOML" in plan
    assert "line 1" in plan
    assert not is_offered
