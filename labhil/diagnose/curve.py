"""A curve in a model: its spline fitted beside the model's own parameters, its smoothness, its band."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from labhil.diagnose.evidence import bic
from labhil.identify.extended import UNMODELLED_FORCE, Coordinate, ExtendedModel
from labhil.identify.fitted import Fitted
from labhil.identify.least_squares import Solution
from labhil.identify.penalised import Projected, minimise
from labhil.identify.problem import Point, Problem
from labhil.identify.spline import Spline
from labhil.identify.statistics import Estimate, estimates
from labhil.identify.window_states import fit_states, search_states
from labhil.identify.windows import fit_windows
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, PositionUnobserved
from labhil.physics.terms import CharacteristicScale
from labhil.signals import FloatArray

FUNCTIONS = 24
"""Of the spline: more than any curve that is smooth to the eye needs; the penalty takes the rest."""

FUNCTIONS_OF_A_JOINT = 60
"""The same of inverse dynamics: a joint turns far, and no function costs a simulation."""

SMOOTHING = np.logspace(-6.0, 6.0, 13)
"""Weights of the penalty that are tried, over the one at which data and penalty say as much."""

SIZE = 0.1
"""Share of the drive's force that is taken for a typical size."""

SIZE_ON_A_JOINT = 10.0
"""The same over the torque that a joint's motion took: hardly any, where it hangs straight down."""

WIDEST = 1.0
"""Weight of the prior that keeps coefficients within a few sizes: it decides only what data do not."""

SAME = 1e-3
"""Share of its square that a shape keeps beside the model's own parameters when these can stand for it."""

NO_WORSE = 1.01
"""Growth of the cost up to which a shape is handed over to the model's own parameters."""

EXCHANGED = 3
"""Steps after that exchange."""

DEEPENED = 8
"""Rounds of new states and a new curve: where no channel measures an angle, most rounds move no window, and
the one that does decides what the curve explains."""

BLOCK = 1.0
"""Stretch of inverse dynamics, s: longer than what it leaves remembers, shorter than a pass of the joint."""

REWEIGHTED = 60
LEVEL = 0.99
PLACES = 101


@dataclass(frozen=True, slots=True)
class Curved:
    """A fit with a curve in it.

    ``penalty`` (P, P) in units of the scales; ``near`` the linearised model at its end; ``kept`` (K, K)
    takes from coefficients what the model's own parameters can stand for; ``along`` (N,) the coordinate
    where the data are; ``degrees`` the effective number of free parameters.
    """

    fitted: Fitted
    model: ExtendedModel
    penalty: FloatArray
    near: Projected
    degrees: float
    along: FloatArray
    free: FloatArray

    @property
    def joint(self) -> int | None:
        """The one of an arm that it acts on."""
        return self.model.coordinate.part.joint

    @property
    def coefficients(self) -> FloatArray:
        """Of the spline, in the unit of the force, (K,)."""
        return self.model.split(self.fitted.theta)[1]

    @property
    def places(self) -> int:
        """States that windows have only so that they know where the curve's part stands."""
        inner = self.model.inner
        unseen = isinstance(inner, PositionUnobserved) and self.model.coordinate.name in inner.state_names
        return len(self.fitted.problem.windows) if unseen else 0


def in_blocks(final: Fitted) -> Fitted:
    """The same fit of a model without states in stretches of which some can be left out in turn."""
    old = final.problem
    windows = fit_windows(old.record, BLOCK)
    problem = Problem(old.model, old.record, windows, old.free, final.theta, old.sigma)
    z = problem.start().z
    states = fit_states(problem, z, problem.guess)
    point = Point(z, states)
    residuals = problem.residuals(point)
    ended = Solution(point, residuals, 0, True)
    return replace(final, problem=problem, solution=ended, window=BLOCK, rivals=())


def length_of(fitted: Fitted) -> float:
    """Mean length of a fit's windows, s."""
    record, windows = fitted.problem.record, fitted.problem.windows
    return record.duration / len(windows)


