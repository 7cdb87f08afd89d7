"""A pendulum in a few lines of Python is a rig: the catalogue is there for it, and what breaks is named."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import labhil as lh
from labhil.errors import RecordingError, RigFileError, UsageError

sys.path.insert(0, str(Path(__file__).parent))
from bare_pendulum import pendulum
from pendulum_plant import GRAVITY, INERTIA, swung, torques

BENCH = """
import math
import labhil as lh

def swing(t, x, u, p):
    return x.rate, (u.torque - p.gravity_torque * math.sin(x.angle)) / p.inertia

pendulum = lh.simulator(
    swing,
    name="pendulum_of_a_file",
    states={"angle": "rad", "rate": "rad/s"},
    inputs={"torque": "N·m"},
    parameters={"inertia": lh.Quantity(0.02, "kg·m²"), "gravity_torque": lh.Quantity(0.5, "N·m")},
)
"""


def recorded(
    rig: lh.Simulator, *, seed: int, seconds: float, dry: float = 0.0, late: int = 0
) -> lh.Recording:
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.01)
    u = torques(t, random)
    angle = swung(t, u, dry=dry, late=late) + 1e-3 * random.standard_normal(len(t))
    return lh.recording(t, {"torque": u}, {"angle": angle}, rig=rig)


def test_a_pendulum_is_offered_the_catalogue() -> None:
    terms = lh.model(pendulum()).terms
    assert len(terms) >= 15
    for at_port in ("stribeck_friction", "cogging_torque", "added_inertia", "time_delay", "sensor_lag"):
        assert at_port in terms
    assert terms["coulomb_friction"].parameters[0].unit == "N·m"


@pytest.mark.extended
def test_a_fit_finds_the_plant_with_its_dry_friction() -> None:
    rig = pendulum()
    fit = lh.fit(
        recorded(rig, seed=5, seconds=12.0, dry=0.05), terms=["viscous_friction", "coulomb_friction"]
    )
    found = {each.name: each.value for each in fit.parameters}
    assert found["inertia"] == pytest.approx(INERTIA, rel=0.01)
    assert found["gravity_torque"] == pytest.approx(GRAVITY, rel=0.01)
    assert found["coulomb_friction.level"] == pytest.approx(0.05, rel=0.03)


@pytest.mark.extended
@pytest.mark.parametrize(
    ("concealed", "missing"),
    [({}, []), ({"dry": 0.06}, ["coulomb_friction"])],
)
def test_a_diagnosis_names_what_the_plant_conceals_and_nothing_else(
    concealed: dict[str, Any], missing: list[str]
) -> None:
    rig = pendulum()
    found = lh.diagnose(recorded(rig, seed=11, seconds=20.0, **concealed))
    assert [effect.term for effect in found.missing] == missing
    changed = {change.name: change.after for change in found.changed}
    assert changed == pytest.approx({"inertia": INERTIA, "gravity_torque": GRAVITY}, rel=0.01)


@pytest.mark.extended
def test_values_that_the_recording_bears_out_are_not_said_to_have_changed() -> None:
    right = {"inertia": lh.Quantity(INERTIA, "kg·m²"), "gravity_torque": lh.Quantity(GRAVITY, "N·m")}
    found = lh.diagnose(recorded(pendulum(parameters=right), seed=11, seconds=20.0))
    assert (found.verdict, found.changed) == ("no_mismatch", ())


@pytest.mark.extended
def test_a_motor_with_damping_of_its_own_is_known_to_lack_dry_friction() -> None:
    motor = lh.simulator(
        lambda t, x, u, p: (x.rate, (p.gain * u.voltage - p.drag * x.rate) / p.inertia),
        name="motor_of_a_test",
        states={"angle": "rad", "rate": "rad/s"},
        inputs={"voltage": "V"},
        outputs=["rate"],
        parameters={
            "gain": lh.Quantity(0.05, "N·m/V"),
            "drag": lh.Quantity(1e-3, "N·m·s/rad"),
            "inertia": lh.Quantity(1e-3, "kg·m²"),
        },
        coordinates={"angle": lh.Coordinate("rate", inertia="inertia", force="N·m")},
    )
    t = np.arange(0.0, 12.0, 0.01)
    voltage = 4 * np.sin(2 * t) + 3 * np.sin(5.1 * t + 1) + 2 * np.sin(11 * t)
    noise = 0.05 * np.random.default_rng(4).standard_normal(len(t))
    recording = lh.recording(t, {"voltage": voltage}, {"rate": turned(voltage) + noise}, rig=motor)
    found = lh.diagnose(recording, lh.model(motor, known={"inertia": 1.2e-3}))
    assert [effect.term for effect in found.missing] == ["coulomb_friction"]
    assert "viscous_friction" not in str(found.baseline)


@pytest.mark.extended
def test_a_delay_is_named_and_nothing_else() -> None:
    found = lh.diagnose(recorded(pendulum(), seed=11, seconds=20.0, late=5))
    assert [effect.term for effect in found.missing] == ["time_delay"]


def turned(voltage: np.ndarray) -> np.ndarray:
    """Speeds (n,) at 100 Hz of a motor with 0.05 N·m of dry friction, in small steps with rests."""
    rate, rates = 0.0, []
    for torque in 0.06 * voltage:
        rates.append(rate)
        for _ in range(100):
            side = np.sign(rate or torque)
            after = rate + 1e-4 * (torque - 2e-3 * rate - side * 0.05) / 1.2e-3
            rate = 0.0 if after * rate < 0.0 or (rate == 0.0 and abs(torque) <= 0.05) else after
    return np.array(rates)


@pytest.mark.extended
def test_a_parameter_that_never_reaches_the_simulation_is_said_so() -> None:
    rig = pendulum(
        name="pendulum_with_a_dead_value",
        parameters={
            "inertia": lh.Quantity(0.02, "kg·m²"),
            "gravity_torque": lh.Quantity(0.5, "N·m"),
            "bearing_width": lh.Quantity(0.01, "m"),
        },
    )
    fit = lh.fit(recorded(rig, seed=5, seconds=6.0), terms=["viscous_friction"])
    assert "bearing_width" in str(fit)
    assert "never reached the simulation" in str(fit)
    assert "bearing_width" not in [each.name for each in fit.parameters]


def diverging(t: float, x: Any, u: Any, p: Any) -> Any:
    return x.rate, math.log(x.angle) if x.angle > 0 else float("nan")


def three(t: float, x: Any, u: Any, p: Any) -> Any:
    return x.rate, 0.0, 0.0


def raising(t: float, x: Any, u: Any, p: Any) -> Any:
    raise RuntimeError("no licence")


def swapped(t: float, x: Any, u: Any, p: Any) -> Any:
    return u.torque / p.inertia, x.rate


def timed(t: float, x: Any, u: Any, p: Any) -> Any:
    return x.rate, u.torque + t


class Remembering:
    """A simulator that goes on from where it was left."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, t: float, x: Any, u: Any, p: Any) -> Any:
        self.calls += 1
        return x.rate, float(self.calls)


