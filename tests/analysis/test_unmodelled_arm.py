"""Nonparametric torques on the joints of an arm: joint, coordinate and size."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from labhil.analysis.results import diagnosis_json
from labhil.analysis.saved_curves import curves_json, with_saved_curves
from labhil.diagnose.adequacy import exceeds_noise, residual_rms
from labhil.diagnose.begin import fit_baseline, prepare_data
from labhil.diagnose.diagnosis import diagnose
from labhil.diagnose.force_curve import ForceCurve
from labhil.diagnose.joint_curves import fit_joint_curves
from labhil.diagnose.judge import Data
from labhil.diagnose.search_result import SearchResult
from labhil.errors import ModelFileError
from labhil.identify.fitted import Fitted, start_theta
from labhil.identify.saved_curve import ModelUnderCurves
from labhil.identify.score import score
from labhil.kinds import JOINTS
from labhil.physics.arm import ArmModel
from labhil.physics.extra_force import CurveArgument, ExtraForce
from labhil.physics.model import terms_named
from labhil.physics.record import Record, Windows
from labhil.report.figure import save
from labhil.report.plots import diagnosis_figure
from labhil.rig import parse_rig
from labhil.signals import FloatArray
from labhil_benchmarks.statistics import arm

pytestmark = pytest.mark.timeout(600)

RIG = parse_rig(arm.RIG, Path("ur5.toml"))
Law = Callable[[FloatArray], FloatArray]


def patch(q: FloatArray) -> FloatArray:
    """Level of dry friction, N·m."""
    return 0.8 * np.exp(-(((q - 0.4) / 0.15) ** 2))


def spring(q: FloatArray) -> FloatArray:
    """A torque along the positive direction, N·m."""
    return -0.8 * np.tanh((q - 1.2) / 0.4)


@cache
def plain(seed: int) -> Record:
    """What the plant reports that has nothing but the baseline's terms."""
    record = arm.follow(arm.TERMS, arm.SILENT, seed)
    noise = arm.noise(len(record), False, np.random.default_rng(seed))
    return replace(record, outputs=record.outputs + noise)


def pushed(record: Record, joint: int, torque: FloatArray) -> Record:
    """The same with a further torque (n,) on one joint, which its drive has to hold against."""
    outputs = record.outputs.copy()
    outputs[:, joint] -= torque / arm.CONSTANTS[joint]
    return replace(record, outputs=outputs)


def rubbed(record: Record, joint: int) -> Record:
    """With a sticky patch in a joint."""
    q, qd = record.inputs[:, joint], record.inputs[:, JOINTS + joint]
    return pushed(record, joint, -patch(q) * np.sign(qd))


def sprung(record: Record, joint: int) -> Record:
    """With a spring that gives in."""
    return pushed(record, joint, spring(record.inputs[:, joint]))


def searched(*records: Record) -> tuple[Data, Fitted]:
    """Torques beside the baseline, of a search without named terms."""
    model = ArmModel(RIG, records[0])
    data = prepare_data(model, *(model.prepare(record) for record in records))
    return data, fit_baseline(data, [term.key for term in terms_named(model, arm.TERMS)])


def curves_of(data: Data, base: Fitted) -> tuple[ForceCurve, ...]:
    return fit_joint_curves(data, SearchResult(base, base, (), (), 1.0, 1))


def within(found: ForceCurve, law: Law) -> float:
    """Share of the visited range where the law lies within the band, but for what is an offset of it."""
    truth = law(found.x)
    truth = truth + np.mean(found.value - truth)
    return float(np.mean((truth >= found.low) & (truth <= found.high)))


def excess(found: ForceCurve) -> float:
    """RMSE of its joint after, over the noise floor."""
    (channel,) = (c for c in found.after.channels if c.joint == found.joint)
    return channel.rmse / channel.noise_floor


@cache
def both() -> tuple[Data, tuple[ForceCurve, ...]]:
    """What is found of an arm with a patch in joint 5 and a spring at joint 2."""
    data, base = searched(*(sprung(rubbed(plain(seed), 5), 2) for seed in (1, 2)))
    assert exceeds_noise(data, residual_rms(data, base))
    return data, curves_of(data, base)


@pytest.mark.extended
def test_each_torque_is_found_on_its_joint_within_its_band() -> None:
    _, curves = both()
    found = {curve.joint: curve for curve in curves}
    assert set(found) == {2, 5}
    assert (found[5].depends_on, found[5].acts) == (
        ("actual_q_5", "actual_qd_5"),
        CurveArgument.POSITION_AGAINST,
    )
    assert (found[2].depends_on, found[2].acts) == (("actual_q_2",), CurveArgument.POSITION)
    assert within(found[5], patch) >= 0.9
    assert within(found[2], spring) >= 0.9
    for curve in curves:
        assert (curve.unit, curve.x_unit) == ("N·m", "rad")
        assert excess(curve) <= 1.1
        assert curve.share >= 0.9


