"""The simulated ball and beam against what can be worked out by hand."""

import time

import numpy as np
import pytest

from labhil.errors import UnknownNameError, UsageError
from labhil.plants.ball_beam import BallBeamPlant
from labhil.plants.ball_beam_definition import BALL_BEAM, EFFECTS

G = 9.81
INERTIA = 0.261 * 1.4
FAR = {"stop": 50.0, "adc_range": 100.0, "adc_bits": 16}
EXACT = {"position_noise": 0.0}
WITHOUT_ZERO = {
    "presliding_friction", "maxwell_slip_friction", "saturation", "rate_limit", "actuator_lag", "sensor_lag",
}  # fmt: skip
"""Effects that are either there or not: their parameters are no strengths."""


def tilted(angle: float, seconds: float) -> np.ndarray:
    return np.full(round(seconds * 100) + 1, angle)


def beam(angle: float) -> float:
    return np.arcsin(0.2 * np.sin(angle))


def two_sines(seconds: float = 30.0, amplitude: float = 1.0) -> np.ndarray:
    t = np.arange(round(seconds * 100) + 1) * 0.01
    return amplitude * (np.sin(2 * np.pi * 0.23 * t) + np.sin(2 * np.pi * 0.31 * t))


def drive_around_the_middle(plant: BallBeamPlant, seconds: float) -> np.ndarray:
    """Counts of a plant under the two sines and a stabilising feedback of its own true state."""
    counts = []
    for angle in two_sines(seconds):
        wanted = angle - 7.0 * plant.position - 3.0 * plant.velocity
        counts.append(plant.step(float(np.clip(wanted, -1.2, 1.2))))
    return np.array(counts)


def test_a_frictionless_ball_on_a_tilted_beam_falls_as_galileo_says():
    trajectory = BallBeamPlant(FAR).simulate(tilted(0.4, 2.0))
    expected = 0.5 * (5.0 / 7.0) * G * np.sin(beam(0.4)) * trajectory.t**2
    np.testing.assert_allclose(trajectory.position, expected, atol=1e-9)


def test_viscous_friction_slows_exponentially():
    plant = BallBeamPlant(FAR, ["viscous_friction"])
    trajectory = plant.simulate(tilted(0.4, 3.0))
    rate, final = 0.26 / INERTIA, 0.261 * G * np.sin(beam(0.4)) / 0.26
    np.testing.assert_allclose(trajectory.velocity, final * (1 - np.exp(-rate * trajectory.t)), atol=1e-7)


def test_coulomb_friction_stops_dead_and_holds():
    plant = BallBeamPlant(FAR | EXACT, ["coulomb_friction"])
    plant.simulate(tilted(0.5, 0.5))
    plant.simulate(np.array([0.5, 0.0, 0.0]))
    x, v = plant.position, plant.velocity
    stopped = plant.simulate(tilted(0.0, 6.0))
    deceleration = 0.09 / INERTIA
    assert stopped.position[-1] - x == pytest.approx(v**2 / (2 * deceleration), rel=1e-6)
    at_rest = stopped.t > v / deceleration
    assert np.all(stopped.velocity[at_rest] == 0.0)
    assert np.ptp(stopped.position[at_rest]) == 0.0


@pytest.mark.parametrize("terms", [["coulomb_friction"], ["coulomb_friction", "static_friction"]])
def test_nothing_moves_below_break_away_and_everything_above(terms):
    hold = sum({"coulomb_friction": 0.09, "static_friction": 0.05}[term] for term in terms)
    edge = np.arcsin(hold / (0.261 * G) / 0.2)
    below = BallBeamPlant(EXACT, terms).simulate(tilted(0.999 * edge, 5.0))
    above = BallBeamPlant(EXACT, terms).simulate(tilted(1.001 * edge, 5.0))
    assert np.all(below.position == 0.0)
    assert above.position[-1] > 1e-5


