"""A simulated ball and beam: servo angle in, converter counts out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from labhil.compiled import compiled
from labhil.errors import UsageError
from labhil.plants.ball_beam_definition import BALL_BEAM
from labhil.plants.ball_motion import BALL_SIZE, POSITION, VELOCITY, Mechanics, move
from labhil.plants.friction import Friction
from labhil.plants.input_path import (
    HISTORY,
    NEUTRAL,
    InputPath,
    apply_lag,
    pass_through,
    read_delayed,
    settled_path,
)
from labhil.plants.sensor import Sensor
from labhil.plants.trajectory import Noise
from labhil.signals import FloatArray, IntArray

SAMPLE_PERIOD = 0.01
MIN_SUBSTEPS = 50
"""Substeps of a sample period where the input path or the sensor has a memory, at least.

Controllers make the servo chatter, and coarser substeps would smooth the corners of β̇².
"""

MAX_SUBSTEPS = 1000
SUBSTEPS_PER_LAG = 5.0
"""Substeps in the time constant of an actuator's lag: the mean of β̇² is then right to 0.3 % of its change."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Samples of a simulation, (n,) each.

    Attributes:
        t: Times, s.
        counts: Counts of the converter.
        measured: Positions of the counts, m.
        position: True position, m.
        velocity: True velocity, m/s.
    """

    t: FloatArray
    counts: IntArray
    measured: FloatArray
    position: FloatArray
    velocity: FloatArray


class BallBeamPlant:
    """A simulated ball and beam; it starts level, with the ball at rest at ``start_position``.

    Args:
        parameters: Values by name, SI, that replace defaults.
        terms: Names of the effects that it has.
        seed: Seed of the noise; ``noise`` draws that, with unit variance.
        period: Time between samples, s.

    Raises:
        UnknownNameError: An effect or a parameter does not exist.
        UsageError: A value is out of range.
    """

    def __init__(
        self,
        parameters: Mapping[str, float] | None = None,
        terms: Iterable[str] = (),
        seed: int = 0,
        period: float = SAMPLE_PERIOD,
    ) -> None:
        self.terms = tuple(terms)
        self.parameters = BALL_BEAM.resolve(self.terms, parameters or {})
        self.period = period
        self.sensor = Sensor.of(self.parameters)
        self._mechanics = Mechanics.of(self.parameters)
        self._friction = Friction.of(self.parameters)
        self._path = InputPath.of(self.parameters)
        if self._path.delay > (HISTORY - 2) * period:
            raise UsageError(f"time_delay.delay is too long for a sample period of {period:g} s")
        has_memory = self._path != NEUTRAL or self.sensor.lag > 0.0
        lag, delay = self._path.lag / period, self._path.delay / period
        self._substeps = substep_ends(delay, lag) if has_memory else np.ones(1)
        noise = Noise(np.random.default_rng(seed), self.parameters["noise_correlation"])
        self.noise: Callable[[int], FloatArray] = noise.draw
        self.place(self.parameters["start_position"])

    def place(self, position: float, angle: float = 0.0) -> None:
        """Set the ball at rest at ``position`` (m), and the input path to a steady ``angle`` (rad)."""
        self.angle = angle
        self._ball = np.zeros(BALL_SIZE)
        self._ball[POSITION] = position
        self._memory = settled_path(angle, self._path)
        self._lagged = np.array([position])
        self._history = np.full(HISTORY, angle)
        self._newest = 0

    def step(self, angle: float) -> int:
        """Simulate a sample period in which the servo turns linearly to ``angle`` (rad); return the count."""
        self._run(np.array([angle]))
        return self.count()

    def count(self) -> int:
        """Sample the sensor again at the present time; return the count."""
        return int(self.sensor.counts(self._lagged, self.noise(1))[0])

    @property
    def position(self) -> float:
        """True position of the ball, m."""
        return float(self._ball[POSITION])

    @property
    def velocity(self) -> float:
        """True velocity of the ball, m/s."""
        return float(self._ball[VELOCITY])

    def simulate(self, angles: FloatArray) -> Trajectory:
        """Simulate with servo angles (n,), rad, at the samples; the first is now.

        A first angle that differs from the present one sets the input path to its steady state there.
        """
        if angles[0] != self.angle:
            self.angle = float(angles[0])
            self._memory = settled_path(self.angle, self._path)
            self._history[:] = self.angle
        first = np.array([[self._ball[POSITION], self._ball[VELOCITY], self._lagged[0]]])
        truth = np.concatenate([first, self._run(np.asarray(angles[1:], dtype=np.float64))])
        counts = self.sensor.counts(truth[:, 2], self.noise(len(truth)))
        return Trajectory(
            t=self.period * np.arange(len(truth), dtype=np.float64),
            counts=counts,
            measured=self.sensor.position(counts),
            position=truth[:, 0],
            velocity=truth[:, 1],
        )

    def _run(self, angles: FloatArray) -> FloatArray:
        """Simulate a sample period per angle; return true position, velocity and lagged position, (n, 3)."""
        out = np.empty((len(angles), 3))
        run(
            angles,
            self._ball,
            self._memory,
            self._lagged,
            self._history,
            self._newest,
            self._substeps,
            self.period,
            self.sensor.lag,
            self._mechanics,
            self._friction,
            self._path,
            out,
        )
        self._newest += len(angles)
        if len(angles):
            self.angle = float(angles[-1])
        return out


def substep_ends(delay: float, lag: float) -> FloatArray:
    """Return the ends of the substeps as shares of a sample period; one is at a corner of the delayed input.

    ``delay`` and ``lag`` are in sample periods.
    """
    delay_fraction = delay % 1.0
    wanted = SUBSTEPS_PER_LAG / lag if lag > 0.0 else 0.0
    count = math.ceil(min(max(wanted, MIN_SUBSTEPS), MAX_SUBSTEPS))
    ends = np.arange(1, count + 1) / count
    if np.min(np.abs(ends - delay_fraction)) < 1e-9 or delay_fraction < 1e-9:
        return ends
    return np.sort(np.append(ends, delay_fraction))


@compiled
def run(
    angles: FloatArray,
    ball: FloatArray,
    memory: FloatArray,
    lagged: FloatArray,
    history: FloatArray,
    newest: int,
    substeps: FloatArray,
    period: float,
    sensor_lag: float,
    m: Mechanics,
    f: Friction,
    p: InputPath,
    out: FloatArray,
) -> None:
    """Advance the whole plant by one sample period per angle, in place; see ``BallBeamPlant._run``.

    ``substeps`` are their ends as shares of the period. ``history[i % HISTORY]`` is the servo angle at
    sample i, up to ``newest``; ``memory`` is the way in's, its last entry the angle at the linkage;
    ``lagged`` (1,) is the sensor's.
    """
    for i in range(angles.size):
        newest += 1
        history[newest % HISTORY] = angles[i]
        previous_end = 0.0
        for substep_end in substeps:
            h = (substep_end - previous_end) * period
            previous_end = substep_end
            samples_back = p.delay / period + 1.0 - substep_end
            crank_before = memory[-1]
            before = ball[POSITION]
            crank_angle = pass_through(memory, read_delayed(history, newest, samples_back), h, p)
            move(ball, crank_before, crank_angle, h, m, f)
            lagged[0] = apply_lag(lagged[0], before, ball[POSITION], h, sensor_lag)
        out[i, 0], out[i, 1], out[i, 2] = ball[POSITION], ball[VELOCITY], lagged[0]
