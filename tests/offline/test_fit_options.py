"""What `labhil fit` may be asked for beside its terms: a stretch, nothing held out, another criterion."""

from __future__ import annotations

import json

from typer.testing import CliRunner

from labhil.command_line import app
from labhil.diagnose.timing import detect_all_faults

TERMS = ("--terms", "viscous_friction", "--window", "1", "--estimator", "nlse")


def test_a_stretch_of_the_recording_is_fitted_alone(labhil, shipped, tmp_path):
    recording = shipped / "ball_beam_identify.mcap"
    done = labhil(*("fit", recording, *TERMS, "--span", "5", "15", "--holdout", "0", "--json", "f.json"))
    assert done.status == 0, done.err
    data = json.loads((tmp_path / "f.json").read_text())
    (source,) = data["recordings"]
    assert abs(source["start"] - 5.0) < 0.05
    assert abs(source["duration"] - 10.0) < 0.05
    assert data["test"] is None
    assert data["criterion"] == "windowed_simulation"
    (left,) = data["left"]
    assert (left["channel"], left["unit"]) == ("ball_position", "m")
    assert f"RMSE there {left['rmse']:.4g} m" in done.out
    refused = labhil("fit", recording, *TERMS, "--span", "500", "510").refused()
    for told in ("--span 500 510", "at least 20 samples", "found 0"):
        assert told in refused


def test_criteria_that_a_rig_does_not_have_are_refused(labhil, shipped):
    recording = shipped / "ball_beam_identify.mcap"
    assert "axis and ur5" in labhil("fit", recording, *TERMS, "--criterion", "inverse_dynamics").refused()
    unknown = labhil("fit", recording, *TERMS, "--criterion", "inverse_dynamic").refused()
    assert "did you mean 'inverse_dynamics'" in unknown
    assert "0 to hold nothing out" in labhil("fit", recording, *TERMS, "--holdout", "0.01").refused()


def test_a_fit_looks_for_faults_of_the_data_once(monkeypatch, shipped):
    looks = []

    def counted(*what):
        looks.append(what)
        return detect_all_faults(*what)

    monkeypatch.setattr("labhil.analysis.dataset.detect_all_faults", counted)
    recording = shipped / "ball_beam_identify.mcap"
    done = CliRunner().invoke(app, ["fit", str(recording), *TERMS, "--span", "0", "20"])
    assert done.exit_code == 0, done.output
    assert len(looks) == 1