def test_a_complete_model_has_no_torque() -> None:
    data, base = searched(plain(1), plain(2))
    assert not exceeds_noise(data, residual_rms(data, base))
    assert curves_of(data, base) == ()


@pytest.mark.extended
def test_curves_of_a_file_are_part_of_the_model(tmp_path: Path) -> None:
    """What fit, diagnose and verify simulate with ``--model`` is what the diagnosis found."""
    data, curves = both()
    assert isinstance(data.model, ArmModel)
    stated = curves_json(ModelUnderCurves(data.model, [curve.kept for curve in curves]))
    path = tmp_path / "d.json"
    whole = {"curve": stated[0], "further_curves": stated[1:]}
    path.write_text(json.dumps(whole, default=lambda values: values.tolist()))
    read = with_saved_curves(ArmModel(RIG, plain(1)), path)
    assert isinstance(read, ModelUnderCurves)
    assert [each["joint"] for each in curves_json(read)] == [curve.joint for curve in curves]
    theta = start_theta(read, {row.key: row.value for row in curves[-1].rows})
    after = score(read, theta, data.test, data.test_sigma)
    assert after.rmse == pytest.approx(curves[-1].after.rmse, rel=0.02)


@pytest.mark.extended
def test_a_diagnosis_states_the_torque(tmp_path: Path) -> None:
    """Term, joint, location and plot; named terms that only imitated it are gone."""
    records = [rubbed(plain(seed), 5) for seed in (1, 2)]
    model = ArmModel(RIG, records[0])
    search, test = (model.prepare(record) for record in records)
    found = diagnose(model, search, test, heldout_is_test=True, baseline=arm.TERMS, measured=records[0])
    assert [(item.term, item.joint) for item in found.missing] == [("unmodelled_force", 5)]
    assert found.verdict == "missing_physics"
    evidence = found.missing[0].evidence
    assert found.p_value == pytest.approx(np.exp(0.5 * evidence.delta_bic))
    assert found.p_value < 1e-6
    assert evidence.p_value < 1e-6  # of the gain on data that the search never saw
    assert found.location is not None
    assert (found.location.joint, found.location.enters) == (5, "force")
    assert {regime.coordinate for regime in found.location.regimes} == {"actual_q_5"}
    assert found.after.rmse <= 1.1
    stated = diagnosis_json(found, [])
    assert (stated["curve"]["joint"], stated["curve"]["depends_on"]) == (5, ["actual_q_5"])
    assert stated["further_curves"] == []
    save(diagnosis_figure(found), tmp_path / "d.png")
    assert (tmp_path / "d.png").stat().st_size > 0


@pytest.mark.parametrize("joint", [None, 6])
def test_a_curve_on_no_joint_of_the_arm_is_refused(joint: int | None, tmp_path: Path) -> None:
    path = tmp_path / "d.json"
    curve = {"depends_on": ["actual_q_1"], "acts": "position", "x": [[0.0, 1.0]], "value": [0.0, 1.0]}
    path.write_text(json.dumps({"curve": {**curve, "joint": joint}}))
    with pytest.raises(ModelFileError, match="expected one of 0, 1"):
        with_saved_curves(ArmModel(RIG), path)


@pytest.mark.parametrize(
    "acts",
    [
        CurveArgument.POSITION,
        CurveArgument.POSITION_AGAINST,
        CurveArgument.DAMPING,
        CurveArgument.SPEED_AGAINST,
    ],
)
def test_a_torque_acts_on_its_joint_alone_beside_those_before(acts: CurveArgument) -> None:
    record = plain(1)
    model = ArmModel(RIG, record)
    theta, windows, states = start_theta(model), Windows.of(record.spans), np.empty((1, 0))
    of = "actual_qd_4" if acts is CurveArgument.SPEED_AGAINST else "actual_q_4"
    force = ExtraForce(acts, np.linspace(-9.0, 9.0, 5), np.full(5, 0.3), 1.0, of=of, joint=4)
    once = model.with_force(force)
    base, one, two = (
        each.simulate(theta, record, windows, states) for each in (model, once, once.with_force(force))
    )
    qd = record.inputs[:, JOINTS + 4]
    along = {CurveArgument.POSITION: 1.0, CurveArgument.DAMPING: -qd}.get(acts, -np.sign(qd))
    expected = np.zeros_like(base)
    expected[:, 4] = -0.3 * along / arm.CONSTANTS[4]
    np.testing.assert_allclose(one - base, expected, atol=1e-12)
    np.testing.assert_allclose(two - one, expected, atol=1e-12)
