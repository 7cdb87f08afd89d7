"""At which orders (waves along a coordinate) the fit of a force that repeats along the way may begin.

The cost has a valley at every other multiple of one over the distance travelled, so no ladder of starts finds
the right one: what the two waves of an order would explain is projected for every order before any refit.
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
from labhil.physics.model import index_of, starts_of, terms_named
from labhil.physics.terms import TWO_WAVES, Parameter, Term
from labhil.signals import FloatArray

TURN = 2.0
"""Radians by which the phase at the far end of the way changes from one order that is tried to the next."""

SLOW = 0.5
"""Share of the samples that have to show an order: its phase turns by less than half a wave in between."""

STEPS = 5.0
"""Steps of its converter that a wave of a reading must span: rounding repeats with the step and is none."""

MOST = 150
"""Orders that are tried at most, the lowest ones."""

FEW = 5.0
"""Times that the way is longer than what windows see of it, from which they have phases of their own."""

PROPOSED = 3
"""Orders at which fits begin."""

SMALL = 0.1
"""Size of the waves that are tried, in their scales."""

Starts = list[dict[str, float]]

_known: WeakKeyDictionary[Problem, dict[str, Starts]] = WeakKeyDictionary()
"""Starts by term of each fit: a search needs the same ones beside each rival and in each pair."""


def starts_beside(fitted: Fitted, group: Sequence[str]) -> Starts:
    """Sets of values by key from which a fit may begin that has an absent group of terms as well.

    An order begins where it promises most beside the fit, with its waves as large as they promise.
    """
    model = fitted.problem.model
    terms = terms_named(model, group)
    sets = starts_of(model, terms, fitted.problem.record)
    for term in terms:
        if term.order is not None and model.state_names:
            best, *others = wave_starts(fitted, term, term.order) or [{}]
            sets = [*({**values, **best} for values in sets), *({**sets[0], **other} for other in others)]
    return [dict(items) for items in dict.fromkeys(tuple(values.items()) for values in sets)]


def orders_instead(fitted: Fitted, order: Parameter) -> FloatArray:
    """Orders that promise most for a fitted term that has one, whatever the fit took it for; best first."""
    problem, point = fitted.problem, fitted.solution.point
    term = problem.model.terms[order.term or ""]
    places = index_of(problem.model.parameters)
    theta = fitted.theta.copy()
    theta[[places[p.key] for p in term.parameters if p is not order]] = 0.0
    bare = Point(theta[problem.free] / problem.scale, point.states)
    residuals = problem.residuals(bare)
    without = replace(fitted, theta=theta, solution=replace(fitted.solution, point=bare, residuals=residuals))
    return np.array([values[order.key] for values in _scan(without, term, order)])


def wave_starts(fitted: Fitted, term: Term, order: Parameter) -> Starts:
    """Values of a term's parameters, at the orders that promise most beside a fit without it, best first."""
    known = _known.setdefault(fitted.problem, {})
    if term.key not in known:
        known[term.key] = _scan(fitted, term, order)
    return known[term.key]


def _scan(fitted: Fitted, term: Term, order: Parameter) -> Starts:
    problem = fitted.problem
    along = problem.model.coordinates(
        fitted.theta, problem.record, problem.windows, fitted.solution.point.states
    )
    waves = [p for p in term.parameters if p is not order]
    scan = Scan(ProjectedResiduals.of(fitted), order, waves, along[order.waves_over])
    keys = [p.key for p in waves]
    return [{order.key: k, **dict(zip(keys, sizes, strict=True))} for k, sizes in scan.best()]


