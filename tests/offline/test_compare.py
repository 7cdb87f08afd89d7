"""``labhil compare``: figures, verdicts, pages and refusals."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import labhil as lh
from labhil.analysis.paired import block_squares, paired_p_value
from labhil.analysis.schema import Parameter
from labhil.analysis.shared_parameters import compare_values
from labhil.report.formatting import format_powers
from labhil.report.html.overlay import COLOURS

ROOT = Path(__file__).parents[2]
IDENTIFY, TEST = (ROOT / "recordings" / f"ball_beam_{name}.mcap" for name in ("identify", "test"))
TERMS = {
    "viscous": ["viscous_friction"],
    "coulomb": ["viscous_friction", "coulomb_friction"],
    "full": ["viscous_friction", "coulomb_friction", "stribeck_friction", "dead_zone"],
    "more": ["viscous_friction", "coulomb_friction", "stribeck_friction", "dead_zone", "time_delay"],
}
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


pytestmark = [pytest.mark.extended, pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def fits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Fit the same recording with more and more terms, and once with a part of it held out."""
    folder = tmp_path_factory.mktemp("fits")
    found = {}
    for name, terms in TERMS.items():
        fit = lh.fit(IDENTIFY, terms=terms, test=TEST, estimator="nlse")
        found[name] = fit.save(folder / f"{name}.json")
    held = lh.fit(IDENTIFY, terms=TERMS["coulomb"], estimator="nlse")
    return found | {"held": held.save(folder / "held.json")}


