"""Results of ``import labhil``: they print as the commands do, come back from their files, and draw."""

from __future__ import annotations

import importlib.util
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

import labhil as lh
from labhil.cli import main
from labhil.errors import MissingExtraError, ModelFileError, UnknownNameError, UsageError

ROOT = Path(__file__).parents[2]
IDENTIFY = ROOT / "recordings" / "ball_beam_identify.mcap"
TEST = ROOT / "recordings" / "ball_beam_test.mcap"
TERMS = ["viscous_friction", "coulomb_friction", "stribeck_friction", "dead_zone"]


@pytest.fixture(scope="module")
def fit() -> lh.Fit:
    return lh.fit(IDENTIFY, terms=TERMS, span=(0, 12), estimator="nlse")


@pytest.fixture(scope="module")
def dx() -> lh.Diagnosis:
    return lh.diagnose(IDENTIFY, baseline=TERMS[:3], span=(0, 15))


def test_a_printed_fit_is_what_the_command_prints_and_its_file_what_the_command_writes(
    fit, tmp_path, monkeypatch, capsys
):
    out = tmp_path / "fit.json"
    command = ["labhil", "fit", str(IDENTIFY), "--terms", ",".join(TERMS), "--span", "0", "12"]
    monkeypatch.setattr("sys.argv", [*command, "--estimator", "nlse", "--json", str(out)])
    with pytest.raises(SystemExit):
        main()
    printed = "\n".join(line.rstrip() for line in capsys.readouterr().out.splitlines())
    assert printed == str(fit)
    written, saved = json.loads(out.read_text()), json.loads(fit.save(tmp_path / "own.json").read_text())
    assert {**written, "seconds": 0} == {**saved, "seconds": 0}
    assert out.read_text().count("\n") == (tmp_path / "own.json").read_text().count("\n")


@pytest.mark.extended
@pytest.mark.parametrize("name", ["fit", "dx"])
def test_a_result_comes_back_from_its_file_and_from_a_pickle(name, request, tmp_path):
    result = request.getfixturevalue(name)
    for again in (lh.load(result.save(tmp_path / "it.json")), pickle.loads(pickle.dumps(result))):
        assert type(again) is type(result)
        assert again == result
        assert hash(again) == hash(result)
        assert str(again) == str(result)
        assert again._repr_html_() == result._repr_html_()
        with pytest.raises(UsageError, match="holds no samples"):
            again.plot()
        assert again.report(tmp_path / "page.html").read_text().startswith("<!DOCTYPE html>")


def test_recordings_models_and_simulations_are_pickled(fit):
    rec = lh.read(TEST)
    for piece in (rec, rec.model):
        assert pickle.loads(pickle.dumps(piece)) == piece
    run = fit.simulate(rec)
    assert repr(pickle.loads(pickle.dumps(run))) == repr(run)


def test_results_do_not_change(fit):
    data = fit.to_dict()
    data["parameters"][0]["value"] = -1.0
    assert fit.parameters[0].value != -1.0
    with pytest.raises(AttributeError):
        fit.verdict = "explained"
    with pytest.raises(Exception, match="frozen"):
        fit.parameters[0].value = 0.0


def test_parameters_are_read_by_name_and_by_place(fit):
    assert fit.parameters["dead_zone.left"] is fit.parameters[4]
    assert [row.name for row in fit.parameters][:2] == fit.parameters.keys()[:2]
    with pytest.raises(UnknownNameError, match=r"did you mean 'dead_zone\.left'"):
        fit.parameters["dead_zone.lft"]
    assert fit.covariance.shape == (6, 6)
    errors = [row.std_error for row in fit.parameters]
    assert np.sqrt(np.diag(fit.covariance)) == pytest.approx(errors)


