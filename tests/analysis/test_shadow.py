"""The shadow: an accepted model along the samples of a world that is the model, and of one that is more.

The world is that of the twin, without its wire; tests/tui/test_shadow.py has the twin itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from labhil.analysis.agreement import Agreement, find_exit
from labhil.analysis.rig_choice import rig_of
from labhil.analysis.shadow import Shadow, Stretch, validated_bands
from labhil.plants.ball_beam import BallBeamPlant
from labhil.recording.reader import read_recording
from labhil.recording.recording import StreamData
from labhil.signals import FloatArray

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "examples" / "fit.json"
VALIDATED = ROOT / "recordings" / "ball_beam_test.mcap"
PHYSICS = {
    "viscous_friction.coefficient": 0.26,
    "coulomb_friction.level": 0.09,
    "stribeck_friction.level": 0.06,
    "stribeck_friction.velocity": 0.02,
    "dead_zone.left": 0.06,
    "dead_zone.right": 0.08,
}
CONCEALED = {"constant_force.force": 0.05}


@dataclass(frozen=True)
class Played:
    """What a twin's board sends: times (n,) s, and ball position (m) and servo angle (rad), (n, 2)."""

    t: FloatArray
    values: FloatArray


def played(seed: int, duration: float, more: Mapping[str, float]) -> Played:
    """Drive the world of the twin, which has the physics of the model and more, around the middle."""
    world = PHYSICS | more
    plant = BallBeamPlant(world, dict.fromkeys(name.partition(".")[0] for name in world), seed)
    t = plant.period * np.arange(round(duration / plant.period), dtype=np.float64)
    wanted = 0.6 * (np.sin(2 * np.pi * 0.26 * t) + np.sin(2 * np.pi * 0.37 * t))
    rows = []
    for angle in wanted:
        applied = float(np.clip(angle - 7.0 * plant.position - 3.0 * plant.velocity, -1.2, 1.2))
        rows.append((float(plant.sensor.position(np.array([plant.step(applied)]))[0]), applied))
    return Played(t, np.array(rows))


def main_stream(path: Path) -> StreamData:
    return next(each for each in read_recording(path).streams if "ball_position" in each.stream.names())


def shadow_of(bands: tuple[float, ...] | None = None) -> Shadow:
    recording = read_recording(VALIDATED)
    return Shadow(MODEL, rig_of(recording, None), main_stream(VALIDATED).stream, bands)


def feed(shadow: Shadow, t: np.ndarray, values: np.ndarray, count: int = 7) -> Iterator[Stretch]:
    """Feed it a few samples at a time, as a bus does."""
    for first in range(0, len(t), count):
        shadow.take(t[first : first + count], values[first : first + count])
        while (found := shadow.step()) is not None:
            yield found


@pytest.fixture(scope="module")
def bands() -> tuple[float, ...]:
    recording, data = read_recording(VALIDATED), main_stream(VALIDATED)
    found = validated_bands(MODEL, rig_of(recording, None), data.stream, data.t, data.values)
    assert found is not None
    return found


@pytest.mark.extended
def test_a_twin_whose_physics_is_the_model_agrees_for_the_whole_run(bands):
    data = played(31, 90.0, {})
    shadow = shadow_of(bands)
    found = list(feed(shadow, data.t, data.values))
    (state,) = shadow.agreements
    assert (state.agrees, state.times_left, state.left_at) == (True, 0, None)
    assert (shadow.dropped, shadow.gaps) == (0.0, 0)
    judged = np.concatenate([each.t for each in found])
    expected = data.t[(data.t >= judged[0]) & (data.t <= judged[-1])]
    np.testing.assert_array_equal(judged, expected)  # every sample once, none left out
    assert judged[0] < data.t[0] + 2.1
    assert judged[-1] > data.t[-1] - 1.1
    residuals = np.concatenate([each.residuals for each in found])
    assert 0.7 < float(np.sqrt(np.mean(residuals**2))) < 1.3
    assert found[0].names == ("ball_position",)
    assert found[0].units == ("m",)
    assert 3e-4 < found[0].noise[0] < 7e-4


