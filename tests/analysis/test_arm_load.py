"""Changed inertial parameters of an arm are stated as a payload, in kg."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.diagnose.accepted import Accepted
from labhil.diagnose.diagnosis import diagnose
from labhil.identify.fit import Options, fit
from labhil.identify.intervals import Intervals
from labhil.physics.arm import ArmModel
from labhil.physics.arm.controller_constants import controller_constants
from labhil.physics.arm.grouped import group_parameters
from labhil.physics.arm.links import PER_LINK, inertial_of, load_links
from labhil.physics.arm.rigid_body import gravity_in_base, regressor
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.rig import parse_rig
from labhil_benchmarks.statistics import arm

MASS, CENTRE = 2.2, (0.02, -0.03, 0.08)
FRICTION = ("viscous_friction", "coulomb_friction", "sensor_offset")
LINKS = "".join(
    f"[[joint]]\nd = {d}\na = {a}\nalpha = {alpha}\n"
    for d, a, alpha in (
        (0.089159, 0.0, np.pi / 2.0),
        (0.0, -0.425, 0.0),
        (0.0, -0.39225, 0.0),
        (0.10915, 0.0, np.pi / 2.0),
        (0.09465, 0.0, -np.pi / 2.0),
        (0.0823, 0.0, 0.0),
    )
)


def acquired(seed: int, mass: float) -> Record:
    """The benchmark's arm with this load, noise on its currents, and what its controller planned."""
    random = np.random.default_rng(seed)
    loaded = {"payload.mass": mass, **{f"payload.centre_{a}": c for a, c in zip("xyz", CENTRE, strict=True)}}
    terms = (*FRICTION, "payload") if mass else FRICTION
    seen = arm.follow(terms, {**arm.SILENT, **(loaded if mass else {})}, seed)
    return replace(seen, outputs=seen.outputs + arm.noise(len(seen), False, random))


def model_of(record: Record, folder: Path) -> ArmModel:
    (folder / "links.toml").write_text(LINKS)
    rig = parse_rig(f'{arm.RIG}links = "links.toml"\n', folder / "ur5.toml")
    model = model_for(rig, record)
    assert isinstance(model, ArmModel)
    return model


def planned(record: Record, constants: list[float], friction: float) -> Record:
    """The record with a controller's planned torques, and currents that follow from constants of its own."""
    random = np.random.default_rng(1)
    added = {}
    for joint, constant in enumerate(constants):
        v = record.inputs[:, 6 + joint]
        torque = 20.0 * np.sin(3.0 * record.inputs[:, joint]) + random.normal(0.0, 5.0, len(record))
        rub = friction * (3.0 * np.sign(v) + 9.0 * v - 4.0 * v * np.abs(v))
        added[f"target_moment_{joint}"] = torque
        added[f"target_current_{joint}"] = (torque + rub) / constant + 0.01
    return replace(record, auxiliary={**record.auxiliary, **added})


def test_constants_follow_from_what_the_controller_plans_whatever_friction_it_adds() -> None:
    record = acquired(1, 0.0)
    constants = [11.95, 11.98, 9.84, 10.75, 10.73, 10.67]
    found = controller_constants(planned(record, constants, 1.0))
    assert found is not None
    np.testing.assert_allclose(found.value, constants, rtol=1e-3)
    assert found.relative_error < 1e-2
    assert controller_constants(record) is None


def test_a_payload_adds_the_point_mass_to_the_grouped_parameters(tmp_path: Path) -> None:
    (tmp_path / "links.toml").write_text(LINKS)
    links = load_links(tmp_path / "links.toml")
    random = np.random.default_rng(7)
    q, qd, qdd = random.uniform(-3.0, 3.0, (3, 40, 6))
    columns = regressor(links, q, qd, qdd, gravity_in_base())
    own = group_parameters(links)
    point = inertial_of(MASS, CENTRE)
    as_load = columns[:, :, -PER_LINK:] @ point
    as_sizes = columns[:, :, list(own.kept)] @ (own.shares[:, -PER_LINK:] @ point)
    np.testing.assert_allclose(as_sizes, as_load, atol=1e-8)


@pytest.mark.extended
@pytest.mark.parametrize("mass", [MASS, 0.0])
def test_changed_inertia_is_stated_as_the_payload_that_explains_it(mass: float, tmp_path: Path) -> None:
    empty = acquired(3, 0.0)
    model = model_of(empty, tmp_path)
    options = Options(intervals=Intervals.WALD)
    known = fit(model, model.prepare(empty), FRICTION, options=options)
    keys = tuple(row.key for row in known.estimates)
    values = {row.key: row.value for row in known.estimates}
    accepted = Accepted("empty", "ur5", known.terms, values, keys, known.covariance)
    record, test = acquired(4, mass), acquired(5, mass)
    here = model_of(record, tmp_path)
    found = diagnose(
        here,
        here.prepare(record),
        here.prepare(test),
        heldout_is_test=True,
        baseline=FRICTION,
        reference=values,
        accepted=accepted,
    )
    names = [missing.term for missing in found.missing]
    if not mass:
        assert found.verdict == "no_mismatch", (names, found.changed)
        return
    assert names == ["payload"]
    assert not [change for change in found.changed if change.name.startswith("grouped")]
    told = {row.name: row for row in found.missing[0].parameters}
    low, high = told["payload.mass"].ci99
    assert low < MASS < high
    assert high - low < 0.15 * MASS
    assert found.after.rmse < 1.2 * found.after.noise_floor
    assert found.before.rmse > 3.0 * found.after.rmse
