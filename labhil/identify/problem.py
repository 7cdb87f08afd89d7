"""The estimation problem: residuals and Jacobian of a model that is simulated over windows of a record.

Every window has an initial state of its own. These states are nuisance parameters: variable projection
(Golub and Pereyra 1973) takes them out of the Jacobian window by window, so that its width is the number of
free parameters, however many windows there are. Estimators (``least_squares``, ``estimators``) see only this.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from labhil.cores import cores, side_by_side
from labhil.ending import checkpoint
from labhil.identify.rounding import effective_fractions
from labhil.identify.window_products import window_products, without_states
from labhil.identify.windows import noise_at
from labhil.physics.model import Model, PartlyLinear, ReleasesInterpreter
from labhil.physics.record import UNREAD, Record, Windows
from labhil.signals import BoolArray, FloatArray, IntArray

Item = TypeVar("Item")
Result = TypeVar("Result")

STATE_STEP = 1e-5
"""Step of the finite differences by initial states, in units of the states' scale."""

MAX_FACTOR = 3.0
"""Largest factor by which a step changes a positive constant."""

MIN_SAMPLES_PER_CORE = 5_000
"""Fewest samples that are worth a core of their own: they take some 0.2 ms, and handing them over 0.05 ms."""

MAX_RESIDUAL = 1e7
"""Size, in units of noise, at which residuals are clipped: their squares stay finite numbers."""


@dataclass(frozen=True, slots=True)
class Point:
    """Values of everything that is estimated.

    Attributes:
        z: (P,) free parameters in units of their scale.
        states: (W, S) initial state of each window, SI units.
    """

    z: FloatArray
    states: FloatArray


@dataclass(frozen=True, slots=True)
class Linearised:
    """A problem to first order around a point.

    Attributes:
        residuals: (N·c,) in units of noise.
        by_parameters: (N·c, P) slopes of the residuals by the scaled free parameters.
        by_states: (N·c, S) slopes of the residuals by the initial state of their own window, in units of the
            states' scale.
    """

    residuals: FloatArray
    by_parameters: FloatArray
    by_states: FloatArray

    def without(self, places: IntArray) -> Linearised:
        """The same with the free parameters at these places (K,) held."""
        return replace(self, by_parameters=np.delete(self.by_parameters, places, axis=1))


def recording_starts(record: Record, windows: Windows) -> tuple[int, ...]:
    """Find the rows of the windows at which a recording begins.

    Args:
        record: One recording or several in a row.
        windows: Windows of it, with n rows in all.

    Returns:
        Indices among the n rows, in rising order; the first is 0.
    """
    places = np.searchsorted(windows.rows, [begin.row for begin in record.begins])
    return tuple(sorted({0, *(int(place) for place in places if place < len(windows.rows))}))


def evenly_spread(n: int, count: int) -> IntArray:
    """At most ``count`` of the indices below ``n``, evenly spread.

    Example:
        >>> evenly_spread(9, 3).tolist()
        [0, 4, 8]
    """
    return np.unique(np.linspace(0, n - 1, min(count, n)).round().astype(np.int64))