def content(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def test_its_figures_are_those_of_the_fits(labhil, fits, tmp_path):
    names = ("viscous", "coulomb", "full")
    done = labhil("compare", *(fits[name] for name in names), "--json", "c.json")
    assert done.status == 0, done.err
    found = content(tmp_path / "c.json")
    assert found["schema"] == "labhil.comparison/1"
    for name, row in zip(names, found["models"], strict=True):
        own = content(fits[name])["test"]["per_channel"][0]
        for figure in ("rmse", "noise_floor", "r2", "max_abs_error"):
            assert row["per_channel"][0][figure] == pytest.approx(own[figure], rel=1e-9), (name, figure)
    assert (found["verdict"], found["best"], found["preferred"]) == ("one_best", "full.json", "full.json")
    assert [row["n_parameters"] for row in found["models"]] == [1, 2, 6]
    assert [row["worse_than_best"] for row in found["models"]] == [True, True, False]
    assert found["statement"].startswith("full.json explains the recording best, to the noise")
    said = " ".join(done.out.split())
    assert said.startswith(found["statement"])
    rmse = f"{found['models'][2]['per_channel'][0]['rmse']:.4g} m"
    for expected in ("ball_position", rmse, "DISAGREE", "What to do next", "labhil verify"):
        assert expected in said, expected


def test_shared_parameters_stand_side_by_side_as_in_the_fits(fits):
    found = lh.compare(fits["coulomb"], fits["full"], fits["more"])
    level = next(row for row in found.parameters if row.name == "coulomb_friction.level")
    assert level.agree is False
    for value, name in zip(level.values, ("coulomb", "full", "more"), strict=True):
        own = lh.Fit.load(fits[name]).parameters["coulomb_friction.level"]
        assert (value.model, value.value, value.ci99) == (f"{name}.json", own.value, own.ci99)
    zone = next(row for row in found.parameters if row.name == "dead_zone.left")
    assert [value.model for value in zone.values] == ["full.json", "more.json"]
    assert zone.agree is True


def test_models_that_differ_by_noise_are_alike_and_the_simpler_is_preferred(fits):
    found = lh.compare(fits["more"], fits["full"], fits["coulomb"])
    assert (found.verdict, found.preferred) == ("alike", "full.json")
    assert not found.models["more.json"].worse_than_best
    assert found.models["coulomb.json"].worse_than_best
    assert "no more than noise" in found.statement
    assert any(step.startswith("Take full.json") for step in found.next_steps)


def test_without_a_test_recording_the_held_out_stretch_is_compared_on(fits):
    found = lh.compare(fits["held"], fits["coulomb"])
    own = lh.Fit.load(fits["held"])
    assert own.test is not None
    assert found.models["held.json"].per_channel[0].rmse == pytest.approx(own.test.rmse, rel=1e-9)
    assert found.recordings[0].start == pytest.approx(own.to_dict()["held_out"][0][0])
    assert not found.models["held.json"].fitted_to_it
    assert found.models["coulomb.json"].fitted_to_it
    notes = " ".join(found.notes)
    assert "judged on different recordings" in notes
    assert "Fitted to these data: coulomb.json" in notes
    assert any("--recording" in step for step in found.next_steps)


def test_an_older_result_that_does_not_say_what_was_held_out(fits, tmp_path):
    data = content(fits["held"])
    span = data.pop("held_out")[0]
    older = tmp_path / "older.json"
    older.write_text(json.dumps(data), encoding="utf-8")
    found = lh.compare(older, fits["coulomb"])
    assert found.recordings[0].start == pytest.approx(span[0], abs=0.02)
    assert "its last 30 % are taken" in " ".join(found.notes)


def test_recordings_among_the_results_are_what_is_compared_on(labhil, fits, tmp_path):
    both = (fits["coulomb"], fits["full"])
    labhil("compare", *both, IDENTIFY, TEST, "--json", "a.json")
    labhil("compare", *both, "--recording", IDENTIFY, "--recording", TEST, "--json", "b.json")
    one, other = content(tmp_path / "a.json"), content(tmp_path / "b.json")
    assert one | {"seconds": 0} == other | {"seconds": 0}
    assert [Path(source["path"]).name for source in one["recordings"]] == [IDENTIFY.name, TEST.name]
    assert all(row["fitted_to_it"] for row in one["models"])
    apart = [lh.compare(*both, recording=each) for each in (IDENTIFY, TEST)]
    mse = [each.models["full.json"].per_channel[0].mse for each in apart]
    counts = [len(each.study.recordings[0].scores[0].rows) for each in apart]
    assert one["models"][1]["per_channel"][0]["mse"] == pytest.approx(np.average(mse, weights=counts))


def test_results_of_every_kind_saved_or_not(fits, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    verified = lh.verify(TEST, fits["full"]).save(tmp_path / "verified.json")
    found = lh.compare(verified, "examples/diagnosis.json", lh.Fit.load(fits["coulomb"]))
    assert list(found.models) == ["full.json", "diagnosis.json", "coulomb.json"]
    assert [model.made_by for model in found.models.values()] == ["fit", "diagnosis", "fit"]
    unsaved = lh.fit(IDENTIFY, terms=["viscous_friction"], test=TEST, estimator="nlse", span=(0, 12))
    assert "--model MODEL.json" in " ".join(lh.compare(unsaved, unsaved).next_steps)
    again = lh.load(found.save(tmp_path / "c.json"))
    assert again == found
    assert str(again) == str(found)
    frame = found.to_pandas()
    assert list(frame.index) == list(found.models)
    assert frame.loc["coulomb.json", "worse_than_best"]


def test_the_page_has_a_switch_for_every_model(labhil, fits, tmp_path):
    names = ("viscous", "coulomb", "full")
    done = labhil("compare", *(fits[n] for n in names), "--html", "c.html", "--json", "c.json")
    assert done.status == 0, done.err
    page = (tmp_path / "c.html").read_text(encoding="utf-8")
    assert page.count("<script") == 1  # ours
    assert not re.findall(r'(?:src|href)="(?!#|data:)', page)
    found = content(tmp_path / "c.json")
    assert html.escape(format_powers(found["statement"])) in page
    assert all(step.split("`")[0] in page for step in found["next_steps"])
    for number, name in enumerate(("measured", *(f"{n}.json" for n in names))):
        assert f'id="show-{number}"' in page
        assert f"</span>{name}</label>" in page
        assert len(re.findall(rf'id="f1-model-{number}-', page)) == (2 if number else 1)
    assert f"{found['models'][1]['per_channel'][0]['rmse']:.4g}\N{NO-BREAK SPACE}m" in page
    assert labhil("report", "c.json", "-o", "again.html").status == 0
    again = (tmp_path / "again.html").read_text(encoding="utf-8")
    assert html.escape(format_powers(found["statement"])) in again
    assert "<svg" not in again


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")
@pytest.mark.parametrize("media", ["screen", "print"])
def test_a_browser_hides_the_model_that_is_switched_off(fits, tmp_path, media):
    page = tmp_path / "c.html"
    lh.compare(fits["viscous"], fits["full"]).report(page)
    text = page.read_text(encoding="utf-8")
    if media == "print":  # as it prints, on a screen
        text = text.replace("@media print", "@media all").replace("@page", "@font-feature-values x")
    off = text.replace('class="show-1" checked="checked"', 'class="show-1"')
    assert off != text
    lines = [drawn_in(tmp_path, name, each) for name, each in (("on", text), ("off", off))]
    legend = 100  # pixels of the swatch, which stays on the screen
    assert lines[0] > 2000
    assert lines[1] < legend + 200


def drawn_in(folder: Path, name: str, text: str) -> int:
    """Count the pixels that have the colour of the first model."""
    (folder / f"{name}.html").write_text(text, encoding="utf-8")
    assert CHROMIUM is not None
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
        f"--user-data-dir={folder / 'profile'}", "--window-size=1200,1400",
        f"--screenshot={folder / name}.png", f"file://{folder / name}.html",
    ]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    pixels = np.asarray(Image.open(folder / f"{name}.png").convert("RGB"), dtype=np.int64)
    colour = [int(COLOURS[0][i : i + 2], 16) for i in (1, 3, 5)]
    return int(np.sum(np.abs(pixels - colour).max(axis=2) < 60))


def test_bad_input_is_refused_with_what_was_expected(labhil, fits, tmp_path):
    full, coulomb = fits["full"], fits["coulomb"]
    assert "expected two results or more" in labhil("compare", full).refused()
    assert "8 results at most" in labhil("compare", *(9 * [full])).refused()
    assert "none.json" in labhil("compare", full, "none.json").refused()
    (tmp_path / "text.json").write_text("no JSON", encoding="utf-8")
    assert "text.json" in labhil("compare", full, "text.json").refused()
    (tmp_path / "odd.json").write_text('{"schema": "other/1"}', encoding="utf-8")
    assert "other/1" in labhil("compare", full, "odd.json").refused()
    assert "none.mcap" in labhil("compare", full, coulomb, "--recording", "none.mcap").refused()
    assert "--horizon" in labhil("compare", full, coulomb, "--horizon", "-1").refused()
    assert "nowhere" in labhil("compare", full, coulomb, "--html", "nowhere/c.html").refused()


def test_models_of_other_rigs_and_lost_recordings_are_refused(labhil, fits, tmp_path):
    data = content(fits["coulomb"])
    other = {**data, "recordings": [{**each, "rig": "axis"} for each in data["recordings"]]}
    (tmp_path / "axis.json").write_text(json.dumps(other), encoding="utf-8")
    said = labhil("compare", fits["full"], "axis.json").refused()
    assert "expected a model of ball_beam" in said
    gone = {**data, "recordings": [{**each, "path": "gone.mcap"} for each in data["recordings"]]}
    (tmp_path / "gone.json").write_text(json.dumps(gone), encoding="utf-8")
    said = labhil("compare", "gone.json", fits["full"]).refused()
    assert "gone.mcap" in said
    assert "--recording" in said


def test_what_is_no_more_than_noise_is_rarely_called_more():
    """False alarms of the paired test at 5 %, of white errors and of slowly varying ones."""
    rng = np.random.default_rng(11)
    for memory in (0.0, 0.7):
        alarms = 0
        for _ in range(1500):
            logs = np.zeros((2, 26))
            for k in range(1, 26):
                logs[:, k] = memory * logs[:, k - 1] + rng.normal(size=2)
            sizes = np.exp(logs[:, 6:])
            order = np.argsort(sizes.mean(axis=1))
            alarms += paired_p_value(*sizes[order]) < 0.05
        assert alarms / 1500 < 0.1, memory


def test_what_is_more_than_noise_is_called_so():
    rng = np.random.default_rng(12)
    window = np.repeat(np.arange(6), 100)
    good, bad = rng.normal(size=(600, 1)), rng.normal(size=(600, 1)) * 1.5
    one, other = (block_squares([each], [window], np.ones(1)) for each in (good, bad))
    assert len(one) == 12
    assert paired_p_value(one, other) < 1e-4
    assert paired_p_value(one, one) == 1.0
    bad[300] = np.inf
    assert np.isfinite(block_squares([bad], [window], np.ones(1))).all()


def test_values_agree_within_their_errors():
    def row(value: float | None, error: float | None, **more: Any) -> Parameter:
        return Parameter(name="x", value=value, std_error=error, **more)

    assert compare_values([row(1.0, 0.1), row(1.2, 0.1)])[2] is True
    z, p_value, agree = compare_values([row(1.0, 0.1), row(2.0, 0.1), row(1.1, 0.1)])
    assert (z, agree) == (pytest.approx(7.0710678), False)
    assert p_value is not None
    assert p_value < 1e-10
    assert compare_values([row(1.0, None), row(2.0, 0.1)])[2] is None
    assert compare_values([row(1.0, 0.1, identifiable=False), row(2.0, 0.1)])[2] is None
    assert compare_values([row(1.0, None, held=True), row(1.0, None, held=True)])[2] is True
    assert compare_values([row(1.0, None, held=True), row(1.1, None, held=True)])[2] is False
