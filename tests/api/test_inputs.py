"""What ``import labhil`` takes, and what it says to what it cannot take."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import labhil as lh
from labhil.errors import LabhilError, RecordingError, RigFileError, UnknownNameError, UsageError

ROOT = Path(__file__).parents[2]
IDENTIFY = ROOT / "recordings" / "ball_beam_identify.mcap"

T = np.arange(0.0, 10.0, 0.01)
U = 6.0 * np.sign(np.sin(2.0 * T))
# a motor of 0.2 s, and noise: of what no motor does every fit goes on to its last iteration
DECAY = float(np.exp(-0.01 / 0.2))
NOISE = np.random.default_rng(1).normal(0.0, 0.1, len(T))
SPEED = lfilter([0.0, 1.0 - DECAY], [1.0, -DECAY], 10.0 * U) + NOISE


def motor(**changes):
    given = {"t": T, "inputs": {"voltage": U}, "outputs": {"speed": SPEED}, "rig": "dc_motor"}
    return lh.recording(**(given | changes))


def spoilt(values, index, value):
    changed = values.copy()
    changed[index] = value
    return changed


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"inputs": {"voltage": U[:-1]}}, r"voltage: expected shape \(1000,\).*found \(999,\)"),
        ({"inputs": {"voltage": np.column_stack([U, U])}}, r"voltage: expected shape"),
        ({"inputs": {"volts": U}}, "volts: a dc_motor has no such signal"),
        ({"inputs": {"voltag": U}}, "did you mean 'voltage'"),
        ({"inputs": {}}, "inputs: a dc_motor needs voltage"),
        ({"inputs": U}, "inputs: expected a mapping of names to arrays, found ndarray"),
        ({"outputs": {}}, "outputs: a dc_motor needs speed or current"),
        ({"outputs": {"speed": ["fast"] * 1000}}, "speed: expected an array of numbers"),
        ({"outputs": {"speed": spoilt(U, 17, np.nan)}}, "speed: .*1 of 1000 rows with NaN.*index 17"),
        ({"t": spoilt(T, 5, 0.01)}, r"t: expected times that increase.*t\[5\] = 0.01 after t\[4\]"),
        ({"t": spoilt(T, 5, np.inf)}, "t: expected finite numbers"),
        ({"t": T[:, None]}, r"t: expected times of shape \(n,\)"),
        ({"t": 3.0}, r"t: expected times of shape \(n,\)"),
        ({"rig": "dc_moter"}, "did you mean 'dc_motor'"),
        ({"rig": None}, "rig: expected a rig kind"),
        ({"rig": 3}, "rig: expected a path, found 3"),
    ],
)
def test_arrays_that_are_no_recording_are_refused_with_the_reason(changes, said):
    with pytest.raises(UsageError, match=said):
        motor(**changes)


@pytest.mark.extended
def test_arrays_become_a_recording_that_is_saved_and_read_again(tmp_path):
    rec = motor(t=T + 100.0, others={"winding_temperature": 20.0 + 0.0 * T})
    assert rec["speed"] == pytest.approx(SPEED)
    assert rec.t == pytest.approx(T)
    assert list(rec.signals) == ["voltage", "speed", "winding_temperature"]
    with pytest.raises(ValueError, match="read-only"):
        rec["speed"][0] = 1.0
    again = lh.read(rec.save(tmp_path / "it.mcap"))
    assert again == rec
    assert again["voltage"] == pytest.approx(U)
    assert again.model.kind == "dc_motor"
    with pytest.raises(UsageError, match="expected a new file"):
        rec.save(tmp_path / "it.mcap")
    with pytest.raises(UsageError, match=r"ends in \.mcap"):
        rec.save(tmp_path / "it.csv")


def test_units_that_cannot_be_are_doubted():
    assert lh.read(IDENTIFY).doubts == ()
    table = lh.read(IDENTIFY)
    in_mm = lh.recording(
        table.t, {"servo_angle": table["servo_angle"]}, {"ball_position": 1e3 * table["ball_position"]},
        rig=table.model,
    )  # fmt: skip
    assert any("ball_position" in doubt for doubt in in_mm.doubts)


def test_six_joints_are_one_signal():
    q = np.sin(T)[:, None] * np.ones(6)
    rec = lh.recording(T, {"actual_q": q, "actual_qd": q}, {"actual_current": q}, rig="ur5")
    assert rec["actual_q"].shape == (1000, 6)
    assert rec.plot("actual_q").get_ylabel() == "actual_q, rad"


def test_a_table_is_read_with_a_rig_and_says_how(tmp_path):
    table = tmp_path / "bench.csv"
    rows = "\n".join(f"{t:.3f},{u:g},{0.001 * i:g}" for i, (t, u) in enumerate(zip(T, U, strict=True)))
    table.write_text(f"t,voltage,speed\n{rows}\n")
    rec = lh.read(table, rig="dc_motor")
    assert rec["voltage"] == pytest.approx(U)
    assert any("1000 of 1000 rows" in note for note in rec.notes)
    with pytest.raises(UsageError, match="a table needs a rig"):
        lh.read(table)
    with pytest.raises(lh.errors.TableError, match="an output is missing"):
        table.write_text("t,voltage\n0,1\n1,2\n2,3\n")
        lh.read(table, rig="dc_motor")


def test_files_that_are_not_there_or_are_none_are_named():
    for path, kind in (("nowhere.mcap", RecordingError), ("nowhere", RecordingError)):
        with pytest.raises(kind, match=r"nowhere.*cannot be read"):
            lh.read(path)
    with pytest.raises(UsageError, match=r"nowhere\.csv"):
        lh.read("nowhere.csv", rig="dc_motor")
    with pytest.raises(UsageError, match="path: expected a path, found 3"):
        lh.read(3)
    with pytest.raises(RecordingError, match="did you mean 'ball_position'"):
        lh.read(IDENTIFY)["ball_positon"]


@pytest.mark.parametrize(
    ("options", "kind", "said"),
    [
        ({"terms": ["coulomb_frictoin"]}, UnknownNameError, "did you mean 'coulomb_friction'"),
        ({"terms": [3]}, UsageError, "terms: expected names"),
        ({"terms": []}, UsageError, "terms: expected one at least"),
        ({"terms": 3}, UsageError, "terms: expected names, found 3"),
        ({"estimator": "gradient"}, UnknownNameError, "gradient"),
        ({"intervals": "exact"}, UnknownNameError, "exact"),
        ({"criterion": "all"}, UnknownNameError, "all"),
        ({"holdout": 2.0}, UsageError, "holdout"),
        ({"span": (100, 200)}, UsageError, "span"),
        ({"window": 1e-9}, UsageError, "window"),
        ({"seconds": -1.0}, UsageError, "seconds"),
        ({"model": "ball_beem"}, UsageError, "did you mean 'ball_beam'"),
        ({"model": "dc_motor"}, RecordingError, "a dc_motor needs"),
        ({"start": "nowhere.json"}, lh.errors.ModelFileError, "nowhere.json"),
        ({"start": 3}, UsageError, "start: expected a path, found 3"),
        ({"test": IDENTIFY.with_name("nowhere.mcap")}, RecordingError, "nowhere.mcap"),
        ({"device": "arm"}, RecordingError, "arm"),
        ({"holdout": "most"}, UsageError, "holdout: expected a number, found 'most'"),
        ({"span": 5.0}, UsageError, "span: expected two times"),
        ({"span": ("a", "b")}, UsageError, "span: expected a number, found 'a'"),
        ({"seconds": "soon"}, UsageError, "seconds: expected a number"),
        ({"window": "1 s"}, UsageError, "window: expected a number"),
        ({"seed": 1.5}, UsageError, "seed: expected a whole number"),
        ({"test": 3}, UsageError, "test: expected a recording"),
        ({"model": 3}, UsageError, "rig: expected a path, found 3"),
    ],
)
def test_a_fit_that_cannot_be_made_is_refused_with_the_reason(options, kind, said):
    with pytest.raises(kind, match=said):
        lh.fit(IDENTIFY, **options)


def test_what_is_no_recording_is_refused_with_what_makes_one():
    with pytest.raises(UsageError, match=r"labhil\.recording\(t, inputs, outputs"):
        lh.fit(np.zeros(3))
    with pytest.raises(UsageError, match="an empty list"):
        lh.diagnose([])
    with pytest.raises(UsageError, match="expected a fit or a diagnosis"):
        lh.verify(IDENTIFY, None)
    with pytest.raises(UsageError, match="alpha: expected a number"):
        lh.verify(IDENTIFY, ROOT / "examples" / "fit.json", alpha="small")
    with pytest.raises(UsageError, match="expected one recording, found 2"):
        lh.verify([IDENTIFY, IDENTIFY], ROOT / "examples" / "fit.json")


def test_what_is_known_of_a_rig_is_checked_by_name_and_value(tmp_path):
    model = lh.model("ball_beam", known={"ball_mass": np.float64(0.261)}, horizon=3.0)
    assert model.known == {"ball_mass": 0.261}
    assert model == lh.model(model)
    assert lh.model(lh.read(IDENTIFY), known={"ball_mass": 0.3}).known["beam_length"] == 0.4
    arm = lh.model("ur5", known={"torque_constant": np.arange(1.0, 7.0)})
    assert arm.known["torque_constant"] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    for known, said in (
        ({"ball_mas": 0.2}, "did you mean 'ball_mass'"),
        ({"ball_mass": -1.0}, "ball_mass must be a positive number"),
        ({"ball_mass": "heavy"}, "ball_mass must be a positive number"),
    ):
        with pytest.raises(RigFileError, match=said):
            lh.model("ball_beam", known=known)
    rig = tmp_path / "bench.toml"
    rig.write_text('[rig]\nkind = "ball_beam"\n')
    assert lh.model(rig).kind == "ball_beam"
    with pytest.raises(UsageError, match="neither"):
        lh.model(tmp_path / "nowhere.toml")


def test_the_catalogue_prints_as_a_table_and_knows_close_names():
    terms = lh.model("ball_beam").terms
    assert "stribeck_friction" in repr(terms)
    assert "<pre" in terms._repr_html_()
    assert terms["dead_zone"].parameters[0].unit == "rad"
    with pytest.raises(UnknownNameError, match="did you mean 'backlash'"):
        terms["backlsh"]


@pytest.mark.extended
def test_progress_is_told_to_a_function_and_work_ends_early_with_the_best_so_far():
    told: list[str] = []
    fit = lh.fit(IDENTIFY, span=(0, 12), estimator="nlse", terms="viscous_friction", progress=told.append)
    assert told
    assert fit.complete
    short = lh.diagnose(IDENTIFY, seconds=0.5)
    assert not short.complete
    assert short.ended == "0.5 s are over"
    assert str(short).startswith("ENDED EARLY")


@pytest.mark.extended
def test_no_terms_are_no_terms_and_not_the_usual_ones():
    bare = lh.diagnose(IDENTIFY, baseline=[], span=(0, 10), seconds=10)
    assert bare.baseline.terms == ()
    assert "Baseline: no terms;" in str(bare)
    assert lh.fit(motor(), terms=[], estimator="nlse", window=0.5).terms == ()


def test_several_recordings_are_fitted_together():
    both = [IDENTIFY, lh.read(IDENTIFY.with_name("ball_beam_test.mcap"))]
    fit = lh.fit(both, terms=["viscous_friction", "constant_force"], span=(0, 10), estimator="nlse",
                 per_recording=["constant_force"])  # fmt: skip
    assert "constant_force.force@2" in fit.parameters.keys()  # noqa: SIM118
    assert len(fit.train.per_recording) == 2
    with pytest.raises(RecordingError, match="the same recording"):
        lh.fit([IDENTIFY, lh.read(IDENTIFY)])


def test_all_errors_are_of_one_tree():
    assert issubclass(lh.errors.RecordingError, LabhilError)