def test_energy_is_kept_where_nothing_takes_it():
    plant = BallBeamPlant(FAR | EXACT | {"start_position": 1.0}, ["spring_force"])
    trajectory = plant.simulate(tilted(0.0, 60.0))
    energy = 0.5 * INERTIA * trajectory.velocity**2 + 0.25 * trajectory.position**2
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    assert trajectory.position.min() < -0.99


def test_the_tilting_itself_moves_the_ball():
    """A beam that starts to tilt rolls the ball back by J/R·Δβ̇ over the inertia; gravity adds its own."""
    plant = BallBeamPlant(FAR | EXACT)
    plant.step(0.05)
    tilting = beam(0.05) / 0.01
    rolled_back = -0.4 * 0.02 / 1.4 * tilting
    by_gravity = G / 1.4 * tilting * 0.01**2 / 2
    assert plant.velocity == pytest.approx(rolled_back + by_gravity, rel=1e-3)


def test_end_stops_hold_the_ball_in():
    trajectory = BallBeamPlant(EXACT).simulate(np.concatenate([tilted(0.8, 4.0), tilted(-0.8, 4.0)]))
    assert np.abs(trajectory.position).max() <= 0.25
    assert trajectory.position[395:401] == pytest.approx(0.25)
    assert trajectory.position[-1] == pytest.approx(-0.25)
    first = np.argmax(trajectory.position >= 0.24)
    assert np.any(trajectory.velocity[first : first + 50] < -0.05)


def test_bristles_give_way_before_they_slip():
    terms = ["coulomb_friction", "presliding_friction"]
    force = 0.2 * 0.09
    edge = np.arcsin(force / (0.261 * G) / 0.2)
    held = BallBeamPlant(EXACT, terms).simulate(np.linspace(0.0, edge, 500))
    assert held.position[-1] == pytest.approx(force / 2000.0, rel=0.2)
    assert np.abs(held.velocity).max() < 1e-4
    sliding = BallBeamPlant(FAR | EXACT, terms).simulate(tilted(0.8, 2.0))
    plain = BallBeamPlant(FAR | EXACT, ["coulomb_friction"]).simulate(tilted(0.8, 2.0))
    assert sliding.position[-1] == pytest.approx(plain.position[-1], rel=3e-3)


@pytest.mark.parametrize("delay", [0.05, 0.013])
def test_the_delay_shifts_the_answer(delay):
    angles = two_sines(4.0)
    late = BallBeamPlant(FAR | EXACT | {"time_delay.delay": delay}, ["time_delay"]).simulate(angles)
    prompt = BallBeamPlant(FAR | EXACT).simulate(angles)
    expected = np.interp(late.t - delay, prompt.t, prompt.position, left=0.0)
    np.testing.assert_allclose(late.position, expected, atol=2e-5)


@pytest.mark.parametrize("effect", sorted(EFFECTS))
def test_each_effect_changes_what_is_seen(effect):
    bare = ["viscous_friction", "coulomb_friction"]
    terms = [term for term in bare if term != effect]
    without = drive_around_the_middle(BallBeamPlant(terms=terms, seed=1), 20.0)
    with_it = drive_around_the_middle(BallBeamPlant(terms=[*terms, effect], seed=1), 20.0)
    assert np.any(with_it != without)


@pytest.mark.parametrize("effect", sorted(set(EFFECTS) - WITHOUT_ZERO))
def test_an_effect_of_no_strength_is_exactly_absent(effect):
    others = [term for term in ("viscous_friction", "coulomb_friction") if term != effect]
    neutral = {name: 0.0 for name in BALL_BEAM.parameters_of(effect) if name != "stribeck_friction.velocity"}
    with_it = drive_around_the_middle(BallBeamPlant(neutral, [*others, effect], seed=2), 5.0)
    without = drive_around_the_middle(BallBeamPlant(terms=others, seed=2), 5.0)
    np.testing.assert_array_equal(with_it, without)


