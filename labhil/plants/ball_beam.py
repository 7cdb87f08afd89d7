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
    LIMITED,
    MAX_DELAY_SAMPLES,
    TIME_TOLERANCE,
    InputPath,
    add_command,
    apply_lag,
    delayed_command,
    pass_through,
)
from labhil.plants.sensor import Sensor
from labhil.plants.trajectory import Noise
from labhil.signals import FloatArray, IntArray

SAMPLE_PERIOD = 0.01
MIN_SUBSTEPS = 50
"""Substeps of a sample period where the actuator or the sensor has a lag, at least.

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
        if self._path.delay > MAX_DELAY_SAMPLES * period:
            raise UsageError(f"time_delay.delay is too long for a sample period of {period:g} s")
        self._substeps = substeps_per_period(self._path.lag / period, self.sensor.lag / period)
        noise = Noise(np.random.default_rng(seed), self.parameters["noise_correlation"])
        self.noise: Callable[[int], FloatArray] = noise.draw
        self.place(self.parameters["start_position"])

    def place(self, position: float, angle: float = 0.0) -> None:
        """Set the ball at rest at ``position`` (m), and the input path to a steady ``angle`` (rad)."""
        self._ball = np.zeros(BALL_SIZE)
        self._ball[POSITION] = position
        self._lagged = np.array([position])
        self._settle(angle)

    def _settle(self, angle: float) -> None:
        """Set the input path to its steady state at ``angle`` (rad), in the middle of the backlash."""
        self.angle = angle
        self._memory = np.array([angle, angle])
        unlimited = self._path._replace(rate=math.inf)
        self._crank = np.array([pass_through(self._memory, (angle, 0.0, math.inf), unlimited)[0]])
        self._clock, self._counters = np.zeros(1), np.zeros(2, dtype=np.int64)
        self._times, self._angles = np.zeros(HISTORY), np.full(HISTORY, angle)

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
            self._settle(float(angles[0]))
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
            self._crank,
            self._lagged,
            self._clock,
            self._times,
            self._angles,
            self._counters,
            self._memory,
            self._substeps,
            self.period,
            self.sensor.lag,
            self._mechanics,
            self._friction,
            self._path,
            out,
        )
        if len(angles):
            self.angle = float(angles[-1])
        return out


def substeps_per_period(actuator_lag: float, sensor_lag: float) -> int:
    """Return the number of substeps of a sample period, 1 without a lag; lags are in sample periods."""
    if actuator_lag == sensor_lag == 0.0:
        return 1
    wanted = SUBSTEPS_PER_LAG / actuator_lag if actuator_lag > 0.0 else 0.0
    return math.ceil(min(max(wanted, MIN_SUBSTEPS), MAX_SUBSTEPS))


@compiled
def run(
    angles: FloatArray,
    ball: FloatArray,
    crank: FloatArray,
    lagged: FloatArray,
    clock: FloatArray,
    times: FloatArray,
    values: FloatArray,
    counters: IntArray,
    memory: FloatArray,
    substeps: int,
    period: float,
    sensor_lag: float,
    m: Mechanics,
    f: Friction,
    p: InputPath,
    out: FloatArray,
) -> None:
    """Advance the whole plant by one sample period per angle, in place; see ``BallBeamPlant._run``.

    ``crank`` (1,) is the angle at the linkage, ``lagged`` (1,) the position behind the sensor's lag and
    ``clock`` (1,) the time; ``times``, ``values``, ``counters`` and ``memory`` are those of the input path.
    Between two corners of the path the linkage turns straight, in ``substeps`` per period with a lag.
    """
    tolerance_s = TIME_TOLERANCE * period
    for i in range(angles.size):
        t, end = clock[0], clock[0] + period
        add_command(times, values, counters, end, angles[i])
        while end - t > tolerance_s:
            segment = delayed_command(times, values, counters, t, p.delay, tolerance_s, False)
            angle, slope, remaining = pass_through(memory, segment, p)
            lasts = max(min(remaining, end - t), tolerance_s)
            pieces = max(math.ceil(lasts / period * substeps - TIME_TOLERANCE), 1)
            h = lasts / pieces
            for piece in range(pieces):
                before, position = angle + piece * h * slope, ball[POSITION]
                turned = apply_lag(crank[0], before, before + h * slope, h, p.lag)
                move(ball, crank[0], turned, h, m, f)
                crank[0] = turned
                lagged[0] = apply_lag(lagged[0], position, ball[POSITION], h, sensor_lag)
            memory[LIMITED] += lasts * slope
            t += lasts
        clock[0] = end
        out[i, 0], out[i, 1], out[i, 2] = ball[POSITION], ball[VELOCITY], lagged[0]