def with_spline(
    begun: Fitted, coordinate: Coordinate, along: FloatArray
) -> tuple[ExtendedModel, Problem, Point]:
    """A fit's problem with a spline beside its model, still zero.

    ``along`` (N,) is the coordinate where the data are.
    """
    inner = begun.problem.model
    assert isinstance(inner, AcceptsExtraForce)
    old = begun.problem
    measure = inner.characteristic_scales(old.record)
    part = coordinate.part
    speed = (
        part.speed * measure[CharacteristicScale.SPEED] if coordinate.acts is CurveArgument.DAMPING else 1.0
    )
    share, functions = (SIZE, FUNCTIONS) if part.joint is None else (SIZE_ON_A_JOINT, FUNCTIONS_OF_A_JOINT)
    size = share * part.force * measure[CharacteristicScale.DRIVE] / speed
    model = ExtendedModel(inner, coordinate, Spline.of(along, functions), size)
    first = len(inner.parameters)
    free = np.r_[old.free, first + np.arange(model.spline.count)]
    theta = np.r_[begun.theta, np.zeros(model.spline.count)]
    problem = Problem(model, old.record, old.windows, free, theta, old.sigma)
    return model, problem, Point(problem.start().z, begun.solution.point.states)


def glance(begun: Fitted, coordinate: Coordinate, along: FloatArray) -> Curved:
    """The curve that one linear step from a model's fit gives, with the smoothness that predicts best.

    ``along`` (N,) is the coordinate where the data are.
    """
    model, problem, point = with_spline(begun, coordinate, along)
    near, _ = Projected.at(problem, point, begun.solution.residuals)
    penalty = _smoothest(near, model)
    z = near.solve(penalty)
    solution = replace(begun.solution, point=replace(point, z=z), residuals=near.residuals_at(z))
    fitted = Fitted((*begun.terms, UNMODELLED_FORCE), problem.theta(z), problem, solution, begun.window)
    identity = np.eye(model.spline.count)
    return Curved(fitted, model, penalty, near, near.effective_dof(penalty), along, identity)


def _smoothest(near: Projected, model: ExtendedModel) -> FloatArray:
    """The penalty (P, P) under which windows are predicted best that had no part in the estimate."""
    penalties = [_penalty(near, model, weight) for weight in SMOOTHING]
    return penalties[int(np.argmin(near.cross_validate(penalties)))]


def _penalty(near: Projected, model: ExtendedModel, weight: float) -> FloatArray:
    count = model.spline.count
    slopes = near.slopes[:, -count:]
    rough = model.spline.roughness
    even = float(np.sum(slopes**2)) / max(float(np.trace(rough)), 1e-300)
    penalty = np.zeros((near.slopes.shape[1],) * 2)
    penalty[-count:, -count:] = weight * even * rough + WIDEST * np.eye(count)
    return penalty


def restart(glanced: Curved) -> Curved:
    """A glance moved back to where the fit without the curve ended: one step may be too long for a start."""
    start = replace(glanced.fitted.solution.point, z=glanced.near.z)
    residuals = glanced.fitted.problem.residuals(start)
    solution = replace(glanced.fitted.solution, point=start, residuals=residuals)
    return replace(glanced, fitted=replace(glanced.fitted, solution=solution))


def refine(curved: Curved, iterations: int) -> Curved:
    """Refit the curve by the simulation itself, and choose its smoothness anew at the end."""
    once = minimise_penalised(curved, None, iterations)
    return minimise_penalised(once, None, iterations)


def deepen(curved: Curved, iterations: int) -> Curved:
    """Refit the curve from better states of the windows: one window in a wrong minimum bends the curve."""
    random = np.random.default_rng(0)
    for _ in range(DEEPENED):
        problem, point = curved.fitted.problem, curved.fitted.solution.point
        start = Point(point.z, search_states(problem, point.z, point.states, random))
        curved = minimise_penalised(curved, start, iterations)
    return curved