@pytest.mark.extended
def test_the_model_of_a_fit_runs_on_another_recording_as_it_was_scored(fit):
    on_test = fit.simulate(lh.read(TEST))
    assert on_test.simulated["ball_position"].shape == on_test.t.shape == (len(lh.read(TEST)),)
    scored = np.isfinite(on_test.simulated["ball_position"])
    error = (on_test.simulated["ball_position"] - on_test.measured["ball_position"])[scored]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(on_test.errors["ball_position"].rmse)
    judged = lh.fit(IDENTIFY, test=TEST, terms=TERMS, span=(0, 12), estimator="nlse")
    assert judged.simulate(TEST).errors["ball_position"].rmse == pytest.approx(judged.test.rmse)
    longer = fit.simulate(TEST, horizon=8.0)
    assert longer.horizon == 8.0
    with pytest.raises(UsageError, match="horizon"):
        fit.simulate(TEST, horizon=-1.0)
    assert set(on_test.window[np.isnan(on_test.simulated["ball_position"])]) == {-1}
    without = fit.simulate(TEST, without=["coulomb_friction"])
    assert without.errors["ball_position"].rmse > 3 * on_test.errors["ball_position"].rmse
    with pytest.raises(lh.errors.UnknownNameError, match=r"term 'coulomb' does not exist \(did you mean"):
        fit.simulate(TEST, without=["coulomb"])


def test_plots_of_a_fit_draw_into_given_axes_or_new_ones(fit):
    from matplotlib.figure import Figure

    mine = Figure().subplots()
    assert fit.plot(ax=mine) is mine
    assert len(mine.lines) == 2
    for axes in (fit.plot_errors(), fit.plot_residuals(), fit.plot_intervals()):
        assert axes.has_data()
    assert fit.simulate(TEST).plot().has_data()
    assert lh.read(TEST).plot("servo_angle").get_ylabel() == "servo_angle, rad"
    assert len(fit.figure().axes) == 4
    assert fit.plot(channel="ball_position").has_data()
    with pytest.raises(UsageError, match="channel: expected a number from 0 to 0 or one of ball_position"):
        fit.plot(channel=3)
    with pytest.raises(UsageError, match="ax: expected axes of matplotlib, found 'here'"):
        fit.plot("here")


@pytest.mark.extended
def test_plots_of_a_diagnosis_draw(dx):
    for axes in (dx.plot(), dx.plot_errors()):
        assert axes.has_data()
    assert dx.plot_effect("dead_zone").get_title(loc="left") == "Left out: dead_zone"
    with pytest.raises(UnknownNameError, match="dead_zone"):
        dx.plot_effect("payload")
    with pytest.raises(UnknownNameError, match="did you mean 'ball_position'"):
        dx.plot(channel="ball_positon")


@pytest.mark.extended
def test_a_diagnosis_says_what_is_missing_and_where(dx):
    assert dx.verdict == "missing_physics"
    effect = dx.missing[0]
    assert (effect.term, effect.joint) == ("dead_zone", None)
    assert effect.probability > 0.5
    assert effect.statement
    assert effect.equation
    assert effect.parameters["dead_zone.left"].value == pytest.approx(0.06, abs=0.005)
    assert dx.where.enters == "input"
    assert dx.improvement.rmse_after < dx.improvement.rmse_before
    assert "dead_zone" in dx.final.terms
    assert {each.term for each in dx.excluded} & {"spring_force", "constant_force"}
    assert str(dx).startswith("Physics is missing from the baseline.")


@pytest.mark.extended
def test_a_result_is_held_against_a_recording_and_starts_another_fit(fit, dx, tmp_path):
    verified = lh.verify(TEST, dx)
    assert not verified.contradicted
    assert str(verified).startswith("The recording is consistent with the model")
    again = lh.fit(IDENTIFY, start=fit, span=(0, 12), estimator="nlse")
    assert again.terms == fit.terms
    wrong = lh.verify(TEST, lh.fit(IDENTIFY, terms=TERMS[:1], span=(0, 12), estimator="nlse"))
    assert wrong.contradicted
    assert wrong.reasons
    for result, said in ((verified, "is consistent with the model"), (wrong, "contradicts the model")):
        page = result.report(tmp_path / "page.html").read_text()
        assert said in page
        assert lh.load(result.save(tmp_path / "it.json")) == result
        assert all(reason.split("(")[0] in page for reason in result.reasons)
    known = lh.Fit.load(ROOT / "examples" / "fit.json")
    assert lh.diagnose(IDENTIFY, reference=known).verdict == "no_mismatch"