class Problem:
    """Residuals of simulated windows against a record, in units of the noise.

    N is the number of samples in all W windows, c the number of output channels, P the number of free
    parameters and S that of states. Arrays (N·c,) hold the channels of one sample after the other.

    A censored reading, one at the end of its range, has the residual zero where the simulation lies beyond
    that end; a reading that is ``UNREAD`` always has the residual zero.

    Args:
        model: What is simulated.
        record: What was measured.
        windows: The windows of the record that are simulated.
        free: (P,) indices of the estimated parameters in the model's parameter vector.
        base: The model's parameter vector, which holds the values of all parameters that are not estimated.
        sigma: (c,) standard deviation of the noise of each channel, in the channel's unit.

    Attributes:
        scale: (P,) typical size of each free parameter, SI units.
        lower: (P,) lower bounds in units of ``scale``; ``upper`` the upper ones.
        owner: (N·c,) index of the window that a residual belongs to.
        edges: (W,) first residual of each window.
        begins: Rows of the windows (samples, not channels) at which a recording begins.
        noise: (c,), or (N, c) where recordings differ in their noise: ``sigma`` at the windows' rows.
        guess: (W, S) initial states guessed from the measurement.
        evaluations: Number of simulations so far.
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
        self.base = base
        self.sigma = sigma
        self.evaluations = 0
        self._set_free(free)
        self._set_windows(windows)
        self.guess = model.initial_states(record, windows)

    def _set_free(self, free: IntArray) -> None:
        """Estimate the parameters of these indices."""
        self.free = free
        chosen = [self.model.parameters[i] for i in free]
        self.scale = np.array([p.scale for p in chosen])
        self.step = [p.step for p in chosen]
        self.lower = np.array([p.lower for p in chosen]) / self.scale
        self.upper = np.array([p.upper for p in chosen]) / self.scale
        self._positive = np.array([p.is_positive for p in chosen], dtype=bool)
        self._linear = np.array([p.linear for p in chosen], dtype=bool)
        if self._linear.any() and not isinstance(self.model, PartlyLinear):
            self._linear[:] = False

    def _set_windows(self, windows: Windows) -> None:
        """Take everything but the guessed states from these windows of the record."""
        record = self.record
        self.windows = windows
        parallel = cores() if isinstance(self.model, ReleasesInterpreter) else 1
        count = min(parallel, len(windows.rows) // MIN_SAMPLES_PER_CORE)
        self._parts = windows.split(count) if count > 1 else []
        self.owner = np.repeat(windows.owner, record.outputs.shape[1])
        self.edges = np.flatnonzero(np.r_[True, np.diff(self.owner) > 0])
        self.begins = recording_starts(record, windows)
        self.noise = noise_at(record, windows.rows, self.sigma)
        self._measured = record.outputs[windows.rows]
        self._censored = None if record.censored is None else record.censored[windows.rows]

    @cached_property
    def effective_fraction(self) -> FloatArray:
        """Share of an independent sample that each residual (N·c,) is worth; rounding errors may repeat."""
        return effective_fractions(self.record, self.sigma)[self.windows.rows].ravel()

    def select_windows(self, chosen: IntArray) -> Problem:
        """The same problem on some of its windows only, by their indices (K,)."""
        part = copy(self)
        part.__dict__.pop("effective_fraction", None)
        part._set_windows(self.windows.select(chosen))
        part.guess = self.guess[chosen]
        return part

    def on_some_windows(self, count: int) -> Problem:
        """The same problem on at most ``count`` of its windows, evenly spread."""
        return self.select_windows(evenly_spread(len(self.windows), count))

    def without_guess(self, windows: Windows) -> Problem:
        """The same problem on other windows of its record, whose initial states are not guessed."""
        part = copy(self)
        part.__dict__.pop("effective_fraction", None)
        part._set_windows(windows)
        part.guess = np.empty((0, self.guess.shape[1]))
        return part

    def with_windows(self, windows: Windows) -> Problem:
        """The same problem on other windows of its record."""
        return Problem(self.model, self.record, windows, self.free, self.base, self.sigma)

    def pin(self, places: IntArray, theta: FloatArray) -> Problem:
        """The same problem with some free parameters held constant.

        Args:
            places: Indices of these among the free parameters.
            theta: The model's parameter vector with the values that they are held at.
        """
        pinned = copy(self)
        pinned.base = theta
        pinned.evaluations = 0
        pinned._set_free(np.delete(self.free, places))
        return pinned

    def is_positive_constant(self, j: int) -> bool:
        """Whether free parameter ``j`` is a size that cannot be zero: a mass, a resistance."""
        return bool(self._positive[j])

    def reach(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bounds (P,) of one step from scaled parameters ``z`` (P,).

        A positive constant (a mass, a length) changes by a factor of ``MAX_FACTOR`` at most: the model
        depends on its inverse, too, of which a straight line knows nothing.
        """
        lower, upper, positive = self.lower.copy(), self.upper.copy(), self._positive
        lower[positive] = np.maximum(lower[positive], z[positive] / MAX_FACTOR)
        upper[positive] = np.minimum(upper[positive], z[positive] * MAX_FACTOR)
        return lower, upper

    def stepped(self, z: FloatArray, step: FloatArray) -> FloatArray:
        """Scaled parameters (P,) after a ``step`` (P,) from ``z`` (P,), within the bounds.

        Positive constants change by a factor, as all products of their powers then do.
        """
        moved, positive = z + step, self._positive
        moved[positive] = z[positive] * np.exp(step[positive] / z[positive])
        lower, upper = self.reach(z)
        return np.clip(moved, lower, upper)

    def start(self) -> Point:
        """The point of the base values, with initial states guessed from the measurement."""
        return Point(self.base[self.free] / self.scale, self.guess)

    def theta(self, z: FloatArray) -> FloatArray:
        """The model's parameter vector (SI units) for scaled free parameters ``z`` (P,)."""
        theta = self.base.copy()
        theta[self.free] = z * self.scale
        return theta

    def residuals(self, point: Point) -> FloatArray:
        """(simulated − measured) / noise at a point, (N·c,)."""
        return self.residuals_at(self.theta(point.z), point.states)

    def residuals_at(self, theta: FloatArray, states: FloatArray) -> FloatArray:
        """(simulated − measured) / noise for a parameter vector ``theta`` and ``states`` (W, S), (N·c,)."""
        checkpoint()
        self.evaluations += 1
        # a simulation may diverge
        with np.errstate(over="ignore"):
            simulated = self._simulate(theta, states)
            residuals = (simulated - self._measured) / self.noise
            if self._censored is not None:
                uninformative = (self._censored == UNREAD) | (self._censored * residuals > 0.0)
                residuals = np.where(uninformative, 0.0, residuals)
        residuals = np.clip(residuals.ravel(), -MAX_RESIDUAL, MAX_RESIDUAL)
        return np.where(np.isnan(residuals), MAX_RESIDUAL, residuals)

    def _simulate(self, theta: FloatArray, states: FloatArray) -> FloatArray:
        """Simulate all windows, which are independent of each other, on all cores: (N, c)."""
        model, record = self.model, self.record
        if len(self._parts) < 2:
            return model.simulate(theta, record, self.windows, states)

        def simulate(part: tuple[slice, Windows]) -> FloatArray:
            chosen, windows = part
            return model.simulate(theta, record, windows, states[chosen])

        parts = side_by_side(simulate, self._parts)
        return np.concatenate(list(parts))

    def side_by_side(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterable[Result]:
        """What ``function`` makes of each item with this problem or one of its size, in their order.

        On all cores, if simulations do not take these themselves.
        """
        return map(function, items) if self._parts else side_by_side(function, items)

    def linearise(self, point: Point, residuals: FloatArray, *, central: bool = False) -> Linearised:
        """Linearise the residuals by finite differences, or exactly by parameters that are linear.

        Args:
            point: Where.
            residuals: (N·c,) those at ``point``.
            central: Take central differences by parameters where the bounds leave room, else one-sided.
        """
        by_parameters = np.empty((residuals.size, len(self.free)))
        by_parameters[:, self._linear] = self._exact_slopes(point, residuals)
        for j in np.flatnonzero(~self._linear):
            by_parameters[:, j] = self._slope(point, residuals, int(j), central)
        return Linearised(residuals, by_parameters, self.state_slopes(point, residuals))

    def _exact_slopes(self, point: Point, residuals: FloatArray) -> FloatArray:
        """Slopes (N·c, L) by the free parameters that the outputs are linear in."""
        if not self._linear.any() or not isinstance(self.model, PartlyLinear):
            return np.empty((residuals.size, 0))
        keys = [self.model.parameters[i].key for i in self.free[self._linear]]
        outputs = self.record.outputs.shape
        regressor = self.model.regressor(self.theta(point.z), self.record, keys).reshape(*outputs, len(keys))
        slopes = regressor[self.windows.rows] * self.scale[self._linear]
        slopes /= np.broadcast_to(self.noise, slopes.shape[:2])[:, :, None]
        if self._censored is not None:
            uninformative = (self._censored != 0) & (residuals.reshape(-1, outputs[1]) == 0.0)
            slopes = np.where(uninformative[:, :, None], 0.0, slopes)
        return np.asarray(slopes.reshape(residuals.size, len(keys)))

    def state_slopes(
        self,
        point: Point,
        residuals: FloatArray,
        step: float = STATE_STEP,
        *,
        varied: BoolArray | None = None,
    ) -> FloatArray:
        """Slopes (N·c, S) of the residuals by the initial state of their window, by forward differences.

        Args:
            point: Where.
            residuals: (N·c,) those at ``point``.
            step: In units of the states' scale; negative for backward differences.
            varied: (S,), the states that may vary; the slopes by the others are 0. None for all.
        """
        by_states = np.zeros((residuals.size, point.states.shape[1]))
        for s in range(point.states.shape[1]) if varied is None else np.flatnonzero(varied):
            scale, states = self.model.state_scale[s], point.states.copy()
            states[:, s] += step * scale
            by_states[:, s] = (self.residuals(Point(point.z, states)) - residuals) / step
        return by_states

    def flatter_state_slopes(self, point: Point, lin: Linearised) -> FloatArray:
        """Take each window's one-sided slopes by its state on the side where the residuals change less.

        With dry friction the best state is often at the edge between sticking and sliding. On one side of it
        the residuals jump, as if the data determined the state exactly; on the other they hardly change.

        Returns:
            (N·c, S) slopes, in units of the states' scale.
        """
        backward = self.state_slopes(point, lin.residuals, -STATE_STEP)
        is_flatter = self.per_window(backward**2) < self.per_window(lin.by_states**2)
        return np.where(is_flatter[self.owner], backward, lin.by_states)

    def _slope(self, point: Point, residuals: FloatArray, j: int, central: bool) -> FloatArray:
        """Slope (N·c,) by the scaled free parameter ``j``, from differences within its bounds."""
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
        """Normal matrices AᵀA of the windows' states, (W, S, S).

        The diagonal is raised slightly, so that they are invertible even where a state has no effect.

        Args:
            by_states: (N·c, S) slopes A by the states.
            damping: (W,) by which the diagonal is raised relatively (Levenberg and Marquardt); None for none.
        """
        gram = self.products(by_states, by_states)
        if not by_states.shape[1]:
            return gram
        diagonal = np.einsum("wss->ws", gram)
        if damping is not None:
            diagonal *= 1.0 + damping[:, None]
        diagonal += 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-12
        return gram

    def project(self, lin: Linearised, columns: FloatArray, damping: float = 0.0) -> FloatArray:
        """Project the windows' initial states of a linearised problem out of ``columns`` (N·c, k)."""
        return self.project_out_states(lin.by_states, columns, damping)

    def project_out_states(
        self, by_states: FloatArray, columns: FloatArray, damping: float = 0.0
    ) -> FloatArray:
        """Subtract from columns their least-squares fit by the windows' initial states.

        Args:
            by_states: (N·c, S) slopes by the states.
            columns: (N·c, k).
            damping: By which the states' normal matrices are damped, relative to their diagonals.

        Returns:
            The residual columns, (N·c, k).
        """
        if not by_states.shape[1]:
            return columns
        gram = self.state_gram(by_states, np.full(len(self.edges), damping))
        coefficients = np.linalg.solve(gram, self.products(by_states, columns))
        return without_states(columns, by_states, np.asarray(coefficients, dtype=np.float64), self.edges)
