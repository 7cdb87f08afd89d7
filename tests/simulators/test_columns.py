"""Columns of simulated output beside measured ones: what lies between them, and what a column cannot say."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import labhil as lh
from labhil.command_line import app
from labhil.errors import RigFileError, UsageError
from labhil.rig import load_rig, parse_rig
from labhil.signals import FloatArray

NOISE = 0.002
T = np.arange(0.0, 30.0, 0.01)
SIMULATED = np.sin(2.0 * T) + 0.3 * np.sin(7.0 * T + 1.0) + 0.2 * np.sin(0.7 * T)


def measured(change: Callable[[FloatArray], FloatArray], seed: int = 1) -> lh.Recording:
    rig = lh.simulated_output("angle", "rad", beside={"torque": "N·m"})
    noise = np.random.default_rng(seed).normal(0.0, NOISE, len(T))
    return lh.recording(
        T,
        {"simulated_angle": SIMULATED},
        {"angle": change(SIMULATED) + noise},
        rig=rig,
        others={"torque": np.cos(3.0 * T)},
    )


def play(x: FloatArray) -> FloatArray:
    """Behind a play of 0.1 rad."""
    y, at = np.empty_like(x), x[0]
    for k, value in enumerate(x):
        at = min(max(at, value - 0.05), value + 0.05)
        y[k] = at
    return y


def lag(x: FloatArray) -> FloatArray:
    """Behind a first-order lag of 50 ms, of an input that is straight between samples, solved exactly."""
    y, decay, share = np.empty_like(x), np.exp(-0.2), (1.0 - np.exp(-0.2)) / 0.2
    y[0] = x[0] - 0.05 * (x[1] - x[0]) / 0.01
    for k in range(len(x) - 1):
        y[k + 1] = decay * y[k] + (share - decay) * x[k] + (1.0 - share) * x[k + 1]
    return y


@pytest.mark.parametrize(
    ("term", "parameter", "value", "change"),
    [
        ("clock_offset", "offset", 0.03, lambda x: np.interp(T - 0.03, T, x)),
        ("clock_offset", "offset", -0.02, lambda x: np.interp(T + 0.02, T, x)),
        ("sensor_gain", "gain", 0.05, lambda x: 1.05 * x),
        ("sensor_lag", "time_constant", 0.05, lag),
        ("sensor_nonlinearity", "cubic", -0.02, lambda x: x - 0.02 * x**3),
        ("backlash", "gap", 0.1, play),
        ("saturation", "inverse_limit", 0.8, lambda x: np.clip(x, -1.25, 1.25)),
    ],
)
def test_a_fit_has_the_value_that_was_put_in(
    term: str, parameter: str, value: float, change: Callable[[FloatArray], FloatArray]
) -> None:
    fit = lh.fit(measured(change), terms=[term], holdout=0.0, estimator="nlse", intervals="wald")
    row = fit.parameters[f"{term}.{parameter}"]
    assert abs(row.value - value) < max(5.0 * row.std_error, 0.01 * abs(value))


def test_an_equal_column_is_no_mismatch_and_forces_are_left_open() -> None:
    diagnosis = lh.diagnose(measured(lambda x: x))
    assert diagnosis.verdict == "no_mismatch"
    reasons = {item.term: item.reason for item in diagnosis.undecided}
    assert "give the simulator itself" in reasons["coulomb_friction"]


@pytest.mark.extended
def test_two_effects_are_named_and_a_bump_is_a_curve_over_the_simulated_value() -> None:
    named = lh.diagnose(measured(lambda x: 1.05 * np.interp(T - 0.03, T, x)))
    assert {effect.term for effect in named.missing} == {"clock_offset", "sensor_gain"}
    bumped = lh.diagnose(measured(lambda x: x + 0.1 * np.exp(-0.5 * ((x - 0.4) / 0.1) ** 2)))
    (effect,) = bumped.missing
    assert effect.term == "unmodelled_force"
    assert "a difference of the output that depends on simulated_angle" in str(bumped)
    assert bumped.improvement is not None
    assert bumped.improvement.rmse_after < 1.1 * NOISE


@pytest.mark.extended
def test_what_acts_inside_the_mechanism_is_not_taken_for_an_effect_of_the_output() -> None:
    """A pendulum with dry friction that its simulation lacks: the difference has a dynamics of its own."""
    u = 0.8 * np.sin(2.1 * T) + 0.5 * np.sin(0.9 * T + 1.0) + 0.3 * np.sin(5.3 * T)

    def swing(friction: float) -> FloatArray:
        x = v = 0.0
        angle = np.empty(len(T))
        for k in range(len(T)):
            angle[k] = x
            for _ in range(20):
                v += 5e-4 * (u[k] - 4.0 * np.sin(x) - 0.15 * v - friction * np.tanh(v / 1e-3)) / 0.2
                x += 5e-4 * v
        return angle

    noise = np.random.default_rng(3).normal(0.0, 1e-3, len(T))
    rig = lh.simulated_output("angle", "rad", beside={"torque": "N·m"})
    rec = lh.recording(
        T, {"simulated_angle": swing(0.0)}, {"angle": swing(0.15) + noise}, rig=rig, others={"torque": u}
    )
    diagnosis = lh.diagnose(rec)
    assert diagnosis.verdict == "unexplained_mismatch"
    assert not diagnosis.missing


RIG = """
[model]
simulated = { angle = "rad" }