def minimise_penalised(curved: Curved, start: Point | None, iterations: int) -> Curved:
    """Minimise the penalised cost from ``start`` (None: where the curve is), then choose its smoothness."""
    problem, fitted = curved.fitted.problem, curved.fitted
    solution = minimise(problem, start or fitted.solution.point, curved.penalty, iterations)
    near, _ = Projected.at(problem, solution.point, solution.residuals)
    penalty = _smoothest(near, curved.model)
    fitted = replace(fitted, theta=problem.theta(solution.point.z), solution=solution)
    return replace(curved, fitted=fitted, penalty=penalty, near=near, degrees=near.effective_dof(penalty))


def criterion(curved: Curved, effective: float) -> float:
    """Schwarz's criterion with effective degrees of freedom, at the smoothness that makes it least.

    Windows left out in turn hardly distinguish neighbouring smoothnesses, degrees of freedom do; one linear
    step leads from one to the next. What a linear model promises at the present curve and the simulation
    does not keep, of windows' states at a kink, is not granted at another smoothness.
    """
    near, joint = curved.near, curved.joint

    def mark(residuals: FloatArray, degrees: float) -> float:
        solution = replace(curved.fitted.solution, residuals=residuals)
        return bic(replace(curved.fitted, solution=solution), effective, degrees, joint)

    final_residuals, states = curved.fitted.solution.residuals, curved.places
    missed = mark(final_residuals, 0.0) - mark(near.residuals_at(curved.fitted.solution.point.z), 0.0)
    marks = [mark(final_residuals, curved.degrees + states)]
    for weight in SMOOTHING:
        penalty = _penalty(near, curved.model, weight)
        marks.append(
            mark(near.residuals_at(near.solve(penalty)), near.effective_dof(penalty) + states) + missed
        )
    return min(marks)


@dataclass(frozen=True, slots=True)
class Band:
    """Places ``x`` (m,), the curve there, its covariance (m, m), and half of its pointwise 99 % band (m,)."""

    x: FloatArray
    value: FloatArray
    covariance: FloatArray
    reach: FloatArray


def band(curved: Curved) -> Band:
    """The curve over the visited range, in the units of coordinate and force."""
    spline = curved.model.spline
    design = spline.on(PLACES)
    spread = design @ covariance(curved) @ design.T
    reach = stats.norm.ppf(0.5 + 0.5 * LEVEL) * np.sqrt(np.maximum(np.diag(spread), 0.0))
    x = np.linspace(spline.low, spline.high, PLACES)
    return Band(x, design @ curved.free @ curved.coefficients, spread, np.asarray(reach))


def holds_shape(curved: Curved) -> bool:
    """Whether the model's own parameters hold a constant or a straight line of the curve."""
    return not np.array_equal(curved.free, np.eye(len(curved.free)))


def covariance(curved: Curved) -> FloatArray:
    """Of the spline's coefficients less what the model's own parameters can stand for, (K, K)."""
    fitted, count = curved.fitted, curved.model.spline.count
    dof = len(fitted.solution.residuals) - curved.degrees - fitted.solution.point.states.size
    joint_covariance = curved.near.covariance(curved.penalty, max(dof, 1.0), len(fitted.problem.sigma))
    size = curved.model.coefficients[0].scale
    return np.asarray(curved.free @ joint_covariance[-count:, -count:] @ curved.free.T) * size**2


def rows_beside(curved: Curved) -> list[Estimate]:
    """The model's own parameters as they are estimated together with the curve."""
    fitted, count = curved.fitted, curved.model.spline.count
    problem = fitted.problem
    free, scale = problem.free[:-count], problem.scale[:-count]
    dof = max(len(fitted.solution.residuals) - curved.degrees - fitted.solution.point.states.size, 1.0)
    joint_covariance = curved.near.covariance(curved.penalty, dof, len(problem.sigma))
    taking = np.hstack([np.eye(len(free)), _exchange(curved)])
    spread = taking @ joint_covariance @ taking.T * np.outer(scale, scale)
    values, errors = fitted.theta[free], np.sqrt(np.maximum(np.diag(spread), 0.0))
    reach = stats.norm.ppf(0.5 + 0.5 * LEVEL) * errors
    intervals = list(zip((values - reach).tolist(), (values + reach).tolist(), strict=True))
    parameters = [problem.model.parameters[i] for i in free]
    unknown = np.zeros(len(free), dtype=bool)
    return estimates(parameters, values, spread, spread, len(fitted.solution.residuals), unknown, intervals)


