"""The shadow on the screen: what it says, and a real one beside real twins."""

from __future__ import annotations

import asyncio
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import HelpPanel, OptionList

from labhil.tui import shadow
from labhil.tui.app import LabApp
from labhil.tui.dialogs import Choose
from labhil.tui.session import Session
from labhil.tui.shadow import ShadowView
from labhil.tui.shadow_state import ShadowState
from labhil.tui.themes import DARK

sys.path.insert(0, str(Path(__file__).parent))

from shadowed import StillHelper, stretch_line
from still import NOW_NS, StillLab

ROOT = Path(__file__).parents[2]
PATIENCE = 100.0
COLOURS = dict.fromkeys(("muted", "error", "success", "warning"), "#ffffff")

EXPERIMENT = """
[experiment]
name = "shadowed"
[devices.bench]
plugin = "ball_beam"
address = "twin"
rig = "{rig}"
[devices.bench.twin]
speed = 1.0
seed = 5
terms = ["viscous_friction", "coulomb_friction", "stribeck_friction", "dead_zone"{more_terms}]
[devices.bench.twin.set]
viscous_friction.coefficient = 0.26
coulomb_friction.level = 0.09
stribeck_friction.level = 0.06
stribeck_friction.velocity = 0.02
dead_zone.left = 0.06
dead_zone.right = 0.08
{more}
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "two_sine"
frequencies = [0.26, 0.37]
amplitude = 0.6
stabilise = {{ on = "ball_position", kp = 7.0, kd = 3.0 }}
duration = 300.0
"""


def state_after(*lines: dict[str, Any]) -> ShadowState:
    state = ShadowState("bench", "fit.json")
    for line in lines:
        state.handle_line(line)
    return state


def said(state: ShadowState, now_ns: int = NOW_NS) -> str:
    rows = state.rows(COLOURS, now_ns)
    return "\n".join([state.title(COLOURS, now_ns).plain, *(row.plain for row in rows)])


def test_each_state_is_said() -> None:
    assert "reads the model" in said(state_after())
    ready = {"validated": "test.mcap"}
    assert "waits for samples" in said(state_after(ready))
    assert state_after(ready).about() == "99.9 % of its errors on test.mcap"
    assert state_after({"validated": ""}).about() == "99.9 % of noise"
    agreeing = state_after(ready, stretch_line(3, left=False))
    assert agreeing.agrees
    assert "✓ agrees (6.0 s)" in said(agreeing, NOW_NS - 6_000_000_000)
    assert "ball_position agrees  ± 3.8 × 0.00044 m" in said(agreeing)
    left = state_after(ready, stretch_line(3, left=False), stretch_line(9, left=True))
    assert not left.agrees
    assert "✕ left its band (12.0 s)" in said(left)
    beyond = left.outputs["ball_position"].beyond
    assert beyond > 5.0
    assert f"left at 9.7 s, 3.0 s ago: × {beyond:.1f} noise levels beyond" in said(left)
    late = state_after(ready, stretch_line(9, left=False, dropped=2.46))
    assert "! 2.5 s not simulated" in said(late)
    assert "no samples" not in said(state_after(stretch_line(9, left=False)))
    resting = state_after(stretch_line(9, left=False), {"unjudged": "too little motion"})
    assert "– not judged: too little motion" in said(resting)
    resting.handle_line(stretch_line(9, left=False))
    assert "not judged" not in said(resting)
    later = NOW_NS + 10_000_000_000
    assert "◌ no samples for 10" in said(state_after(stretch_line(9, left=False)), later)
    assert said(state_after({"failed": "x: expected y"})) == "✕ x: expected y"
    assert said(state_after({"ended": 1, "complaint": "killed"})) == "✕ killed"
    assert said(state_after({"failed": "why"}, {"ended": 2, "complaint": ""})) == "✕ why"


def test_the_residual_has_a_gap_between_stretches_and_lies_at_its_time() -> None:
    state = state_after(stretch_line(3, left=False), stretch_line(4, left=False))
    t, residual = state.outputs["ball_position"].residual(NOW_NS)
    assert t[0] == pytest.approx(-7.3)
    assert np.flatnonzero(np.isnan(residual)).tolist() == [100, 201]
    assert t[200] == pytest.approx(-5.31)