@pytest.mark.parametrize(
    ("f", "said"),
    [
        (diverging, "expected finite rates"),
        (three, "expected 2 rates"),
        (raising, "RuntimeError: no licence"),
        (swapped, "expected the rate of angle to be rate"),
        (timed, "do not depend on t"),
        (Remembering(), "the same rates for the same state"),
    ],
)
def test_what_breaks_is_named_with_what_was_expected(f: Callable[..., Any], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        pendulum(f)


def test_names_are_checked() -> None:
    with pytest.raises(UsageError, match="did you mean"):
        pendulum(outputs=["angel"])
    with pytest.raises(UsageError, match="inertia"):
        pendulum(coordinates={"angle": lh.Coordinate("rate", inertia="inertja")})
    with pytest.raises(UsageError, match=r"an inertia above 0, .* found a start of -0\.02"):
        pendulum(
            coordinates={"angle": lh.Coordinate("rate", inertia="inertia", force="N·m")},
            parameters={"inertia": lh.Quantity(-0.02, "kg·m²"), "gravity_torque": 0.5},
        )
    with pytest.raises(UsageError, match="found that of a rig kind"):
        pendulum(name="ball_beam")
    with pytest.raises(UsageError, match="2 states"):
        pendulum(states={"angle": "rad"})


def test_a_rig_file_names_a_python_file(tmp_path: Path) -> None:
    (tmp_path / "bench.py").write_text(BENCH, encoding="utf-8")
    rig = tmp_path / "rig.toml"
    rig.write_text('[model]\npython = "bench.py:pendulum"\n[known]\ninertia = 0.03\n', encoding="utf-8")
    model = lh.model(rig)
    assert model.kind == "pendulum_of_a_file"
    assert model.known == {"inertia": 0.03}
    rig.write_text('[model]\npython = "bench.py:pendulun"\n', encoding="utf-8")
    with pytest.raises(RigFileError, match="has no 'pendulun'"):
        lh.model(rig)
    rig.write_text('[model]\npython = "bank.py:pendulum"\n', encoding="utf-8")
    with pytest.raises(RigFileError, match="expected the Python file"):
        lh.model(rig)


@pytest.mark.extended
def test_code_that_came_with_a_recording_is_not_run(tmp_path: Path) -> None:
    count = f"from pathlib import Path\nran = Path({str(tmp_path / 'ran')!r})\n"
    count += "ran.write_text(ran.read_text() + 'x' if ran.exists() else 'x')\n"
    (tmp_path / "bench.py").write_text(BENCH + count, encoding="utf-8")
    rig = tmp_path / "rig.toml"
    rig.write_text('[model]\npython = "bench.py:pendulum"\n', encoding="utf-8")
    model = lh.model(rig)
    t = np.arange(0.0, 4.0, 0.01)
    lh.recording(t, {"torque": np.sin(t)}, {"angle": np.sin(t)}, rig=model).save(tmp_path / "run.mcap")
    runs = (tmp_path / "ran").read_text(encoding="utf-8")
    read = lh.read(tmp_path / "run.mcap")
    with pytest.raises(RecordingError, match="--rig"):
        lh.fit(read)
    assert (tmp_path / "ran").read_text(encoding="utf-8") == runs