@dataclass(frozen=True, slots=True)
class Scan:
    """What waves of any order would explain of what a fit leaves; ``way`` (N,) is the coordinate along it."""

    unexplained: ProjectedResiduals
    order: Parameter
    waves: list[Parameter]
    way: FloatArray

    def best(self) -> list[tuple[float, list[float]]]:
        """The orders that promise most, best first, each with the sizes of its waves.

        Where windows see but a small part of the way, each has a phase of its own at first, and orders beside
        the best ones are tried again with one phase for all.
        """
        together, apart = TURN / max(float(np.ptp(self.way)), 1e-12), TURN / self._span()
        if apart < FEW * together:
            return self._peaks(self._order_grid(together), one_phase=True)
        peaks = [k for k, _ in self._peaks(self._order_grid(apart), one_phase=False)]
        orders = [np.r_[k, np.arange(max(k - apart, self._lowest()), k + apart, together)] for k in peaks]
        return self._peaks(np.unique(np.concatenate([[], *orders])), one_phase=True)

    def _order_grid(self, step: float) -> FloatArray:
        """Orders a step apart, as far up as samples show them."""
        windows = self.unexplained.fitted.problem.windows
        steps = np.abs(np.diff(self.way))[np.diff(windows.owner) == 0]
        if not steps.any():
            return np.empty(0)
        high = min(np.pi / float(np.quantile(steps[steps > 0.0], SLOW)), self._finest())
        low = self._lowest()
        return np.arange(low, min(self.order.upper, high, low + MOST * step), step)

    def _lowest(self) -> float:
        """The lowest order of which the way has two waves."""
        return max(self.order.lower, TWO_WAVES / max(float(np.ptp(self.way)), 1e-12))

    def _finest(self) -> float:
        """The order whose waves span as few steps of the reading of this coordinate as may be."""
        record = self.unexplained.fitted.problem.record
        read = [j for j, name in enumerate(record.output_names) if name == self.order.waves_over]
        steps = [converter_step(record.outputs[:, j]) for j in read]
        return 2.0 * np.pi / (STEPS * max(*steps, 1e-300)) if steps else np.inf

    def _span(self) -> float:
        """The way that a window sees, the median."""
        problem = self.unexplained.fitted.problem
        edges = problem.edges // len(problem.sigma)
        spans = np.maximum.reduceat(self.way, edges) - np.minimum.reduceat(self.way, edges)
        return max(float(np.median(spans)), 1e-12)

    def _peaks(self, orders: FloatArray, *, one_phase: bool) -> list[tuple[float, list[float]]]:
        """The highest local maxima among orders in turn, highest first, with the sizes of their waves."""
        promises = [self._promise(float(k), one_phase=one_phase) for k in orders]
        promised = np.array([-np.inf, *(promise for promise, _ in promises), -np.inf])
        peaks = np.flatnonzero((promised[1:-1] >= promised[:-2]) & (promised[1:-1] > promised[2:]))
        highest = peaks[np.argsort(-promised[1:-1][peaks])][:PROPOSED]
        return [(float(orders[i]), promises[i][1]) for i in highest]

    def _promise(self, order: float, *, one_phase: bool) -> tuple[float, list[float]]:
        """What of the squares the waves of one order explain, and their sizes."""
        unexplained, problem = self.unexplained, self.unexplained.fitted.problem
        places = index_of(problem.model.parameters)
        columns = []
        for wave in self.waves:
            theta = unexplained.fitted.theta.copy()
            theta[places[self.order.key]] = order
            theta[places[wave.key]] = SMALL * wave.scale
            columns.append(unexplained.residual_change(theta))
        both = np.column_stack(columns)
        if one_phase:
            both = unexplained.project_out_all(both)
            gram, pull = (both.T @ both)[None], (both.T @ unexplained.target)[None]
        else:
            both = unexplained.project_out_states(both)
            gram = problem.products(both, both)
            pull = problem.products(both, unexplained.target[:, None])[:, :, 0]
        gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(len(self.waves)) + 1e-300
        sizes = np.linalg.solve(gram, pull[:, :, None])[:, :, 0]
        explained = float(np.sum(sizes * pull))
        return explained, (-SMALL * sizes[0] * [wave.scale for wave in self.waves]).tolist()