def _shapes(curved: Curved) -> FloatArray:
    """Coefficients (K, q) of those of a constant and a straight line that the model's own terms can be."""
    spline = curved.model.spline
    count = spline.count
    model_slopes, curve_slopes = curved.near.slopes[:, :-count], curved.near.slopes[:, -count:]
    basis, _ = np.linalg.qr(model_slopes / np.maximum(np.linalg.norm(model_slopes, axis=0), 1e-300))
    greville = np.array([spline.knots[k + 1 : k + 4].mean() for k in range(count)])
    line = (greville - greville.mean()) / np.ptp(greville)
    shapes = []
    for shape in (np.ones(count), line):
        column = curve_slopes @ shape
        remainder = column - basis @ (basis.T @ column)
        if remainder @ remainder < SAME * (column @ column):
            shapes.append(shape)
    return np.column_stack(shapes) if shapes else np.empty((count, 0))


def _quiet_half(values: FloatArray, shapes: FloatArray) -> np.ndarray:
    """Marks (m,) the half of the range where values (m,) lie closest to a sum of shapes (m, q)."""
    weight = np.ones(len(values))
    for _ in range(REWEIGHTED):
        # least absolute deviations: what sticks out does not move the rest
        scaled = shapes * weight[:, None]
        level = np.linalg.solve(scaled.T @ shapes, scaled.T @ values)
        off = np.abs(values - shapes @ level)
        weight = 1.0 / np.maximum(off, 1e-6 * max(float(off.max()), 1e-300))
    return np.asarray(off <= np.median(off))


def _exchange(curved: Curved) -> FloatArray:
    """What the model's own parameters take over of each coefficient, (P, K) for P of them, both scaled."""
    count, slopes = curved.model.spline.count, curved.near.slopes
    shapes = slopes[:, -count:] @ (np.eye(count) - curved.free)
    return np.asarray(np.linalg.lstsq(slopes[:, :-count], shapes, rcond=None)[0])


def _own_projection(curved: Curved) -> FloatArray:
    """Matrix (K, K) that takes from coefficients the shapes that are not the curve's own.

    Where the model's own constant force can stand for the same, the curve is zero where it is quietest.
    """
    spline, shapes = curved.model.spline, _shapes(curved)
    if not shapes.shape[1]:
        return np.eye(spline.count)
    design = spline.on(PLACES)
    places = design @ shapes
    quiet = _quiet_half(design @ curved.coefficients, places)
    share = np.linalg.solve(places[quiet].T @ places[quiet], places[quiet].T @ design[quiet])
    return np.asarray(np.eye(spline.count) - shapes @ share)


def fix_gauge(curved: Curved) -> Curved:
    """Move the part of a curve that the model's own parameters can stand for into these."""
    count, fitted = curved.model.spline.count, curved.fitted
    free, z = _own_projection(curved), fitted.solution.point.z
    if np.array_equal(free, np.eye(count)):
        return curved
    problem, curved = fitted.problem, replace(curved, free=free)
    removed = z[-count:] - free @ z[-count:]
    moved = np.clip(z + np.r_[_exchange(curved) @ z[-count:], -removed], problem.lower, problem.upper)
    # the exchange is exact for the linearised model only; what was exchanged is not to come back
    begin, blind = replace(fitted.solution.point, z=moved), curved.penalty.copy()
    blind[-count:, -count:] = free.T @ blind[-count:, -count:] @ free
    solution = minimise(problem, begin, blind, EXCHANGED)
    if solution.cost > NO_WORSE * fitted.solution.cost:
        return curved
    near, _ = Projected.at(problem, solution.point, solution.residuals)
    fitted = replace(fitted, theta=problem.theta(solution.point.z), solution=solution)
    return replace(curved, fitted=fitted, near=near)
