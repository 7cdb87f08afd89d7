"""Start values for a periodic force (cogging torque, for example) by a scan over its spatial order.

The cost has a local minimum at every other multiple of one over the distance travelled, so a few starts miss
the right one. The scan computes for every order, by linear least squares on the residuals of a fit, how much
of them the sine and cosine of this order would explain. Fits begin at the best orders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np

from labhil.identify.fitted import Fitted
from labhil.identify.problem import Point, Problem
from labhil.identify.projection import ProjectedResiduals
from labhil.identify.quantiser import converter_step
from labhil.identify.transitions import Transitions
from labhil.physics.driven import SENSOR_LAG, apply_sensor_lag
from labhil.physics.model import index_of, starts_of, terms_named
from labhil.physics.terms import TWO_WAVES, Parameter, Term
from labhil.signals import FloatArray

Starts = list[dict[str, float]]

_cached_starts: WeakKeyDictionary[Problem, dict[str, Starts]] = WeakKeyDictionary()
"""Starts by term of each fitted problem: a search needs them with each rival and in each pair of terms."""


@dataclass(frozen=True, slots=True)
class OrderScanOptions:
    """Options of a scan over orders.

    Attributes:
        phase_step_in_rad: change of the phase at the far end of the travel from one order to the next.
        sampled_share: share of the moving samples between which the phase of the highest order turns by less
            than half a wave.
        min_wave_in_steps: smallest length of a wave in steps of the coordinate's converter: rounding repeats
            with the step and looks like a force.
        max_orders: largest number of orders in a scan, the lowest ones.
        max_travel_in_spans: travel over the median span of a window from which each window has its own phase
            in a first scan.
        proposed: number of orders at which fits begin.
        amplitude_in_scales: amplitude of the simulated waves, in scales of their parameters.
        order_of_constant: an order whose waves are constant over any travel, in its scale.
    """

    phase_step_in_rad: float = 2.0
    sampled_share: float = 0.5
    min_wave_in_steps: float = 5.0
    max_orders: int = 150
    max_travel_in_spans: float = 5.0
    proposed: int = 3
    amplitude_in_scales: float = 0.1
    order_of_constant: float = 1e-9


def starts_for_added_terms(fitted: Fitted, added: Sequence[str]) -> Starts:
    """Start values for a refit with further terms, periodic terms at the orders that explain most.

    Args:
        fitted: a fit, as a rule without these terms.
        added: keys of the terms to add.

    Returns:
        Sets of values by parameter key.
    """
    model = fitted.problem.model
    terms = terms_named(model, added)
    sets = starts_of(model, terms, fitted.problem.record)
    for term in terms:
        if term.order is not None and model.state_names:
            best, *others = wave_starts(fitted, term, term.order) or [{}]
            sets = [*({**values, **best} for values in sets), *({**sets[0], **other} for other in others)]
    return [dict(items) for items in dict.fromkeys(tuple(values.items()) for values in sets)]


def scan_orders(fitted: Fitted, order: Parameter) -> FloatArray:
    """Orders of a fitted periodic term that explain most of the residuals without it.

    Args:
        fitted: a fit with the term.
        order: the parameter that is the term's order.

    Returns:
        Orders, the best one first.
    """
    term = fitted.problem.model.terms[order.term or ""]
    return np.array([values[order.key] for values in wave_starts(fitted, term, order)])


def wave_starts(fitted: Fitted, term: Term, order: Parameter) -> Starts:
    """Start values of a periodic term at the orders that explain most of a fit's residuals.

    Args:
        fitted: a fit; where it has the term, this is taken out of it as it is.
        term: the periodic term.
        order: its parameter that is the order.

    Returns:
        Values by key for each proposed order, the best one first; cached for each fit.
    """
    cached = _cached_starts.setdefault(fitted.problem, {})
    if term.key not in cached:
        cached[term.key] = _scan(fitted, term, order)
    return cached[term.key]


def _scan(fitted: Fitted, term: Term, order: Parameter) -> Starts:
    """Scan all orders of a term."""
    scan = OrderScan.of(_without(fitted, term, order) if term.key in fitted.terms else fitted, term, order)
    keys = [p.key for p in scan.waves]
    return [{order.key: k, **dict(zip(keys, sizes, strict=True))} for k, sizes in scan.best()]


def _without(fitted: Fitted, term: Term, order: Parameter) -> Fitted:
    """The fit with the amplitudes of a term at zero and all else as it is."""
    problem, places = fitted.problem, index_of(fitted.problem.model.parameters)
    theta = fitted.theta.copy()
    theta[[places[p.key] for p in term.parameters if p is not order]] = 0.0
    point = Point(theta[problem.free] / problem.scale, fitted.solution.point.states)
    solution = replace(fitted.solution, point=point, residuals=problem.residuals(point))
    return replace(fitted, theta=theta, solution=solution)


@dataclass(frozen=True, slots=True)
class OrderScan:
    """A scan over the orders of a periodic force.

    Attributes:
        unexplained: residuals of a fit without the force.
        order: the order's parameter.
        waves: parameters of the sine and the cosine.
        coordinate: (N,), the coordinate that the force depends on.
        transitions: the fit to first order, with the amplitude of the cosine as the unit of force, ahead of a
            lag of the sensor; None where the model remembers more than its states and that lag: then each
            order is simulated.
        lag: time constant of the sensor of the first output, s; 0 for none.
        options: options of the scan.
    """

    unexplained: ProjectedResiduals
    order: Parameter
    waves: list[Parameter]
    coordinate: FloatArray
    transitions: Transitions | None
    lag: float
    options: OrderScanOptions

    @classmethod
    def of(cls, fitted: Fitted, term: Term, order: Parameter) -> OrderScan:
        """Prepare a scan.

        Args:
            fitted: a fit without the term, or with it at zero.
            term: the periodic term.
            order: its parameter that is the order.
        """
        options, problem, states = OrderScanOptions(), fitted.problem, fitted.solution.point.states
        along = problem.model.coordinates(fitted.theta, problem.record, problem.windows, states)
        waves = [p for p in term.parameters if p is not order]
        prompt, constant = fitted.theta.copy(), _constant_force(fitted, order, waves, options)
        place = index_of(problem.model.parameters).get(SENSOR_LAG)
        lag = 0.0 if place is None else float(prompt[place])
        if place is not None:
            prompt[place] = constant[place] = 0.0
        return cls(
            ProjectedResiduals.of(fitted), order, waves, along[order.waves_over],
            Transitions.of(problem, prompt, states, constant), lag, options,
        )  # fmt: skip

    def best(self) -> list[tuple[float, list[float]]]:
        """Find the orders that explain most.

        Where a window spans only a small part of the travel, a first scan on a coarse grid gives each window
        its own phase. Orders around its peaks are then scanned on a fine grid with one phase for all.

        Returns:
            Orders with the amplitudes of their waves, the best one first.
        """
        turn = self.options.phase_step_in_rad
        fine, coarse = turn / max(float(np.ptp(self.coordinate)), 1e-12), turn / self._span()
        if coarse < self.options.max_travel_in_spans * fine:
            return self._peaks(self._order_grid(fine), one_phase=True)
        peaks = [k for k, _ in self._peaks(self._order_grid(coarse), one_phase=False)]
        orders = [np.r_[k, np.arange(max(k - coarse, self._lowest()), k + coarse, fine)] for k in peaks]
        return self._peaks(np.unique(np.concatenate([[], *orders])), one_phase=True)

    def _order_grid(self, step: float) -> FloatArray:
        """Orders in steps of ``step``, up to the highest one that the samples resolve."""
        windows = self.unexplained.fitted.problem.windows
        steps = np.abs(np.diff(self.coordinate))[np.diff(windows.owner) == 0]
        if not steps.any():
            return np.empty(0)
        moving = float(np.quantile(steps[steps > 0.0], self.options.sampled_share))
        high = min(np.pi / moving, self._highest())
        low = self._lowest()
        return np.arange(low, min(self.order.upper, high, low + self.options.max_orders * step), step)

    def _lowest(self) -> float:
        """The lowest order with two waves in the travel."""
        return max(self.order.lower, TWO_WAVES / max(float(np.ptp(self.coordinate)), 1e-12))

    def _highest(self) -> float:
        """The highest order whose waves are long enough in steps of the coordinate's converter."""
        record = self.unexplained.fitted.problem.record
        read = [j for j, name in enumerate(record.output_names) if name == self.order.waves_over]
        steps = [converter_step(record.outputs[:, j]) for j in read]
        return 2.0 * np.pi / (self.options.min_wave_in_steps * max(*steps, 1e-300)) if steps else np.inf

    def _span(self) -> float:
        """Median span of the coordinate in a window."""
        problem = self.unexplained.fitted.problem
        edges = problem.edges // len(problem.sigma)
        spans = np.maximum.reduceat(self.coordinate, edges) - np.minimum.reduceat(self.coordinate, edges)
        return max(float(np.median(spans)), 1e-12)

    def _peaks(self, orders: FloatArray, *, one_phase: bool) -> list[tuple[float, list[float]]]:
        """The highest local maxima over ascending orders, highest first, with amplitudes of the waves."""
        fits = [self._fit_order(float(k), one_phase=one_phase) for k in orders]
        explained = np.array([-np.inf, *(squares for squares, _ in fits), -np.inf])
        peaks = np.flatnonzero((explained[1:-1] >= explained[:-2]) & (explained[1:-1] > explained[2:]))
        highest = peaks[np.argsort(-explained[1:-1][peaks])][: self.options.proposed]
        return [(float(orders[i]), fits[i][1]) for i in highest]

    def _fit_order(self, order: float, *, one_phase: bool) -> tuple[float, list[float]]:
        """Sum of squares that the waves of one order explain, and their amplitudes."""
        unexplained, problem = self.unexplained, self.unexplained.fitted.problem
        both = self.responses(order)
        if one_phase:
            both = unexplained.project_out_all(both)
            gram, gradient = (both.T @ both)[None], (both.T @ unexplained.target)[None]
        else:
            both = unexplained.project_out_states(both)
            gram = problem.products(both, both)
            gradient = problem.products(both, unexplained.target[:, None])[:, :, 0]
        gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(len(self.waves)) + 1e-300
        sizes = np.linalg.solve(gram, gradient[:, :, None])[:, :, 0]
        explained = float(np.sum(sizes * gradient))
        small = self.options.amplitude_in_scales
        return explained, (-small * sizes[0] * [wave.scale for wave in self.waves]).tolist()

    def responses(self, order: float) -> FloatArray:
        """Changes of the residuals (N·c, 2) by the sine and the cosine of one order."""
        if self.transitions is not None:
            return self._behind_sensor(self.transitions.respond(self._mean_waves(order)))
        places, columns = index_of(self.unexplained.fitted.problem.model.parameters), []
        for wave in self.waves:
            theta = self.unexplained.fitted.theta.copy()
            theta[places[self.order.key]] = order
            theta[places[wave.key]] = self.options.amplitude_in_scales * wave.scale
            columns.append(self.unexplained.residual_change(theta))
        return np.column_stack(columns)

    def _behind_sensor(self, changes: FloatArray) -> FloatArray:
        """Changes (N·c, k) of the residuals as the sensor of the first output shows them."""
        if not self.lag:
            return changes
        problem = self.unexplained.fitted.problem
        rows = changes.reshape(len(problem.windows.rows), -1, changes.shape[1])
        noise = np.broadcast_to(problem.noise, rows.shape[:2])[:, 0]
        for column in rows[:, 0].T:
            shown = apply_sensor_lag(problem.record, problem.windows, column * noise, self.lag)
            column[:] = shown / noise
        return rows.reshape(changes.shape)

    def _mean_waves(self, order: float) -> FloatArray:
        """Means (N, 2) of sine and cosine over the steps to samples, in units of the cosine's amplitude."""
        before = np.concatenate([self.coordinate[:1], self.coordinate[:-1]])
        middle, half = 0.5 * order * (self.coordinate + before), 0.5 * order * (self.coordinate - before)
        waves = np.column_stack([np.sin(middle), np.cos(middle)]) * np.sinc(half / np.pi)[:, None]
        return waves * np.array([wave.scale for wave in self.waves]) / self.waves[1].scale


def _constant_force(
    fitted: Fitted, order: Parameter, waves: Sequence[Parameter], options: OrderScanOptions
) -> FloatArray:
    """Values of the model's parameters with a cosine so long that it is constant."""
    theta, places = fitted.theta.copy(), index_of(fitted.problem.model.parameters)
    theta[places[order.key]] = options.order_of_constant * order.scale
    theta[places[waves[1].key]] = options.amplitude_in_scales * waves[1].scale
    return theta