def test_the_seed_decides_the_noise_and_nothing_else():
    runs = [
        BallBeamPlant(terms=["viscous_friction"], seed=seed).simulate(two_sines(5.0)) for seed in (3, 3, 4)
    ]
    np.testing.assert_array_equal(runs[0].counts, runs[1].counts)
    np.testing.assert_array_equal(runs[0].position, runs[2].position)
    assert np.any(runs[0].counts != runs[2].counts)


def test_stepping_is_simulating():
    angles = two_sines(3.0)
    terms = ["coulomb_friction", "stribeck_friction", "time_delay", "backlash", "sensor_lag"]
    whole = BallBeamPlant(EXACT, terms).simulate(angles)
    plant = BallBeamPlant(EXACT, terms)
    np.testing.assert_array_equal(whole.counts[1:], [plant.step(float(angle)) for angle in angles[1:]])


@pytest.mark.parametrize("bits", [8, 10])
def test_the_converter_rounds_to_its_counts(bits):
    plant = BallBeamPlant({"adc_bits": bits, "start_position": 0.1}, ["coulomb_friction"])
    trajectory = plant.simulate(np.zeros(2000))
    step = 0.5 / 2**bits
    assert plant.sensor.scale == step
    np.testing.assert_allclose(trajectory.measured / step, np.rint(trajectory.measured / step))
    assert trajectory.measured.mean() == pytest.approx(0.1, abs=0.51 * step)
    if bits == 10:
        assert trajectory.measured.std() == pytest.approx(np.hypot(0.0004, step / np.sqrt(12)), rel=0.1)


def test_names_and_values_that_make_no_world_are_refused():
    with pytest.raises(UnknownNameError, match="stribeck_friction"):
        BallBeamPlant(terms=["stribek_friction"])
    with pytest.raises(UnknownNameError, match="did you mean 'ball_mass'"):
        BallBeamPlant({"bal_mass": 1.0})
    with pytest.raises(UsageError, match="belongs to time_delay"):
        BallBeamPlant({"time_delay.delay": 0.1})
    with pytest.raises(UsageError, match="positive"):
        BallBeamPlant({"ball_mass": 0.0})
    with pytest.raises(UsageError, match="dry friction"):
        BallBeamPlant(terms=["presliding_friction"])
    assert set(BALL_BEAM.parameters_of("dead_zone")) <= set(BALL_BEAM.all_parameters())


def test_a_minute_is_simulated_in_much_less():
    terms = ["viscous_friction", "coulomb_friction", "stribeck_friction", "time_delay"]
    BallBeamPlant(terms=terms).simulate(two_sines(1.0))
    begin = time.perf_counter()
    trajectory = BallBeamPlant(terms=terms).simulate(two_sines(60.0))
    print(f"60 s simulated in {time.perf_counter() - begin:.3f} s")
    assert len(trajectory.t) == 6001


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("backlash", {"backlash.gap": 6e-4}),
        ("dead_zone", {}),
        ("saturation", {"saturation.limit": 0.3}),
        ("rate_limit", {"rate_limit.rate": 4.0}),
        ("time_delay", {"time_delay.delay": 0.0437}),
    ],
)
def test_a_chattering_servo_gives_the_same_motion_however_finely_it_is_sampled(effect, values):
    """The input path is exact for lines between samples, also where each sample is a reversal."""
    rng = np.random.default_rng(5)
    coarse = 0.5 * np.sin(np.arange(201) * 0.05) + 0.05 * rng.standard_normal(201)
    fine = np.interp(np.arange(200 * 20 + 1) / 20, np.arange(201), coarse)
    terms = ["viscous_friction", effect]
    seldom = BallBeamPlant(FAR | values, terms).simulate(coarse)
    often = BallBeamPlant(FAR | values, terms, period=0.0005).simulate(fine)
    bare = BallBeamPlant(FAR, terms[:1]).simulate(coarse)
    np.testing.assert_allclose(seldom.position, often.position[::20], atol=1e-7)
    assert np.abs(seldom.position - bare.position).max() > 1e-4, "the effect matters"
