"""A problem turns a model and a record into residuals and a Jacobian; estimators know only that.

Every window has an initial state of its own. Those states are nuisance: they are taken out of the
Jacobian window by window (Golub and Pereyra's projection), so that the part that is left is as wide
as the model has free parameters, however many windows there are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labhil.ending import checkpoint
from labhil.identify.rounding import effective_fractions
from labhil.identify.window_products import window_products, without_states
from labhil.identify.windows import noise_at
from labhil.physics.model import UNREAD, Model, PartlyLinear, Record, Windows
from labhil.signals import FloatArray, IntArray

STATE_STEP = 1e-5
WORST = 1e7


@dataclass(frozen=True, slots=True)
class Point:
    """Where an estimator stands: free parameters in units of their scale, and all windows' states."""

    z: FloatArray
    states: FloatArray


@dataclass(frozen=True, slots=True)
class Linearised:
    """Residuals (N·c,) in units of noise, the Jacobian by parameters (N·c, P) and by own states (N·c, S)."""

    residuals: FloatArray
    by_parameters: FloatArray
    by_states: FloatArray


def begins_among(record: Record, windows: Windows) -> tuple[int, ...]:
    """Which of the windows' rows are the first of a recording."""
    places = np.searchsorted(windows.rows, [begin.row for begin in record.begins])
    return tuple(sorted({0, *(int(place) for place in places if place < len(windows.rows))}))