@pytest.mark.extended
@pytest.mark.parametrize("size", [(80, 24), (160, 50)])
def test_b_chooses_a_model_shows_it_and_takes_it_away(
    folder: Path, monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]
) -> None:
    monkeypatch.setattr(shadow, "Helper", StillHelper)

    async def go() -> None:
        app = LabApp(folder, StillLab(), theme=DARK.name)  # type: ignore[arg-type]
        async with app.run_test(size=size) as pilot:
            await pilot.press("2")
            await pilot.pause(0.3)
            await pilot.press("b")
            await until(pilot, lambda: isinstance(app.screen, Choose))
            listed = app.screen.query_one(OptionList)
            assert listed.option_count == 2
            await pilot.press("down", "enter")
            view = app.base.query_one(ShadowView)
            await until(pilot, lambda: view.state is not None and bool(view.state.outputs))
            assert view.state is not None
            assert (view.state.device, view.state.agrees) == ("bench", False)
            helper = view._helper
            assert isinstance(helper, StillHelper)
            assert (helper.told["device"], helper.told["stream"]) == ("bench", "state")
            assert Path(helper.told["model"]).is_absolute()
            assert view.display
            assert view.region.bottom <= app.size.height - 1
            await pilot.press("question_mark")
            await until(pilot, lambda: bool(app.screen.query(HelpPanel)))
            await pilot.press("question_mark", "b")
            await until(pilot, lambda: view.state is None)
            assert not view.display
            await app.workers.wait_for_complete()
            assert not helper.running

    asyncio.run(go())


@pytest.mark.extended
def test_without_a_result_b_says_what_is_needed(tmp_path: Path) -> None:
    async def go() -> None:
        app = LabApp(tmp_path, StillLab(), theme=DARK.name)  # type: ignore[arg-type]
        async with app.run_test(size=(80, 24)) as pilot:
            await pilot.press("2")
            await pilot.pause(0.3)
            await pilot.press("b")
            await until(pilot, lambda: bool(app._notifications))
            told = next(iter(app._notifications)).message
            assert "a fit or a diagnosis in this folder" in told
            assert app.base.query_one(ShadowView).state is None

    asyncio.run(go())


async def until(pilot: Pilot[None], condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not come to that"
        await pilot.pause(0.05)


@pytest.mark.extended
@pytest.mark.timeout(300)
@pytest.mark.parametrize("concealed", [False, True], ids=["the model", "more than the model"])
def test_a_model_beside_a_twin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, concealed: bool) -> None:
    monkeypatch.chdir(tmp_path)
    more = ('"constant_force"', "constant_force.force = 0.05") if concealed else ("", "")
    rig = ROOT / "recordings" / "ball_beam.toml"
    text = EXPERIMENT.format(rig=rig, more_terms=more[0] and f", {more[0]}", more=more[1])
    (tmp_path / "shadowed.toml").write_text(text, encoding="utf-8")
    shutil.copy(ROOT / "examples" / "fit.json", tmp_path)
    shutil.copy(ROOT / "recordings" / "ball_beam_test.mcap", tmp_path)

    async def go() -> None:
        with Session(()) as lab:
            app = LabApp(tmp_path, lab)
            async with app.run_test(size=(80, 24)) as pilot:
                await pilot.press("3")
                await pilot.pause(0.5)
                await pilot.press("enter")
                await until(pilot, lambda: app.runner.state == "running")
                await pilot.press("2")
                await until(pilot, lambda: bool(lab.signal_sources()))
                await pilot.pause(0.5)
                await pilot.press("b")
                await until(pilot, lambda: isinstance(app.screen, Choose))
                await pilot.press("enter")
                view = app.base.query_one(ShadowView)
                await until(pilot, lambda: view.state is not None and bool(view.state.failed or enough(view)))
                state = view.state
                assert state is not None
                assert (state.failed, state.validated) == ("", "ball_beam_test.mcap"), app.runner.reason
                output = state.outputs["ball_position"]
                assert state.agrees is not concealed
                if concealed:
                    assert output.left_at is not None
                    assert 0.0 < output.left_at < 8.0
                    assert output.left_ns is not None
                    assert 0.0 <= (time.time_ns() - output.left_ns) * 1e-9 < PATIENCE
                app.runner.request("stop", "seen enough")
                await until(pilot, lambda: not app.runner.is_active)

    asyncio.run(go())


def enough(view: ShadowView) -> bool:
    """Whether some stretches were simulated, of the samples of some seconds."""
    state = view.state
    return state is not None and bool(state.outputs) and state.until > 8.0
