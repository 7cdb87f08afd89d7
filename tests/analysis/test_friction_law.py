"""Friction laws of one's own: the same numbers as labhil's own laws, and as another library's integrator."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from math import sin
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import labhil as lh
from labhil.errors import UsageError
from labhil.physics.arm import ArmModel
from labhil.physics.friction_law import BUILT_IN, laws
from labhil.physics.model import Model, index_of, start_values
from labhil.physics.record import Record, Windows
from labhil.physics.rigs import model_for
from labhil.rig import parse_rig
from labhil.signals import Hold
from labhil_benchmarks.statistics.cases import BALL_BEAM_RIG, BALL_BEAM_TRUTH, held_ball

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import replay, rig_of, staircase, two_tones
from test_arm_model import EXACT, KNOWN, acquired, simulated
from test_arm_model import rig as arm_rig

WORDS = {"statement": "a law of this test", "equation": "F = c·g(|v|)", "source": "this test"}
FLAT = lh.FrictionLaw("flat_friction", np.ones_like, unit="{force}", **WORDS)
STRAIGHT = lh.FrictionLaw("straight_friction", lambda v: v, unit="{force}·s/{length}", **WORDS)
ROOT = lh.FrictionLaw("sqrt_friction", np.sqrt, unit="{force}·√s/√{length}", **WORDS)
POWER = lh.FrictionLaw(
    "power_friction",
    lambda v, exponent: v**exponent,
    unit="{force}",
    shape={"exponent": lh.Quantity(0.5, "1", 0.1, 3.0)},
    **WORDS,
)

BALL_TERMS = ("viscous_friction", "coulomb_friction")


@pytest.fixture(autouse=True)
def added() -> Iterator[None]:
    for law in (FLAT, STRAIGHT, ROOT, POWER):
        lh.add_law(law)
    yield
    for law in (FLAT, STRAIGHT, ROOT, POWER):
        lh.remove_law(law.name)


def moved(kind: str) -> tuple[Model, Record, float]:
    """A model with a recording of its plant, and a dry friction of its size."""
    if kind == "axis":
        made = replay(kind, staircase(4.0, 0.01, 0.4, 60.0), ("coulomb_friction",))
        return made.model, made.record, 8.0
    if kind == "dc_motor":
        made = replay(kind, staircase(8.0, 0.01, 0.8, 8.0), ("coulomb_friction",))
        return made.model, made.record, 0.3 * made.theta[index_of(made.model.parameters)["torque_constant"]]
    if kind == "solenoid":
        made = replay(kind, two_tones(2.0), ("coulomb_friction",), period=1e-3)
        return made.model, made.record, 0.4
    if kind == "ball_beam":
        truth = {k: v for k, v in BALL_BEAM_TRUTH.items() if k.partition(".")[0] in BALL_TERMS}
        record = held_ball(BALL_TERMS, truth, np.zeros(800), 1.0)
        return model_for(parse_rig(BALL_BEAM_RIG, Path("rig.toml")), record), record, 0.02
    t = 0.01 * np.arange(800)
    swing = 0.6 * np.sin(2.0 * t) + 0.2 * np.sin(5.0 * t)
    torque = 0.8 * np.sin(2.0 * t + 0.4)
    record = Record(t, torque[:, None], swing[:, None], ("torque",), ("angle",), ("rad",), (Hold.ZERO,))
    return model_for(pendulum().rig_file, record), record, 0.05


def pendulum() -> lh.Simulator:
    return lh.simulator(
        lambda t, x, u, p: (x.rate, (u.torque - p.gravity_torque * sin(x.angle)) / p.inertia),
        name="own_pendulum",
        states={"angle": "rad", "rate": "rad/s"},
        inputs={"torque": "N·m"},
        parameters={
            "inertia": lh.Quantity(0.05, "kg·m²"),
            "gravity_torque": lh.Quantity(0.5, "N·m"),
        },
    )


@pytest.mark.extended
@pytest.mark.parametrize("kind", ["axis", "dc_motor", "solenoid", "ball_beam", "own_pendulum"])
def test_a_law_of_ones_own_does_what_the_same_law_of_labhil_does(kind: str) -> None:
    """Through stick and slip: levels that are constant, and friction in proportion to velocity."""
    model, record, level = moved(kind)
    places, n = index_of(model.parameters), len(record)
    windows = Windows.of([(k, min(k + n // 3, n)) for k in (0, n // 3, n // 2)])
    states = model.initial_states(record, windows)
    for own, labhils in (
        ("flat_friction.coefficient", "coulomb_friction.level"),
        ("straight_friction.coefficient", "viscous_friction.coefficient"),
    ):
        simulated, forces = [], []
        for name in (own, labhils):
            theta = start_values(model.parameters)
            theta[places["viscous_friction.coefficient"]] = 0.3 * level
            theta[places[name]] += level
            simulated.append(model.simulate(theta, record, windows, states))
            along = model.coordinates(theta, record, windows, states)
            forces.append(model.generalised_force(theta, along))
        size = np.abs(simulated[1]).max(axis=0)
        assert np.abs(simulated[0] - simulated[1]).max(axis=0) == pytest.approx(0.0, abs=2e-4 * size.max())
        moving = np.sign(forces[1]) != 0.0
        assert np.median(np.abs(forces[0] - forces[1])[moving]) <= 1e-3 * np.abs(forces[1]).max()


@pytest.mark.extended
@pytest.mark.parametrize("exponent", [None, 1.4])
def test_a_law_that_nobody_compiled_is_simulated_as_scipy_integrates_it(exponent: float | None) -> None:
    """m·v̇ = u − c·|v|ⁿ·sgn v from rest, through a reversal; n is ½, or a shape of the law."""
    t = 0.002 * np.arange(1500)
    u = np.where(t < 1.2, 50.0, -35.0)
    record = Record(t, u[:, None], t[:, None], ("drive_force",), ("position",), ("m",), (Hold.ZERO,))
    model = model_for(rig_of("axis", "moving_mass = 20.0"), record)
    theta, places = start_values(model.parameters), index_of(model.parameters)
    theta[places["sqrt_friction.coefficient" if exponent is None else "power_friction.coefficient"]] = 30.0
    if exponent is not None:
        theta[places["power_friction.exponent"]] = exponent
    power = 0.5 if exponent is None else exponent

    def rates(_: float, y: np.ndarray, drive: float) -> tuple[float, float]:
        return y[1], (drive - 30.0 * np.sign(y[1]) * abs(y[1]) ** power) / 20.0

    states, ends = np.zeros((1, 2)), [0.0, 0.0]
    truth = np.empty((len(t), 2))
    for drive, first, last in ((50.0, 0, 600), (-35.0, 600, len(t) - 1)):
        solved = solve_ivp(
            rates,
            (t[first], t[last]),
            ends,
            "LSODA",
            t[first : last + 1],
            args=(drive,),
            rtol=1e-9,
            atol=1e-12,
        )
        truth[first : last + 1], ends = solved.y.T, solved.y[:, -1]
    windows = Windows.of([(0, len(t))])
    along = model.coordinates(theta, record, windows, states)
    assert np.abs(along["position"] - truth[:, 0]).max() < 2e-4 * np.abs(truth[:, 0]).max()
    assert np.abs(along["axis_velocity"] - truth[:, 1]).max() < 1e-3 * np.abs(truth[:, 1]).max()


@pytest.mark.extended
def test_a_joint_of_an_arm_takes_it_as_its_own_dry_friction() -> None:
    record = acquired(("coulomb_friction",), EXACT, seconds=6.0)
    model = ArmModel(arm_rig(KNOWN), record)
    record, places = model.prepare(record), index_of(model.parameters)
    currents, slopes = [], []
    for key in ("flat_friction.coefficient[2]", "coulomb_friction.level[2]"):
        theta = start_values(model.parameters)
        theta[places[key]] = 3.0
        currents.append(simulated(model, theta, record))
        slopes.append(model.regressor(theta, record, [key]))
    assert currents[0] == pytest.approx(currents[1], abs=1e-12)
    assert slopes[0] == pytest.approx(slopes[1], abs=1e-12)
    assert {f"sqrt_friction[{joint}]" for joint in range(6)} <= model.terms.keys()


@pytest.mark.extended
def test_what_the_simulator_has_itself_is_not_offered_again() -> None:
    damped = lh.simulator(
        lambda t, x, u, p: (x.rate, (u.torque - p.drag * x.rate) / p.inertia),
        name="damped_wheel",
        states={"angle": "rad", "rate": "rad/s"},
        inputs={"torque": "N·m"},
        parameters={"inertia": lh.Quantity(0.05, "kg·m²"), "drag": lh.Quantity(0.1, "N·m·s/rad")},
    )
    t = 0.01 * np.arange(800)
    turned = 0.6 * np.sin(2.0 * t)
    record = Record(
        t, 0.3 * np.cos(2.0 * t)[:, None], turned[:, None], ("torque",), ("angle",), ("rad",), (Hold.ZERO,)
    )
    model = model_for(damped.rig_file, record)
    assert "straight_friction" in model.unobservable_terms
    assert "sqrt_friction" in model.terms


def test_every_term_of_that_form_that_labhil_has_is_refused_as_a_name() -> None:
    added = {law.name for law in laws()}
    kinds = ("ball_beam", "dc_motor", "solenoid", "axis", "ur5")
    names = {name for kind in kinds for name in lh.model(kind).terms if name.endswith("_friction")}
    assert names - added == BUILT_IN


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"name": "sqrt"}, "ends in _friction"),
        ({"name": "coulomb_friction"}, "not one of labhil's own"),
        ({"unit": "{mass}"}, "expected a text with {force} and {length}"),
        ({"g": lambda v: 1.0 / v}, "a finite number for each of .* found some that are none"),
        ({"g": lambda v, w: v * w}, "expected g to take speeds (n,), found that it raises TypeError"),
        ({"g": lambda v: v[:3]}, "found the shape (3,)"),
        ({"shape": {"a": lh.Quantity(1.0), "b": lh.Quantity(1.0)}}, "one parameter at most, found a, b"),
    ],
)
def test_a_law_that_is_none_is_refused_with_what_was_expected(
    changes: dict[str, object], expected: str
) -> None:
    stated: dict[str, object] = {"name": "own_friction", "g": np.sqrt, "unit": "{force}", **WORDS, **changes}
    with pytest.raises(UsageError, match=expected if ".*" in expected else re.escape(expected)):
        lh.FrictionLaw(**stated)  # type: ignore[arg-type]


def test_a_package_offers_its_laws_on_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "rubbing.py").write_text(
        "import labhil as lh, numpy as np\n"
        "root = lh.FrictionLaw('root_friction', np.sqrt, unit='{force}·√s/√{length}',\n"
        "    statement='friction of a test', equation='F = c·√|v|·sgn v', source='a test')\n"
        "nothing = 3\n"
    )
    info = tmp_path / "rubbing-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: rubbing\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[labhil.terms]\nroot = rubbing:root\n")
    command = [sys.executable, "-m", "labhil", "terms", "axis"]

    def ask() -> subprocess.CompletedProcess[str]:
        environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(tmp_path), "COLUMNS": "200"}
        return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)

    offered = ask()
    assert offered.returncode == 0, offered.stderr
    assert "root_friction (force): friction of a test" in offered.stdout
    assert "a test (rubbing:root)" in offered.stdout
    (info / "entry_points.txt").write_text("[labhil.terms]\nroot = rubbing:nothing\n")
    refused = ask()
    assert refused.returncode == 2
    assert "rubbing:root" in refused.stderr and "expected a labhil.FrictionLaw, found int" in refused.stderr
