"""A ball on a beam of which the rig file says little: the same motion, from fewer parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labhil.identify.fitted import start_theta
from labhil.identify.windows import fit_windows
from labhil.physics.ball_beam import SOLID_BALL_ACCELERATION, BallBeamModel
from labhil.physics.record import Record
from labhil.rig import parse_rig

SIZES = {"ball_mass": 0.261, "ball_radius": 0.02, "crank_radius": 0.08, "beam_length": 0.40}
RATIO = SIZES["crank_radius"] / SIZES["beam_length"]
MASS = 1.4 * SIZES["ball_mass"]
"""Effective mass of a solid ball that rolls, kg."""

FORCES = {
    "viscous_friction.coefficient": 0.26,
    "coulomb_friction.level": 0.09,
    "stribeck_friction.level": 0.06,
    "spring_force.stiffness": 0.2,
}
OTHERS = {"stribeck_friction.velocity": 0.02, "dead_zone.left": 0.06, "dead_zone.right": 0.08}


def turning(name: str = "servo_angle") -> Record:
    t = np.arange(0.0, 6.0, 0.01)
    angle = 0.7 * np.sin(2.0 * np.pi * 0.4 * t) + 0.3 * np.sin(2.0 * np.pi * 1.7 * t)
    return Record(t, angle[:, None], np.zeros((len(t), 1)), (name,), ("ball_position",), ("m",))


def simulated(known: list[str], values: dict[str, float]) -> np.ndarray:
    lines = "\n".join(f"{name} = {SIZES[name]}" for name in known)
    record = turning()
    model = BallBeamModel(
        parse_rig(f'[rig]\nkind = "ball_beam"\n[known]\n{lines}\n', Path("rig.toml")), record
    )
    windows = fit_windows(record, 1.0)
    states = np.tile([0.02, 0.1], (len(windows.first), 1))
    return model.simulate(start_theta(model, values), record, windows, states)


@pytest.mark.parametrize(
    ("known", "values"),
    [
        (
            [],
            {"acceleration_per_radian": SOLID_BALL_ACCELERATION * RATIO, "ball_radius": SIZES["ball_radius"]},
        ),
        (["ball_radius"], {"acceleration_per_radian": SOLID_BALL_ACCELERATION * RATIO}),
        (
            ["crank_radius", "beam_length", "ball_radius"],
            {"acceleration_per_radian": SOLID_BALL_ACCELERATION},
        ),
        (
            ["ball_radius", "beam_length"],
            {"acceleration_per_radian": SOLID_BALL_ACCELERATION, "crank_radius": SIZES["crank_radius"]},
        ),
        (["ball_mass", "ball_radius"], {"linkage_ratio": RATIO}),
    ],
)
def test_what_is_not_known_is_estimated_and_the_motion_is_the_same(known, values):
    whole = simulated(list(SIZES), FORCES | OTHERS)
    mass = 1.0 if "ball_mass" in known else MASS
    forces = {name: value / mass for name, value in FORCES.items()}
    assert np.ptp(whole) > 0.05
    assert simulated(known, values | forces | OTHERS) == pytest.approx(whole, abs=1e-9)


def test_a_beam_whose_linkage_is_unknown_turns_less_than_its_servo():
    model = BallBeamModel(parse_rig('[rig]\nkind = "ball_beam"\n', Path("rig.toml")), turning())
    gain = next(p for p in model.parameters if p.key == "acceleration_per_radian")
    assert gain.upper == pytest.approx(SOLID_BALL_ACCELERATION)
    assert gain.starts[0] < 0.5 * SOLID_BALL_ACCELERATION


def test_a_ball_of_known_mass_on_an_unknown_linkage_has_one_ratio_and_not_two_lengths():
    rig = parse_rig('[rig]\nkind = "ball_beam"\n[known]\nball_mass = 0.1\n', Path("rig.toml"))
    own = {p.key for p in BallBeamModel(rig, turning()).parameters if p.term is None}
    assert own == {"linkage_ratio", "ball_radius"}


def test_an_angle_that_is_the_beams_own_needs_no_linkage():
    record = turning("beam_angle")
    model = BallBeamModel(parse_rig('[rig]\nkind = "ball_beam"\n', Path("rig.toml")), record)
    assert "acceleration_per_radian" in {p.key for p in model.parameters}
    assert not set(SIZES) & {p.key for p in model.parameters}
