"""A Python function that simulates a whole input is a rig."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import labhil as lh
from labhil.errors import UsageError
from labhil.physics.model import index_of, start_values
from labhil.physics.record import Windows
from labhil.physics.rigs import model_for, record_of
from labhil.simulators.model import SimulatorModel

sys.path.insert(0, str(Path(__file__).parent))
from pendulum_file import bench, recorded


def simulate(p: Any, t: Any, u: Any, x0: Any) -> Any:
    """In steps of 0.2 ms at most, to even fractions of each stretch; nothing that a compiler knows."""
    angle, rate = x0.angle, x0.rate
    motion = [(angle, rate)]
    for torque, length in zip(u.torque, np.diff(t), strict=False):
        parts = max(1, round(length / 2e-4))
        for _ in range(parts):
            rate += length / parts * (torque - p.gravity * np.sin(angle)) / p.inertia
            angle += length / parts * rate
        motion.append((angle, rate))
    return motion


def coarse(p: Any, t: Any, u: Any, x0: Any) -> Any:
    """In steps of 0.5 ms of its own, whatever is asked: between them it rests."""
    own = np.arange(0.0, t[-1] + 1e-9, 5e-4)
    drive = np.asarray(u.torque)[np.searchsorted(t, own, side="right") - 1]
    inner = type(u)(drive)
    motion = np.array(simulate(p, own, inner, x0))
    return motion[np.searchsorted(own, t + 1e-9, side="right") - 1]


def rolled(f: Callable[..., Any] = simulate, **changes: Any) -> lh.Simulator:
    given: dict[str, Any] = {
        "kind": "rollout",
        "name": "rolled",
        "states": {"angle": "rad", "rate": "rad/s"},
        "inputs": {"torque": "N·m"},
        "parameters": {"inertia": lh.Quantity(0.02, "kg·m²"), "gravity": lh.Quantity(0.5, "N·m")},
    }
    return lh.simulator(f, **{**given, **changes})


class Engine:
    """A simulator with a state of its own, which is set, stepped and read."""

    angle = rate = 0.0

    def simulate(self, p: Any, t: Any, u: Any, x0: Any) -> Any:
        self.angle, self.rate = x0.angle, x0.rate
        motion = [(self.angle, self.rate)]
        for torque, length in zip(u.torque, np.diff(t), strict=False):
            time.sleep(0.0)  # another thread may go on here
            self.rate += length * (torque - p.gravity * np.sin(self.angle)) / p.inertia
            self.angle += length * self.rate
            motion.append((self.angle, self.rate))
        return motion

    def step(self, x: Any, u: Any, p: Any, dt: float) -> Any:
        return self.simulate(p, np.array([0.0, dt]), type(u)([u.torque]), x)[1]


@pytest.mark.parametrize("kind", ["rollout", "step"])
def test_an_engine_with_a_state_is_called_by_one_thread_at_a_time(kind: str) -> None:
    engine = Engine()
    rig = rolled(engine.simulate if kind == "rollout" else engine.step, kind=kind)
    assert rig.stepped is not None
    accelerations = rig.stepped.acceleration_at
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 200))
    inertias = np.linspace(0.01, 0.05, 8)
    one_by_one = [accelerations((inertia, 0.5))(*points) for inertia in inertias]
    with ThreadPoolExecutor(4) as executor:
        at_once = list(executor.map(lambda inertia: accelerations((inertia, 0.5))(*points), inertias))
    np.testing.assert_array_equal(at_once, one_by_one)


@pytest.mark.parametrize("f", [simulate, coarse])
def test_its_acceleration_is_that_of_short_rollouts(f: Callable[..., Any]) -> None:
    rig = rolled(f)
    assert rig.stepped is not None
    x, v, u = np.array([0.3, -1.0]), np.array([0.4, 2.0]), np.array([0.1, -0.2])
    exact = (u - 0.45 * np.sin(x)) / 0.025
    assert rig.stepped.acceleration_at([0.025, 0.45])(x, v, u) == pytest.approx(exact, rel=5e-3)


@pytest.mark.extended
def test_a_fit_finds_the_plant_through_it(tmp_path: Path) -> None:
    rig = rolled()
    run = lh.read(recorded(bench(tmp_path), seed=5, seconds=6.0))
    fit = lh.fit(run, rig, terms=["viscous_friction"])
    found = {each.name: each.value for each in fit.parameters}
    assert found["inertia"] == pytest.approx(0.025, rel=0.01)
    assert found["gravity"] == pytest.approx(0.45, rel=0.01)
    assert found["viscous_friction.coefficient"] == pytest.approx(0.012, rel=0.05)
    assert not any("stepping by itself" in note for note in fit.to_dict()["notes"])


@pytest.mark.extended
def test_its_own_rollout_is_noted_where_it_goes_elsewhere(tmp_path: Path) -> None:
    """It forgets half of the torque in whole inputs, which short ones do not show."""

    def forgetful(p: Any, t: Any, u: Any, x0: Any) -> Any:
        torque = np.asarray(u.torque) * (0.2 if len(t) > 3 else 1.0)
        return simulate(p, t, type(u)(torque), x0)

    rig = rolled(forgetful)
    run = lh.read(recorded(bench(tmp_path), seed=5, seconds=4.0))
    record = record_of(run.file, rig.kind)
    model = model_for(rig.rig_file, record)
    assert isinstance(model, SimulatorModel)
    assert any("stepping by itself" in note for note in model.notes)


@pytest.mark.parametrize(
    ("f", "said"),
    [
        (
            lambda p, t, u, x0: np.zeros((len(t), 3)),
            r"an array \(3, 2\) of angle, rate, found one of shape \(3, 3",
        ),
        (
            lambda p, t, u, x0: np.zeros((len(t), 2)),
            r"the first of the states to be x0 = \[0\.1, -0\.2\], found",
        ),
        (lambda p, t: t, "found TypeError"),
        (lambda p, t, u, x0: [x0, *[(np.nan, 0.0)] * (len(t) - 1)], "expected finite rates"),
    ],
)
def test_what_breaks_is_named_with_what_was_expected(f: Callable[..., Any], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        rolled(f)


@pytest.mark.parametrize("kind", ["rates", "step", "rollout"])
def test_a_force_is_divided_by_the_inertia_that_is_named(kind: str) -> None:
    """Its unit is then N·m, whatever the unit of the input is: 1 V is 0.05 N·m here."""

    def rates(t: float, x: Any, u: Any, p: Any) -> tuple[float, float]:
        return x.rate, (p.gain * u.voltage - p.drag * x.rate) / p.inertia

    def step(x: Any, u: Any, p: Any, dt: float) -> tuple[float, float]:
        velocity, acceleration = rates(0.0, x, u, p)
        rate = velocity + dt * acceleration
        return x.angle + 0.5 * dt * (velocity + rate), rate

    def simulate(p: Any, t: Any, u: Any, x0: Any) -> Any:
        states = [x0]
        for k, length in enumerate(np.diff(t)):
            states.append(type(x0)(*step(states[-1], type(u)(u.voltage[k]), p, length)))
        return states

    gain, inertia, drag, force = 0.05, 1e-3, 2e-3, 1e-3
    rig = lh.simulator(
        {"rates": rates, "step": step, "rollout": simulate}[kind],
        kind=kind,
        name=f"motor_{kind}",
        states={"angle": "rad", "rate": "rad/s"},
        inputs={"voltage": "V"},
        parameters={"gain": gain, "inertia": inertia, "drag": drag},
        coordinates={"angle": lh.Coordinate("rate", inertia="inertia", force="N·m")},
    )
    t = 0.01 * np.arange(200)
    run = lh.recording(t, {"voltage": 0.0 * t}, {"angle": 0.5 * t}, rig=rig)
    record = record_of(run.file, rig.kind)
    model = SimulatorModel(rig, rig.rig_file, record)
    theta = start_values(model.parameters)
    theta[index_of(model.parameters)["constant_force.force"]] = force
    angle = model.simulate(theta, record, Windows.of([(0, len(t))]), np.zeros((1, 2)))[:, 0]
    settled = force / drag * (t - inertia / drag * -np.expm1(-t * drag / inertia))
    assert angle == pytest.approx(settled, abs=2e-3 * settled[-1])


def test_the_kinds_are_named() -> None:
    with pytest.raises(UsageError, match="kind: expected rates or step or rollout, found 'rollouts'"):
        rolled(kind="rollouts")
