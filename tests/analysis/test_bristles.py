"""Dry friction on bristles against Dahl's equation, LuGre solved by scipy, and its limits; found in data."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labhil.diagnose.locate import contribution
from labhil.identify.fitted import fit_terms
from labhil.physics import bristles, friction, rolling, sliding, winding
from labhil.physics.model import index_of, starts_of, terms_named
from labhil.physics.record import Windows
from labhil.signals import FloatArray

sys.path.insert(0, str(Path(__file__).parent))
from one_input_rigs import Replay, disagreement, replay, without

PERIOD = 5e-3
T = PERIOD * np.arange(401)
DRIVE = 1.5 * np.sin(2 * np.pi * 0.8 * T) + 0.8 * np.sin(2 * np.pi * 2.3 * T + 1.0)
COULOMB, LENGTH, DAMPING, DRAG = 0.5, 4e-3, 0.8, 0.3
TIME_CONSTANT = DAMPING * LENGTH / COULOMB


def bend(position: float, side: float, length: float) -> float:
    """The end of a way from an unbent state, in two parts that have to add up."""
    half = bristles.bend_after(0.0, side, 0.5 * position, length)
    return float(bristles.bend_after(half, side, 0.5 * position, length))


def test_bristles_bend_as_dahl_says() -> None:
    """Over a way that goes back and forth, by Dahl's differential equation in the velocity."""
    t = np.linspace(0.0, 3.0, 301)

    def rate(at: float, b: FloatArray) -> list[float]:
        v = 0.01 * np.pi * np.cos(np.pi * at) + 0.004 * 3.4 * np.pi * np.cos(3.4 * np.pi * at)
        return [(v - abs(v) * b[0]) / LENGTH]

    solved = solve_ivp(rate, (0.0, 3.0), [0.0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=1e-3).y[0]
    fine = np.linspace(0.0, 3.0, 60001)
    fine_way = 0.01 * np.sin(2 * np.pi * 0.5 * fine) + 0.004 * np.sin(2 * np.pi * 1.7 * fine)
    b, bends = 0.0, [0.0]
    for dx in np.diff(fine_way):
        b = bristles.bend_after(b, np.sign(dx), dx, LENGTH)
        bends.append(b)
    assert np.allclose(np.interp(t, fine, bends), solved, atol=1e-5)
    assert np.ptp(solved) > 1.8, "they bend over"


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_way_in_two_parts_bends_as_one(side: float) -> None:
    whole = bristles.bend_after(0.0, side, side * 0.003, LENGTH)
    assert bend(side * 0.003, side, LENGTH) == pytest.approx(whole, abs=1e-14)
    assert whole == pytest.approx(side * (1.0 - np.exp(-0.003 / LENGTH)))


def lugre(push: Callable[[float, float], float], first: tuple[float, float]) -> FloatArray:
    """Position (n,) of a unit mass on bristles, with x, v and the bristles' deflection as scipy's states."""

    def rates(t: float, s: FloatArray) -> list[float]:
        x, v, z = s
        z_rate = v - abs(v) * z / LENGTH
        return [v, push(t, x) - COULOMB * z / LENGTH - DAMPING * z_rate - DRAG * v, z_rate]

    begin = [*first, LENGTH * np.sign(first[1])]
    return np.asarray(
        solve_ivp(rates, (0.0, T[-1]), begin, t_eval=T, rtol=1e-9, atol=1e-11, max_step=1e-3).y[0]
    )


def laws(length: float = LENGTH, time_constant: float = TIME_CONSTANT) -> FloatArray:
    """Friction over the inertia."""
    f = np.zeros(friction.SIZE)
    f[friction.COULOMB], f[friction.VISCOUS], f[friction.STRIBECK_VELOCITY] = COULOMB, DRAG, 1.0
    f[friction.PRESLIDING_LENGTH], f[friction.BRISTLE_TIME] = length, time_constant
    return f


def slide(f: FloatArray, state: tuple[float, float] = (0.0, 0.2)) -> FloatArray:
    """Position of a unit mass under ``DRIVE``."""
    part = sliding.Part(**{**dict.fromkeys(sliding.Part._fields, 0.0), "low": -np.inf, "high": np.inf})
    table, out = np.zeros((4, 4)), np.empty((len(T), 3))
    table[1, 0] = 1.0
    whole = np.array([0]), np.array([len(T)])
    sliding.simulate(
        T, T, DRIVE, *whole, np.array([state]), sliding.table_from_array(table), part, f, np.ones(len(T)), out
    )
    return out[:, 0]


def turn(f: FloatArray, state: tuple[float, float] = (0.0, 0.2)) -> FloatArray:
    """Angle of a rotor of unit inertia whose torque is the voltage ``DRIVE``."""
    motor = winding.Motor(**{
        **dict.fromkeys(winding.Motor._fields, 0.0), "inertia": 1.0, "resistance": 1e3, "constant": 1e-3,
        "brush_width": 1.0,
    })  # fmt: skip
    out, one = np.empty((len(T), 3)), np.ones(len(T))
    whole = np.array([0]), np.array([len(T)])
    begin = np.array([[state[1], DRIVE[0] * 1e3, state[0]]])
    winding.simulate(T, T, 1e6 * DRIVE, *whole, begin, motor, f, one, one, out)
    return out[:, 2]


def roll(f: FloatArray, state: tuple[float, float] = (0.0, 0.2)) -> FloatArray:
    """Position of a ball on a beam that tilts by ``DRIVE`` over 10 m/s², without centrifugal force."""
    k = np.zeros(rolling.SIZE)
    k[rolling.GRAVITY] = 10.0
    for name in ("COULOMB", "VISCOUS", "STRIBECK_VELOCITY", "PRESLIDING_LENGTH", "BRISTLE_TIME"):
        k[getattr(rolling, name)] = f[getattr(friction, name)]
    out = np.empty((len(T), 2))
    whole = np.array([0]), np.array([len(T)])
    rolling.simulate(T, T, DRIVE / 10.0, 1.0, *whole, np.array([state]), k, out)
    return out[:, 0]


KERNELS = {"sliding": slide, "winding": turn, "rolling": roll}


@pytest.mark.parametrize("kernel", KERNELS)
def test_every_kernel_moves_as_scipy_says(kernel: str) -> None:
    """Ten reversals; presliding is 4 mm of a motion of 100 mm."""
    push = DRIVE if kernel != "rolling" else 10.0 * np.sin(DRIVE / 10.0)
    if kernel == "rolling":

        def pushed(t: float, x: float) -> float:
            return float(10.0 * np.sin(np.interp(t, T, DRIVE) / 10.0))

    else:

        def pushed(t: float, x: float) -> float:
            return float(np.interp(t, T, push))

    solved, found = lugre(pushed, (0.0, 0.2)), KERNELS[kernel](laws())
    assert np.abs(found - solved).max() < 2e-6
    stiff = KERNELS[kernel](laws(length=0.0, time_constant=0.0))
    assert np.abs(stiff - solved).max() > 1e-3, "bristles matter"


@pytest.mark.parametrize("kernel", KERNELS)
def test_short_bristles_are_coulomb_friction(kernel: str) -> None:
    """The error falls with the length, to that of friction that turns over at once."""
    exact = KERNELS[kernel](laws(length=0.0, time_constant=0.0))
    errors = [
        np.abs(KERNELS[kernel](laws(length, time_constant=0.0)) - exact).max() for length in (1e-4, 1e-6)
    ]
    assert errors[1] < 0.2 * errors[0]
    assert errors[1] < 1e-3


@pytest.mark.parametrize("rig", ["axis", "dc_motor"])
def test_bristles_need_dry_friction(rig: str) -> None:
    """Without it they change no bit of a simulation, so that nothing is said of them."""
    found = replay(rig, 20.0 * DRIVE, ["viscous_friction"])
    windows = Windows.of([(0, len(found.record))])
    plain = found.model.simulate(found.theta, found.record, windows, found.states[:1])
    found.theta[index_of(found.model.parameters)["presliding_friction.length"]] = 1e-3
    bent = found.model.simulate(found.theta, found.record, windows, found.states[:1])
    assert np.array_equal(bent, plain)


CARRIED = ("viscous_friction", "coulomb_friction", "presliding_friction")
PLANTS = {
    "axis": (
        40.0,
        {
            "coulomb_friction.level": 20.0,
            "presliding_friction.stiffness": 4e5,
            "presliding_friction.damping": 2e3,
        },
        1e-5,
    ),
    "dc_motor": (
        3.0,
        {
            "coulomb_friction.level": 0.06,
            "presliding_friction.stiffness": 6.0,
            "presliding_friction.damping": 0.02,
        },
        1e-5,
    ),
}
"""Size of the drive, parameters, and the largest difference between plant and model over the motion."""


def carried(rig: str, noise: dict[str, float] | None = None, seed: int = 0) -> Replay:
    """A plant on bristles, and a model with its numbers."""
    size, parameters, _ = PLANTS[rig]
    length = parameters["coulomb_friction.level"] / parameters["presliding_friction.stiffness"]
    time_constant = parameters["presliding_friction.damping"] / parameters["presliding_friction.stiffness"]
    own = {"presliding_friction.length": length, "presliding_friction.time_constant": time_constant}
    t, phases = PERIOD * np.arange(1200), (3.2, 4.1, 0.9, 5.7, 1.9)
    tones = zip((0.5, 1.1, 1.7, 2.6, 3.9), phases, strict=True)
    drive = np.sum([0.55 * np.sin(2 * np.pi * f * t + phase) for f, phase in tones], axis=0)
    return replay(rig, size * drive, CARRIED, parameters, own=own, period=PERIOD, noise=noise, seed=seed)


@pytest.mark.parametrize("rig", PLANTS)
def test_the_plant_on_bristles_agrees_with_the_model(rig: str) -> None:
    """The plant, which shares no code with the model, steps the bristles' equation in short moments."""
    found, spans = carried(rig), [(200, 700)]
    assert disagreement(found, spans).max() < PLANTS[rig][2]
    assert disagreement(without(found, ["presliding_friction"]), spans).max() > 10.0 * PLANTS[rig][2]


def test_bristles_are_found_far_below_the_noise_and_act_after_reversals() -> None:
    """They bend 50 µm under noise of 100 µm; what they change is near zero velocity."""
    found = carried("axis", {"position_noise": 1e-4}, seed=3)
    starts = starts_of(found.model, terms_named(found.model, CARRIED), found.record)
    fit = fit_terms(found.model, found.record, CARRIED, 1.0, np.array([1e-4]), starts=starts, iterations=25)
    places = index_of(found.model.parameters)
    length = places["presliding_friction.length"]
    assert fit.theta[length] == pytest.approx(found.theta[length], rel=0.25)
    assert fit.noise < 1.1
    bent = contribution(fit, "presliding_friction")
    speed = np.abs(bent.coordinates["axis_velocity"])
    strong = np.abs(bent.values) > 0.5 * np.abs(bent.values).max()
    assert bent.unit == "N"
    assert speed[strong].max() < 0.3 * np.sqrt(np.mean(speed**2))
