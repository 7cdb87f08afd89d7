"""The event integrator against solutions by hand: sticking, slipping, stopping, bouncing, a stalled coil."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labhil.physics import friction, sliding, winding

pytestmark = pytest.mark.extended

T = 1e-3 * np.arange(8001)
ONE = np.ones(len(T))


def law(**strengths: float) -> np.ndarray:
    """Friction over the inertia, by place."""
    values = np.zeros(friction.SIZE)
    values[friction.STRIBECK_VELOCITY] = 1.0
    for name, strength in strengths.items():
        values[getattr(friction, name.upper())] = strength
    return values


def slide(u, part=None, state=(0.0, 0.0), t=T, **strengths):
    """x and v of a part of unit mass that ``u`` pushes, straight between the samples."""
    free = dict.fromkeys(sliding.Part._fields, 0.0) | {"low": -np.inf, "high": np.inf}
    table = np.zeros((4, 4))
    table[1, 0] = 1.0
    out = np.empty((len(t), 3))
    u = np.full(len(t), float(u)) if np.isscalar(u) else u
    whole = np.array([0]), np.array([len(t)])
    here = sliding.Part(**(free | (part or {})))
    sliding.simulate(t, t, u, *whole, np.array([state]), table, here, law(**strengths), np.ones(len(t)), out)
    return out[:, 0], out[:, 1]


def turn(u, motor, state=(0.0, 0.0, 0.0), t=T, **strengths):
    """ω, i and angle of a motor at voltage ``u``, straight between the samples."""
    still = dict.fromkeys(winding.Motor._fields, 0.0)
    still |= {"inertia": 1.0, "resistance": 1.0, "brush_width": 1.0}
    out = np.empty((len(t), 3))
    u = np.full(len(t), float(u)) if np.isscalar(u) else u
    whole, one = (np.array([0]), np.array([len(t)])), np.ones(len(t))
    here = winding.Motor(**(still | motor))
    winding.simulate(t, t, u, *whole, np.array([state]), here, law(**strengths), one, one, out)
    return out.T


def stick_slip(omega, pull, static, coulomb, t):
    """Position of a unit mass behind a spring of ω² that is pulled at speed ``pull`` from rest, by hand.

    It sticks until ω²·(pull·t − x) is ``static``, slips until it has the ground's speed again, and sticks
    for another 2·(static − coulomb)/(ω²·pull). Returns x and the moments of every break-away and stop.
    """
    k, level, start = omega**2, static - coulomb, 0.0
    x, here, moments = np.zeros_like(t), 0.0, []
    leaves = static / (k * pull)
    while leaves < t[-1]:
        slips = (2.0 * np.pi - 2.0 * np.arctan(level * omega / (k * pull))) / omega
        moments += [leaves, leaves + slips]
        x[(t >= start) & (t < leaves)] = here
        moving = (t >= leaves) & (t < leaves + slips)
        s = t[moving] - leaves
        ahead = coulomb / k + level / k * np.cos(omega * s) + pull / omega * np.sin(omega * s)
        x[moving] = pull * t[moving] - ahead
        start = leaves + slips
        here = pull * start - (coulomb - level) / k
        leaves = start + 2.0 * level / (k * pull)
    x[t >= start] = here
    return x, np.array(moments)


@pytest.mark.parametrize(("omega", "pull"), [(7.0, 0.05), (20.0, 0.02), (3.0, 0.2)])
def test_every_stick_and_slip_is_right_to_the_sample(omega, pull):
    static, coulomb = 2.0, 1.2
    expected, moments = stick_slip(omega, pull, static, coulomb, T)
    x, v = slide(omega**2 * pull * T, {"spring": omega**2}, coulomb=coulomb, static=static - coulomb)
    assert len(moments) > 3
    assert np.allclose(x, expected, atol=2e-6 * np.ptp(expected))
    moves = np.flatnonzero(np.diff(v != 0.0))
    seen = moments[moments < T[-1]]
    assert len(moves) == len(seen)
    assert np.all((seen >= T[moves]) & (seen <= T[moves + 1])), "each within its own sample"


def test_a_part_that_coasts_stops_at_the_right_moment_and_place():
    viscous, dry, begun = 0.7, 0.4, 2.0
    x, v = slide(0.0, state=(0.0, begun), viscous=viscous, coulomb=dry)
    stop = np.log1p(viscous * begun / dry) / viscous
    run = np.minimum(T, stop)
    expected = (begun + dry / viscous) * np.exp(-viscous * run) - dry / viscous
    assert np.allclose(v, np.where(stop > T, expected, 0.0), atol=1e-9)
    place = (begun + dry / viscous) * (1 - np.exp(-viscous * stop)) / viscous - dry / viscous * stop
    assert np.allclose(x[stop < T], place, atol=1e-9)
    assert np.ptp(x[stop < T]) == 0.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_load_holds_more_and_a_shifted_force_breaks_away_sooner(side):
    share, dry, push = 0.5, 0.3, 0.2
    ramp = side * 0.25 * T
    _, v = slide(ramp, {"force": push}, coulomb=dry, load_share=share)
    # |u| grows until u + push is as large as dry + share·|u|
    leaves = (dry - side * push) / (1.0 - share) / 0.25
    assert np.all(v[leaves >= T] == 0.0)
    assert np.all(side * v[leaves + 1e-3 < T] > 0.0)


def test_a_bouncing_part_comes_back_with_its_share_of_speed():
    bounce, gravity, height = 0.6, 2.0, 0.5
    x, v = slide(-gravity, {"low": 0.0, "restitution": bounce}, state=(height, 0.0))
    fall = np.sqrt(2.0 * height / gravity)
    began, speed = fall, gravity * fall
    assert np.allclose(x[fall > T], height - 0.5 * gravity * T[fall > T] ** 2, atol=1e-12)
    for _ in range(6):
        speed *= bounce
        flight = 2.0 * speed / gravity
        here = (began < T) & (began + flight > T)
        s = T[here] - began
        assert np.allclose(x[here], speed * s - 0.5 * gravity * s**2, atol=1e-9)
        began += flight
    rests = fall + 2.0 * gravity * fall * bounce / (1.0 - bounce) / gravity < T
    assert np.all(x[rests] == 0.0), "after infinitely many bounces in finite time"
    assert np.all(v[rests] == 0.0)


@pytest.mark.parametrize("inductance", [0.0, 1e-9, 1e-5, 1e-3, 0.05, 2.0])
def test_the_current_of_a_stalled_motor_is_that_of_a_resistor_and_a_coil(inductance):
    resistance, rise = 2.0, 3.0
    motor = {"resistance": resistance, "inductance": inductance, "constant": 0.1}
    w, i, _ = turn(5.0 + rise * T, motor, state=(0.0, 1.0, 0.0), coulomb=1e3)
    lag = inductance / resistance
    settled = (5.0 + rise * (T - lag)) / resistance
    left = np.exp(-T / lag) if lag else np.where(T == 0.0, 1.0, 0.0)
    assert np.all(w == 0.0)
    assert np.allclose(i, settled + (1.0 - (5.0 - rise * lag) / resistance) * left, atol=1e-9)


@pytest.mark.parametrize("inductance", [0.0, 1e-7, 1e-4, 2e-3, 0.1, 1.0])
def test_a_linear_motor_follows_its_matrix_exponential(inductance):
    from scipy.linalg import expm

    inertia, constant, resistance, viscous, period = 0.1, 0.2, 1.5, 0.05, 0.01
    t = period * np.arange(400)
    held = np.repeat(np.random.default_rng(1).uniform(-5, 5, 20), 20)
    smallest = max(inductance, 1e-10)
    a = np.array([[-viscous / inertia, constant / inertia], [-constant / smallest, -resistance / smallest]])
    gain = expm(np.block([[a, np.array([[0.0], [1.0 / smallest]])], [np.zeros((1, 3))]]) * period)
    expected = np.zeros((len(t), 2))
    for k in range(len(t) - 1):
        expected[k + 1] = gain[:2, :2] @ expected[k] + gain[:2, 2] * held[k]
    out, one = np.empty((len(t), 3)), np.ones(len(t))
    still = dict.fromkeys(winding.Motor._fields, 0.0) | {"brush_width": 1.0}
    motor = winding.Motor(
        **(still | {"inertia": inertia, "constant": constant, "resistance": resistance})
        | {"inductance": inductance}
    )
    node_t, volts = np.repeat(t, 2)[1:], np.repeat(held, 2)[:-1]
    span = np.array([0]), np.array([len(t)])
    friction_of = law(viscous=viscous / inertia)
    winding.simulate(t, node_t, volts, *span, np.zeros((1, 3)), motor, friction_of, one, one, out)
    largest = np.abs(expected).max(axis=0)
    assert np.all(np.abs(out[1:, :2] - expected[1:]).max(axis=0) < 3e-6 * largest)


def test_brushes_take_their_voltage_whichever_way_the_current_flows():
    motor = {"brush_drop": 0.8, "brush_width": 1e-3, "inductance": 0.01, "resistance": 2.0}
    for volts, current in ((3.0, 1.1), (-3.0, -1.1), (0.5, 0.5 / (2.0 + 800.0)), (0.0, 0.0)):
        for inductance in (0.01, 0.0):
            _, i, _ = turn(volts, {**motor, "inductance": inductance}, coulomb=1e3)
            assert np.isclose(i[-1], current, atol=1e-9)


@pytest.mark.parametrize(
    ("drop", "inductance", "period"),
    [(0.8, 1e-4, 0.01), (8.0, 1e-4, 0.01), (0.8, 5e-3, 0.01), (0.8, 1e-2, 1e-3)],
)
def test_brushes_of_a_motor_that_settles_between_samples_agree_with_scipy(drop, inductance, period):
    """Current reverses and rests in the narrow range, where it is a hundred times faster than the samples."""
    inertia, constant, resistance, viscous, width = 0.02, 0.25, 1.0, 0.003, 0.01
    t = period * np.arange(int(2.0 / period))
    volts = 6.0 * np.sin(4.0 * t) + 3.0 * np.sin(11.0 * t)

    def rates(now, state):
        speed, i = state
        across = np.interp(now, t, volts) - resistance * i - constant * speed
        return (constant * i - viscous * speed) / inertia, (
            across - drop * np.clip(i / width, -1.0, 1.0)
        ) / inductance

    expected = solve_ivp(
        rates, (0.0, t[-1]), [0.0, 0.0], "Radau", t, rtol=1e-8, atol=1e-10, max_step=0.5 * period
    ).y.T
    motor = winding.Motor(inertia, constant, resistance, inductance, drop, width, 0.0, 0.0, 0.0, 0.0, 0.0)
    out, one, span = np.empty((len(t), 3)), np.ones(len(t)), (np.array([0]), np.array([len(t)]))
    winding.simulate(
        t, t, volts, *span, np.zeros((1, 3)), motor, law(viscous=viscous / inertia), one, one, out
    )
    largest = np.abs(expected).max(axis=0)
    assert np.all(np.abs(out[:, :2] - expected).max(axis=0) < 2e-4 * largest)


def test_rest_ends_where_the_pull_barely_passes_the_hold():
    """A pull that touches the hold for an instant moves nothing far, and one that stays below nothing."""
    period = 2.0 * np.pi / T[-1]
    for peak, moves in ((0.999999, False), (1.000001, True)):
        x, _ = slide(peak * np.sin(period * T), coulomb=1.0)
        assert (np.abs(x).max() > 0.0) == moves
        assert np.abs(x).max() < 1e-6


def test_what_runs_away_stays_a_number():
    x, v = slide(1.0, {"spring": -1e9}, state=(1.0, 0.0))
    assert np.all(np.isfinite(x))
    assert np.all(np.isfinite(v))


def test_kernels_are_found_again_on_disk_by_the_next_process():
    script = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import test_stick_slip as s\n"
        "s.slide(0.0); s.turn(0.0, {})\n"
        "print([sum(k.simulate.stats.cache_misses.values()) for k in (s.sliding, s.winding)])\n"
    )
    command = [sys.executable, "-c", script, str(Path(__file__).parent)]
    subprocess.run(command, capture_output=True, check=True)
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[0, 0]"


def test_a_part_that_friction_damps_swiftly_follows_a_ramp_exactly():
    rate, rise = 5000.0, 3.0
    _, v = slide(rise * T, viscous=rate)
    by_hand = rise / rate * (T - (1.0 - np.exp(-rate * T)) / rate)
    np.testing.assert_allclose(v, by_hand, rtol=1e-9, atol=1e-15)


def test_creep_where_friction_rises_from_nothing_agrees_with_a_stiff_solver():
    # below 0.1 mm/s friction grows from 0.2 to 1: explicit steps would have to be as short as 10 µs
    width, u = 1e-4, 0.6 + 0.3 * np.sin(2.0 * T)
    x, v = slide(u, coulomb=1.0, stribeck=-0.8, stribeck_velocity=width)

    def slopes(t, s):
        return [s[1], 0.6 + 0.3 * np.sin(2.0 * t) - 1.0 + 0.8 * np.exp(-s[1] / width)]

    def jacobian(t, s):
        return [[0.0, 1.0], [0.0, -0.8 / width * np.exp(-s[1] / width)]]

    solved = solve_ivp(slopes, (0.0, T[-1]), [0.0, 0.0], "Radau", T, rtol=1e-9, atol=1e-13, jac=jacobian)
    assert np.ptp(v) > width
    np.testing.assert_allclose(x, solved.y[0], atol=1e-3 * np.ptp(x))
    np.testing.assert_allclose(v, solved.y[1], atol=5e-3 * width)


ENDLESS = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from test_stick_slip import turn
motor = {"inertia": 0.012, "constant": 22.4, "inductance": 9.2e-6, "resistance": 1.97}
t = 0.01 * np.arange(600)
u = 5.0 * np.sign(np.sin(3.0 * t))
speed, current, _ = turn(u, motor, (0.005, 14400.0, 0.0), t, viscous=2757.0, coulomb=716.0)
assert np.isfinite(speed).all() and np.isfinite(current).all()
"""


def test_a_simulation_of_impossible_values_ends():
    # a current of 14 kA and a winding of 5 µs: steps no law allows, events without end
    here = str(Path(__file__).parent)
    subprocess.run([sys.executable, "-c", ENDLESS, here], check=True, timeout=100)


KERNEL = """
import sys
sys.path.insert(0, sys.argv[1])
from kernel import twice
print(twice(1.0))
"""


def test_a_kernel_on_disk_follows_laws_of_other_files(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "kernel.py").write_text(
        "from labhil.compiled import compiled\nfrom law import force\n\n\n"
        "@compiled\ndef twice(x):\n    return 2.0 * force(x)\n"
    )
    for strength in (3.0, 5.0):
        (tmp_path / "law.py").write_text(
            f"from labhil.compiled import inlined\n\n\n@inlined\ndef force(x):\n    return {strength} * x\n"
        )
        run = [sys.executable, "-B", "-c", KERNEL, str(tmp_path)]
        said = subprocess.run(run, check=True, capture_output=True, text=True).stdout
        assert float(said) == 2.0 * strength