def test_frames_are_made_or_what_to_install_is_said(fit, tmp_path):
    rec = lh.read(TEST)
    run = fit.simulate(rec)
    if importlib.util.find_spec("pandas") is None:
        with pytest.raises(MissingExtraError, match=r"labhil\[frames\]"):
            fit.to_pandas()
    else:
        assert fit.to_pandas().loc["dead_zone.left", "unit"] == "rad"
        assert rec.to_pandas()["ball_position"].to_numpy() == pytest.approx(rec["ball_position"])
        assert list(run.to_pandas()) == ["ball_position", "ball_position_simulated"]
        assert rec.model.terms.to_pandas().loc["dead_zone", "enters"] == "input"
    if importlib.util.find_spec("xarray") is None:
        with pytest.raises(MissingExtraError, match=r"labhil\[frames\]"):
            rec.to_xarray()
    else:
        assert rec.to_xarray()["ball_position"].attrs["units"] == "m"
        assert fit.to_xarray()["covariance"].shape == (6, 6)
        assert run.to_xarray()["ball_position_simulated"].dims == ("t",)


@pytest.mark.parametrize(
    ("p", "said"),
    [
        (1e-120, "not white, p <1e-99 (Ljung-Box)"),
        (0.5, "Residuals: white, p = 0.5"),
        (None, "not tested whether white"),
    ],
)
def test_residuals_that_are_refuted_to_be_white_are_not_called_white(p, said):
    data = json.loads((ROOT / "examples" / "fit.json").read_text(encoding="utf-8"))
    data["residuals"]["ljung_box_p"] = p
    assert said in lh.Fit(data).text()


def test_an_experiment_of_one_step_says_so():
    step = {"device": "bench", "signal": "voltage", "excitation": "hold", "level": 1.0, "duration": 2.0}
    devices = {"bench": {"plugin": "dc_motor", "address": "twin"}}
    assert repr(lh.Experiment("levels", devices=devices, steps=[step])).startswith(
        "<Experiment levels: 1 step, 2 s"
    )
    assert "2 steps" in repr(lh.Experiment("levels", devices=devices, steps=[step, step]))


def test_no_number_of_a_report_is_cut_however_narrow_it_is():
    for name in ("fit", "diagnosis"):
        text = lh.load(ROOT / "examples" / f"{name}.json").text(width=30)
        assert "…" not in text
    assert "[0.08927, 0.09056]" in lh.load(ROOT / "examples" / "fit.json").text(width=30)


def test_what_is_no_result_is_not_loaded(tmp_path):
    for text, said in (
        ("[", "expected"),
        ("{}", "no schema"),
        ('{"schema": "labhil.run/1"}', "labhil.run/1"),
    ):
        (tmp_path / "it.json").write_text(text)
        with pytest.raises(ModelFileError, match=said):
            lh.load(tmp_path / "it.json")
    with pytest.raises(ModelFileError, match="cannot be read"):
        lh.load(tmp_path / "not there.json")
    with pytest.raises(ModelFileError, match=r"found a recording \(MCAP\); labhil.read reads"):
        lh.load(ROOT / "recordings" / "ball_beam_test.mcap")
    with pytest.raises(ModelFileError, match="expected a Diagnosis, found a Fit"):
        lh.Diagnosis.load(ROOT / "examples" / "fit.json")
    broken = lh.load(ROOT / "examples" / "fit.json").to_dict() | {"parameters": [{"name": 3}]}
    (tmp_path / "it.json").write_text(json.dumps(broken))
    with pytest.raises(ModelFileError, match=r"it\.json"):
        lh.load(tmp_path / "it.json")