@pytest.mark.extended
def test_a_twin_with_concealed_physics_is_left_soon_and_the_time_is_told(bands):
    data = played(32, 20.0, CONCEALED)
    shadow = shadow_of(bands)
    found = list(feed(shadow, data.t, data.values))
    (state,) = shadow.agreements
    assert not shadow.agrees
    assert state.left_at is not None
    assert state.left_at - data.t[0] < 5.0
    assert state.beyond > 1.0
    assert state.times_left >= 1
    left = next(each for each in found if each.t[0] <= state.left_at <= each.t[-1])
    beyond = np.abs(left.residuals[left.t >= state.left_at, 0])
    assert np.all(beyond[:5] > state.band)


def test_physics_that_come_in_the_middle_are_noticed_then_and_their_end_too(bands):
    """Two twins one after the other stand for a rig that changes; between them samples are missing."""
    same, other = played(33, 15.0, {}), played(34, 15.0, CONCEALED)
    begins = [same.t[-1] + 0.5 - other.t[0]]
    changed = other.t + begins[0]
    again = same.t - same.t[0] + changed[-1] + 0.5
    shadow = shadow_of(bands)
    list(feed(shadow, same.t, same.values))
    assert shadow.agrees
    list(feed(shadow, changed, other.values))
    (state,) = shadow.agreements
    assert state.left_at is not None
    assert changed[0] <= state.left_at <= changed[0] + 6.0
    assert shadow.gaps == 1
    list(feed(shadow, again, same.values))
    (state,) = shadow.agreements
    assert (state.agrees, state.times_left, shadow.gaps) == (True, 1, 2)


def test_what_comes_faster_than_it_is_simulated_is_dropped_and_counted(bands):
    data = main_stream(VALIDATED)
    shadow = shadow_of(bands)
    shadow.take(data.t, data.values)
    found = []
    while (stretch := shadow.step()) is not None:
        found.append(stretch)
    assert len(found) <= 2
    assert found[0].t[0] > 20.0
    simulated = found[-1].t[-1] - found[0].t[0]
    assert shadow.dropped == pytest.approx(found[0].t[0] - 2.0, abs=0.05)
    assert simulated + shadow.dropped == pytest.approx(data.t[-1] - 2.0, abs=1.1)
    assert shadow.agrees


def test_a_band_is_that_of_the_models_own_validated_error(bands):
    (band,) = bands
    assert 1.15 * 3.29 - 1e-9 <= band < 6.0
    recording, data = read_recording(VALIDATED), main_stream(VALIDATED)
    rig = rig_of(recording, None)
    assert validated_bands(MODEL, rig, data.stream, data.t[:100], data.values[:100]) is None


def test_samples_that_are_none_or_old_are_left_out(bands):
    data = main_stream(VALIDATED)
    shadow = shadow_of(bands)
    values = data.values.copy()
    values[150] = np.nan
    found = list(feed(shadow, data.t[:600], values[:600]))
    shadow.take(data.t[:300], values[:300])
    assert shadow.gaps == 0
    assert data.t[150] not in np.concatenate([each.t for each in found])
    assert shadow.agrees


def test_a_run_beyond_the_band_on_one_side_leaves_it_and_single_peaks_do_not():
    quiet = np.zeros(100)
    peaks = quiet.copy()
    peaks[::2] = 9.0
    sides = np.where(np.arange(100) % 2, 9.0, -9.0)
    late = quiet.copy()
    late[40:] = 5.0
    assert [find_exit(each, 4.0) for each in (quiet, peaks, sides, late, -late)] == [None, None, None, 40, 40]
    assert find_exit(np.full(100, np.nan), 4.0) == 0
    t = 12.0 + 0.01 * np.arange(100)
    state = Agreement(4.0).after(t, late, 2.0)
    assert (state.left_at, state.beyond, state.times_left) == (pytest.approx(12.4), 1.0, 1)
    back = state.after(t + 1.0, quiet, 2.0)
    assert (back.left_at, back.calm_since) == (state.left_at, pytest.approx(13.0))
    assert back.after(t + 2.01, quiet, 2.0).agrees


def test_a_ball_that_hardly_moves_has_not_left_its_model() -> None:
    """A stretch of the twin itself: near its slowest the lead-in has a second, wrong state, at rest."""
    t, *values = np.loadtxt(Path(__file__).parent / "creeping_ball.csv", delimiter=",", skiprows=1).T
    (stretch,) = feed(shadow_of(), t, np.column_stack(values))
    assert np.abs(stretch.residuals).max() < 4.0
