"""The simulated ball and beam as a plant like the others: named signals, coloured noise, jitter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from labhil.errors import UsageError
from labhil.plants.ball_beam import SAMPLE_PERIOD, BallBeamPlant
from labhil.plants.ball_beam_definition import BALL_BEAM
from labhil.plants.trajectory import Noise, SampleTimes, Trajectory, random_generator
from labhil.signals import FloatArray


class BallBeamRig:
    """A :class:`BallBeamPlant` with named signals; the servo angle (rad) is linear between samples."""

    def __init__(
        self,
        parameters: Mapping[str, float] | None = None,
        terms: Iterable[str] = (),
        seed: int = 0,
        period: float = SAMPLE_PERIOD,
    ) -> None:
        self.terms = tuple(terms)
        self.parameters = p = BALL_BEAM.resolve(self.terms, parameters or {})
        self.period = period
        self.sample_times = SampleTimes(p, period, seed)
        self.plant = BallBeamPlant(parameters, self.terms, seed, period)
        self.plant.noise = Noise(random_generator(seed, "ball_position"), p["noise_correlation"]).draw
        self._uneven = p["stamp_jitter"] > 0.0
        self._time = 0.0

    @property
    def time(self) -> float:
        """Time since the start, s."""
        return self._time

    def step(self, angle: float) -> Mapping[str, float]:
        """Turn linearly to ``angle`` (rad) within a sample period; return the signals at its end."""
        self._advance_clock()
        return {"ball_position": self._position(np.array([self.plant.step(angle)]))[0]}

    def simulate(self, angle: FloatArray) -> Trajectory:
        """Simulate with servo angles (n,), rad, at the samples, linear in between; the first is now.

        A first angle that differs from the present one sets the input path to its steady state there.
        """
        u = np.asarray(angle, dtype=np.float64)
        if not len(u) or not np.all(np.isfinite(u)):
            raise UsageError("a simulation needs one finite value of its input at least, and no others")
        if self._uneven:
            return self._simulate_uneven(u)
        run = self.plant.simulate(u)
        self._time = float(self.sample_times.ends(self._time, len(u) - 1)[-1]) if len(u) > 1 else self._time
        truth = {"ball_position": run.position, "ball_velocity": run.velocity}
        return Trajectory(self.sample_times.recorded(run.t), u, {"ball_position": run.measured}, truth)

    def _simulate_uneven(self, u: FloatArray) -> Trajectory:
        start, plant = self._time, self.plant
        first = plant.simulate(u[:1])
        rows = [(0.0, first.measured[0], first.position[0], first.velocity[0])]
        for angle in u[1:]:
            self._advance_clock()
            measured = self._position(np.array([plant.step(float(angle))]))[0]
            rows.append((self._time - start, measured, plant.position, plant.velocity))
        t, measured, x, v = np.array(rows).T
        truth = {"ball_position": x, "ball_velocity": v}
        return Trajectory(self.sample_times.recorded(t), u, {"ball_position": measured}, truth)

    def _advance_clock(self) -> None:
        end = float(self.sample_times.ends(self._time, 1)[0])
        self.plant.period, self._time = end - self._time, end

    def _position(self, counts: FloatArray) -> FloatArray:
        return self.plant.sensor.position(np.asarray(counts, dtype=np.int64))