[channels]
t = { column = "time" }
angle = { column = "pot", scale = 0.001 }
simulated_angle = { column = "model" }
"""


def test_a_table_with_both_columns_is_imported_and_fitted_on_the_command_line(tmp_path: Path) -> None:
    """The rig file comes along in the recording: nothing is loaded for it."""
    noise = np.random.default_rng(1).normal(0.0, NOISE, len(T))
    columns = np.column_stack([T, 1000.0 * (1.05 * SIMULATED + noise), SIMULATED])
    np.savetxt(tmp_path / "log.csv", columns, delimiter=",", header="time,pot,model", comments="")
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    table, rec, fit = (str(tmp_path / name) for name in ("log.csv", "log.mcap", "fit.json"))
    for command in (
        ["import", table, "--rig", str(tmp_path / "rig.toml"), "-o", rec],
        ["fit", rec, "--terms", "sensor_gain", "--estimator", "nlse", "--json", fit],
    ):
        done = CliRunner().invoke(app, command)
        assert done.exit_code == 0, done.output
    (row,) = json.loads(Path(fit).read_text(encoding="utf-8"))["parameters"]
    assert row["value"] == pytest.approx(0.05, abs=1e-3)


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ("simulated = {}", "at least 1"),
        ('simulated = { angle = "rad", simulated_angle = "rad" }', "each once"),
        ('simulated = { angle = "rad" }\nmujoco = "arm.xml"', "give either"),
        ('python = "bench.py:arm"\nbeside = { torque = "N" }', "beside is for simulated"),
        ('simulated = { "an angle" = "rad" }', "expected names of letters, digits and _"),
    ],
)
def test_a_section_that_cannot_be_meant_is_refused(tmp_path: Path, section: str, expected: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(f"[model]\n{section}\n", encoding="utf-8")
    with pytest.raises(RigFileError, match=expected):
        load_rig(path)


def test_a_saved_recording_says_what_its_columns_are(tmp_path: Path) -> None:
    path = tmp_path / "columns.mcap"
    rig = lh.simulated_output("angle", "rad", beside={"torque": "N·m"}, horizon=2.0)
    others = {"torque": np.cos(T)}
    lh.recording(T, {"simulated_angle": SIMULATED}, {"angle": SIMULATED}, rig=rig, others=others).save(path)
    command = [sys.executable, "-c", f"import labhil as lh; print(lh.read({str(path)!r}).model)"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "Model of simulated_angle" in said
    assert rig.rig_file.metric.horizon == 2.0


def test_names_are_held_apart() -> None:
    with pytest.raises(UsageError, match="each once, found angle, simulated_angle, angle"):
        lh.simulated_output("angle", "rad", beside={"angle": "rad"})
    assert parse_rig(RIG, Path("rig.toml")).kind.name == "simulated_angle"


def measured_both(seed: int = 1) -> lh.Recording:
    """An angle with a gain of 1.05, and its rate, which is 30 ms late and a thousand times as large."""
    rig = lh.simulated_outputs({"angle": "rad", "rate": "mrad/s"}, beside={"torque": "N·m"})
    rate = 1000.0 * np.gradient(SIMULATED, T)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (2, len(T)))
    return lh.recording(
        T,
        {"simulated_angle": SIMULATED, "simulated_rate": rate},
        {"angle": 1.05 * SIMULATED + NOISE * noise[0], "rate": np.interp(T - 0.03, T, rate) + 5.0 * noise[1]},
        rig=rig,
        others={"torque": np.cos(3.0 * T)},
    )


def test_two_outputs_are_fitted_together_each_with_effects_of_its_own() -> None:
    terms = ["angle_sensor_gain", "rate_clock_offset"]
    fit = lh.fit(measured_both(), terms=terms, holdout=0.0, estimator="nlse", intervals="wald")
    for name, value in (("angle_sensor_gain.gain", 0.05), ("rate_clock_offset.offset", 0.03)):
        row = fit.parameters[name]
        assert abs(row.value - value) < max(5.0 * row.std_error, 0.01 * value)


@pytest.mark.extended
def test_a_diagnosis_of_two_outputs_names_what_each_of_them_has() -> None:
    found = lh.diagnose(measured_both())
    assert {effect.term for effect in found.missing} == {"angle_sensor_gain", "rate_clock_offset"}
    assert found.improvement is not None
    errors = {row.channel: row for row in found.improvement.after.scored}
    assert errors["angle"].rmse < 1.1 * NOISE
    assert errors["rate"].rmse < 1.1 * 5.0


@pytest.mark.extended
def test_two_equal_columns_are_no_mismatch() -> None:
    rig = lh.simulated_outputs({"angle": "rad", "rate": "rad/s"})
    rate = np.gradient(SIMULATED, T)
    noise = np.random.default_rng(2).normal(0.0, NOISE, (2, len(T)))
    inputs = {"simulated_angle": SIMULATED, "simulated_rate": rate}
    rec = lh.recording(T, inputs, {"angle": SIMULATED + noise[0], "rate": rate + noise[1]}, rig=rig)
    assert lh.diagnose(rec).verdict == "no_mismatch"


def test_a_rig_file_with_two_outputs_comes_along_in_a_recording(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.replace('angle = "rad" }', 'angle = "rad", rate = "rad/s" }', 1), encoding="utf-8")
    kind = load_rig(rig).kind
    assert [signal.name for signal in kind.inputs] == ["simulated_angle", "simulated_rate"]
    assert [signal.name for signal in kind.outputs] == ["angle", "rate"]
    path = tmp_path / "both.mcap"
    measured_both().save(path)
    command = [sys.executable, "-c", f"import labhil as lh; print(lh.read({str(path)!r}).model)"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "Model of simulated_angle_and_rate" in said
