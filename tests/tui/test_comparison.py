"""Comparisons and verifications in the list of results, and a comparison that the screen makes."""

from __future__ import annotations

import asyncio
import json
import shutil
import sys
from pathlib import Path

import pytest
from textual.widgets import DataTable, Static

from labhil.tui.app import LabApp
from labhil.tui.result_files import in_a_line, in_full, read_part

sys.path.insert(0, str(Path(__file__).parent))

from still import StillLab

HERE = Path(__file__).parent
COMPARED = HERE / "compared" / "ball_beam_identify.comparison.json"
PATIENCE = 200.0


def text_of(path: Path) -> str:
    from labhil.terminal import terminal

    part = read_part(path)
    assert not isinstance(part, str), part
    console = terminal(width=160)
    names = ("accent", "error", "foreground", "muted", "primary", "success", "warning")
    with console.capture() as captured:
        console.print(in_full(part, dict.fromkeys(names, "default")))
    return in_a_line(part) + "\n" + captured.get()


def test_a_comparison_says_which_model_is_best_and_what_to_do() -> None:
    text = text_of(COMPARED)
    assert text.startswith("ball_beam_identify.fit.json, ball_beam_identify.diagnosis.json alike")
    for part in ("Models", "stribeck_friction.velocity m/s", "agree", "What to do next"):
        assert part in text


@pytest.mark.extended
def test_names_in_a_comparison_are_no_markup(folder: Path) -> None:
    told = json.loads(COMPARED.read_text(encoding="utf-8"))
    name = "[red]a[/blink].json"
    shown = json.dumps(told).replace("ball_beam_identify.fit.json", name)
    (folder / "b.comparison.json").write_text(shown, encoding="utf-8")

    async def look() -> str:
        app = LabApp(folder, StillLab())  # type: ignore[arg-type]
        async with app.run_test(size=(160, 50)) as pilot:
            await pilot.press("5", "home")
            await pilot.pause(0.3)
            return app.export_screenshot().replace("&#160;", " ")

    assert "[red]a[/blink].json" in asyncio.run(look())


def test_a_verification_is_listed(tmp_path: Path) -> None:
    part = {
        "schema": "labhil.verification/1",
        "recordings": [],
        "model": "fit.json",
        "rig": "ball_beam",
        "terms": ["viscous_friction"],
        "verdict": "contradicted",
        "alpha": 0.0005,
        "p_value": 1e-7,
        "reasons": ["ball_position: × 9.1 of the noise floor"],
        "score": {"mse": 1.0, "rmse": 1.0, "noise_floor": 1.0, "max_abs_error": 1.0, "r2": 0.5, "unit": "m",
                  "horizon": 4.0, "per_channel": []},
        "channels": [],
        "values_p": 0.1,
    }  # fmt: skip
    path = tmp_path / "a.verification.json"
    path.write_text(json.dumps(part), encoding="utf-8")
    text = text_of(path)
    assert "contradicted by the recording" in text
    assert "What to do next" in text
    assert "labhil diagnose REC.mcap --model fit.json" in text


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_two_marks_and_a_key_compare_two_models(folder: Path) -> None:
    async def drive() -> str:
        app = LabApp(folder, StillLab())  # type: ignore[arg-type]
        async with app.run_test(size=(160, 50)) as pilot:
            await pilot.press("5", "space", "down", "space", "k")
            async with asyncio.timeout(PATIENCE):
                while not app.studies.jobs.all or app.studies.jobs.all[0].state == "at work":
                    await pilot.pause(0.1)
            assert app.studies.jobs.all[0].state == "done", app.studies.jobs.all[0].message
            await pilot.pause(0.5)
            table = app.query_one("#results-table", DataTable)
            assert table.row_count == 3
            text = app.query_one("#result-text", Static)
            assert text.display
            return app.export_screenshot()

    for path in (HERE.parents[1] / "recordings").glob("ball_beam_*.mcap"):
        shutil.copy(path, folder / path.name)
    shown = asyncio.run(drive())
    assert "compared" in shown
    assert list(folder.glob("*.comparison.json"))