class Problem:
    """Residuals of simulated windows against a record, in units of the noise.

    ``free`` (P,) are the places of the estimated parameters in the model's vector; ``base`` is that
    vector with everything else in place; ``sigma`` (channels,) the noise that residuals are divided by, and
    ``noise`` the same at the windows' rows, where recordings differ in it, (N, channels). ``begins`` are the
    rows of the windows (of samples, not of channels) at which a recording begins. A censored reading, one at
    the end of its range, leaves no residual where the simulation lies beyond that end; one that is ``UNREAD``
    leaves none anywhere.
    """

    def __init__(
        self,
        model: Model,
        record: Record,
        windows: Windows,
        free: IntArray,
        base: FloatArray,
        sigma: FloatArray,
    ) -> None:
        self.model = model
        self.record = record
        self.windows = windows
        self.free = free
        self.base = base
        self.sigma = sigma
        chosen = [model.parameters[i] for i in free]
        self.scale = np.array([p.scale for p in chosen])
        self.step = [p.step for p in chosen]
        self.lower = np.array([p.lower for p in chosen]) / self.scale
        self.upper = np.array([p.upper for p in chosen]) / self.scale
        self._linear = np.array([p.linear for p in chosen], dtype=bool)
        if self._linear.any() and not isinstance(model, PartlyLinear):
            self._linear[:] = False
        channels = record.outputs.shape[1]
        self.owner = np.repeat(windows.owner, channels)
        self.edges = np.flatnonzero(np.r_[True, np.diff(self.owner) > 0])
        self.begins = begins_among(record, windows)
        self.noise = noise_at(record, windows.rows, sigma)
        self.evaluations = 0
        self.guess = model.initial_states(record, windows)
        self._measured = record.outputs[windows.rows]
        self._censored = None if record.censored is None else record.censored[windows.rows]

    @cached_property
    def effective_fraction(self) -> FloatArray:
        """Share of an independent sample that each residual (N·c,) is worth: rounding may repeat itself."""
        return effective_fractions(self.record, self.sigma)[self.windows.rows].ravel()

    def of_windows(self, chosen: IntArray) -> Problem:
        """The same problem on some of its windows only."""
        spans = list(
            zip(self.windows.first[chosen].tolist(), self.windows.last[chosen].tolist(), strict=True)
        )
        return self.on_windows(Windows.of(spans))

    def on_windows(self, windows: Windows) -> Problem:
        """The same problem on other windows."""
        return Problem(self.model, self.record, windows, self.free, self.base, self.sigma)

    def pin(self, places: IntArray, theta: FloatArray) -> Problem:
        """The same problem with the free parameters at ``places`` held where the vector ``theta`` is."""
        others = np.delete(self.free, places)
        return Problem(self.model, self.record, self.windows, others, theta, self.sigma)

    def is_size(self, j: int) -> bool:
        """Whether free parameter ``j`` is a rig's own size that cannot be zero: a mass, a resistance."""
        return self.model.parameters[self.free[j]].term is None and bool(self.lower[j] > 0.0)

    def start(self) -> Point:
        """The base values, with initial states guessed from the measurement."""
        return Point(self.base[self.free] / self.scale, self.guess)

    def theta(self, z: FloatArray) -> FloatArray:
        """The model's whole vector for scaled free parameters ``z``."""
        theta = self.base.copy()
        theta[self.free] = z * self.scale
        return theta

    def residuals(self, point: Point) -> FloatArray:
        """(simulated − measured) / noise, (N·c,)."""
        return self.residuals_at(self.theta(point.z), point.states)

    def residuals_at(self, theta: FloatArray, states: FloatArray) -> FloatArray:
        """The same at a whole vector ``theta`` and the windows' ``states``, (N·c,)."""
        checkpoint()
        self.evaluations += 1
        # a plant that runs away is wrong by enough; its square must still be a number
        with np.errstate(over="ignore"):
            simulated = self.model.simulate(theta, self.record, self.windows, states)
            residuals = (simulated - self._measured) / self.noise
            if self._censored is not None:
                silent = (self._censored == UNREAD) | (self._censored * residuals > 0.0)
                residuals = np.where(silent, 0.0, residuals)
        residuals = np.clip(residuals.ravel(), -WORST, WORST)
        return np.where(np.isnan(residuals), WORST, residuals)

    def linearise(self, point: Point, residuals: FloatArray, *, central: bool = False) -> Linearised:
        """Differences of the simulation; ``central`` where the bounds leave room, else one-sided.

        The slopes by parameters that the model is linear in are its own, exact ones.
        """
        by_parameters = np.empty((residuals.size, len(self.free)))
        by_parameters[:, self._linear] = self._exact_slopes(point, residuals)
        for j in np.flatnonzero(~self._linear):
            by_parameters[:, j] = self._slope(point, residuals, int(j), central)
        return Linearised(residuals, by_parameters, self.state_slopes(point, residuals))

    def _exact_slopes(self, point: Point, residuals: FloatArray) -> FloatArray:
        """Slopes (N·c, L) by the free parameters that the model is linear in."""
        if not self._linear.any() or not isinstance(self.model, PartlyLinear):
            return np.empty((residuals.size, 0))
        keys = [self.model.parameters[i].key for i in self.free[self._linear]]
        outputs = self.record.outputs.shape
        regressor = self.model.regressor(self.theta(point.z), self.record, keys).reshape(*outputs, len(keys))
        slopes = regressor[self.windows.rows] * self.scale[self._linear]
        slopes /= np.broadcast_to(self.noise, slopes.shape[:2])[:, :, None]
        if self._censored is not None:
            beyond = (self._censored != 0) & (residuals.reshape(-1, outputs[1]) == 0.0)
            slopes = np.where(beyond[:, :, None], 0.0, slopes)
        return np.asarray(slopes.reshape(residuals.size, len(keys)))

    def state_slopes(self, point: Point, residuals: FloatArray, step: float = STATE_STEP) -> FloatArray:
        """Slopes of the residuals by each window's own state, in units of the states' scale (N·c, S)."""
        by_states = np.empty((residuals.size, point.states.shape[1]))
        for s, scale in enumerate(self.model.state_scale):
            states = point.states.copy()
            states[:, s] += step * scale
            by_states[:, s] = (self.residuals(Point(point.z, states)) - residuals) / step
        return by_states

    def flatter_state_slopes(self, point: Point, lin: Linearised) -> FloatArray:
        """Slopes by the states to the side on which the residuals of a window change less, (N·c, S).

        A part breaks away or stays where it is, and the best state is often at the edge between both. Data
        bound it there to one side as if they knew it exactly, and to the other leave it as it ever was.
        """
        behind = self.state_slopes(point, lin.residuals, -STATE_STEP)
        flatter = self.per_window(behind**2) < self.per_window(lin.by_states**2)
        return np.where(flatter[self.owner], behind, lin.by_states)

    def _slope(self, point: Point, residuals: FloatArray, j: int, central: bool) -> FloatArray:
        step = self.step[j] * max(1.0, abs(point.z[j]))
        up, down = point.z.copy(), point.z.copy()
        up[j] += step
        down[j] -= step
        if up[j] > self.upper[j]:
            return (residuals - self.residuals(Point(down, point.states))) / step
        above = self.residuals(Point(up, point.states))
        if not central or down[j] < self.lower[j]:
            return (above - residuals) / step
        return (above - self.residuals(Point(down, point.states))) / (2.0 * step)

    def per_window(self, rows: FloatArray) -> FloatArray:
        """Sum rows (N·c, …) within each window, (W, …)."""
        return np.add.reduceat(rows, self.edges, axis=0)

    def products(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Inner products of columns (N·c, S) with others (N·c, K) within each window, (W, S, K)."""
        return window_products(left, right, self.edges)

    def state_gram(self, by_states: FloatArray, damping: FloatArray | None = None) -> FloatArray:
        """AᵀA of each window's own states (W, S, S), damped; invertible even where a state has no effect."""
        gram = self.products(by_states, by_states)
        if not by_states.shape[1]:
            return gram
        diagonal = np.einsum("wss->ws", gram)
        if damping is not None:
            diagonal *= 1.0 + damping[:, None]
        diagonal += 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-12
        return gram

    def project(self, lin: Linearised, columns: FloatArray, damping: float = 0.0) -> FloatArray:
        """Take out of ``columns`` (N·c, k) what the windows' own states, so much damped, could explain."""
        return self.beside(lin.by_states, columns, damping)

    def beside(self, by_states: FloatArray, columns: FloatArray, damping: float = 0.0) -> FloatArray:
        """The same with these slopes (N·c, S) by the states."""
        if not by_states.shape[1]:
            return columns
        gram = self.state_gram(by_states, np.full(len(self.edges), damping))
        share = np.linalg.solve(gram, self.products(by_states, columns))
        return without_states(columns, by_states, np.asarray(share, dtype=np.float64), self.edges)
