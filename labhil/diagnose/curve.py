"""A force curve in a model: a penalised spline (Eilers and Marx, Stat. Sci. 11, 1996) and its band.

The spline is fitted beside the model's own parameters; cross-validation over windows selects its smoothness.
``force_curve.py`` says over which coordinate a curve acts, ``structures/curves.py`` compares it with named
terms.
"""

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

SMOOTHING_WEIGHTS = np.logspace(-6.0, 6.0, 13)
"""Weights of the roughness penalty that are compared; at 1 penalty and data weigh the same."""

CONFIDENCE = 0.99
"""Probability of the pointwise band and of the intervals beside a curve."""

N_CURVE_POINTS = 101
"""Points of a curve over the visited range."""


@dataclass(frozen=True, slots=True)
class CurveFit:
    """A fit of a model with a force curve.

    Attributes:
        fitted: the fit of model parameters and spline coefficients.
        model: the model with the curve.
        penalty: roughness penalty and prior, (P, P), in units of the parameters' scales.
        linearised: the model linearised at the end of the fit.
        degrees: effective number of free parameters.
        samples: the coordinate at the samples of the data, (N,).
        projection: removes from coefficients the shapes that the model's own parameters stand for, (K, K).
    """

    fitted: Fitted
    model: ExtendedModel
    penalty: FloatArray
    linearised: Projected
    degrees: float
    samples: FloatArray
    projection: FloatArray

    @property
    def joint(self) -> int | None:
        """The joint of an arm that the force acts on."""
        return self.model.coordinate.part.joint

    @property
    def coefficients(self) -> FloatArray:
        """Coefficients of the spline, in the unit of the force, (K,)."""
        return self.model.split(self.fitted.theta)[1]

    @property
    def n_position_states(self) -> int:
        """Number of window states that exist only to place the curve along its coordinate."""
        inner = self.model.inner
        unseen = isinstance(inner, PositionUnobserved) and self.model.coordinate.name in inner.state_names
        return len(self.fitted.problem.windows) if unseen else 0


def cut_into_blocks(final: Fitted, block_length: float = 1.0) -> Fitted:
    """Cut the data of a fit without states into blocks, which cross-validation can leave out in turn.

    Args:
        final: a fit of inverse dynamics.
        block_length: length of a block, s: longer than the correlation of the residuals, shorter than a pass
            of a joint.
    """
    old = final.problem
    windows = fit_windows(old.record, block_length)
    problem = Problem(old.model, old.record, windows, old.free, final.theta, old.sigma)
    z = problem.start().z
    states = fit_states(problem, z, problem.guess)
    point = Point(z, states)
    residuals = problem.residuals(point)
    solution = Solution(point, residuals, 0, True)
    return replace(final, problem=problem, solution=solution, window=block_length, rivals=())


def mean_window_length(fitted: Fitted) -> float:
    """Mean length of the windows of a fit, s."""
    record, windows = fitted.problem.record, fitted.problem.windows
    return record.duration / len(windows)


def add_spline(
    start: Fitted,
    coordinate: Coordinate,
    samples: FloatArray,
    *,
    n_basis: int = 24,
    n_basis_joint: int = 60,
    scale_in_drive_force: float = 0.1,
    scale_in_joint_torque: float = 10.0,
) -> tuple[ExtendedModel, Problem, Point]:
    """Add a spline over a coordinate to the model of a fit, with all coefficients zero.

    Args:
        start: the fit without a curve.
        coordinate: the coordinate that the force depends on.
        samples: the coordinate at the samples of the data, (N,).
        n_basis: number of basis functions: more than a smooth curve needs, since the penalty limits it.
        n_basis_joint: the same of inverse dynamics, where a joint turns far and no basis function costs a
            simulation.
        scale_in_drive_force: typical size of the force, over the force of the drive.
        scale_in_joint_torque: typical size on a joint, over the torque that its motion takes, which is small
            where the joint hangs straight down.

    Returns:
        The model with the curve, its fitting problem, and the point where that starts.
    """
    inner = start.problem.model
    assert isinstance(inner, AcceptsExtraForce)
    old = start.problem
    measure = inner.characteristic_scales(old.record)
    part = coordinate.part
    speed = (
        part.speed * measure[CharacteristicScale.SPEED] if coordinate.acts is CurveArgument.DAMPING else 1.0
    )
    share, functions = (
        (scale_in_drive_force, n_basis) if part.joint is None else (scale_in_joint_torque, n_basis_joint)
    )
    size = share * part.force * measure[CharacteristicScale.DRIVE] / speed
    model = ExtendedModel(inner, coordinate, Spline.of(samples, functions), size)
    first = len(inner.parameters)
    free = np.r_[old.free, first + np.arange(model.spline.count)]
    theta = np.r_[start.theta, np.zeros(model.spline.count)]
    problem = Problem(model, old.record, old.windows, free, theta, old.sigma)
    return model, problem, Point(problem.start().z, start.solution.point.states)


def fit_linearised_curve(start: Fitted, coordinate: Coordinate, samples: FloatArray) -> CurveFit:
    """Fit a curve by one linear step from a fit without it, with the smoothness that predicts best.

    Arguments are those of :func:`add_spline`; the residuals are those of the linearised model.
    """
    model, problem, point = add_spline(start, coordinate, samples)
    linear, _ = Projected.at(problem, point, start.solution.residuals)
    penalty = _select_penalty(linear, model)
    z = linear.solve(penalty)
    solution = replace(start.solution, point=replace(point, z=z), residuals=linear.residuals_at(z))
    fitted = Fitted((*start.terms, UNMODELLED_FORCE), problem.theta(z), problem, solution, start.window)
    identity = np.eye(model.spline.count)
    return CurveFit(fitted, model, penalty, linear, linear.effective_dof(penalty), samples, identity)


def _select_penalty(linearised: Projected, model: ExtendedModel) -> FloatArray:
    """The penalty (P, P) with the least cross-validation error over windows."""
    penalties = [_smoothness_penalty(linearised, model, weight) for weight in SMOOTHING_WEIGHTS]
    return penalties[int(np.argmin(linearised.cross_validate(penalties)))]


def _smoothness_penalty(
    linearised: Projected, model: ExtendedModel, weight: float, *, prior_weight: float = 1.0
) -> FloatArray:
    """The roughness penalty (P, P) of a weight, and a prior that keeps coefficients near their scale.

    The prior decides only about coefficients that the data do not determine.
    """
    count = model.spline.count
    slopes = linearised.slopes[:, -count:]
    rough = model.spline.roughness
    balance = float(np.sum(slopes**2)) / max(float(np.trace(rough)), 1e-300)
    penalty = np.zeros((linearised.slopes.shape[1],) * 2)
    penalty[-count:, -count:] = weight * balance * rough + prior_weight * np.eye(count)
    return penalty


def restart(linear: CurveFit) -> CurveFit:
    """Set a linearised curve back to zero coefficients, since one linear step may be too long for a start."""
    start = replace(linear.fitted.solution.point, z=linear.linearised.z)
    residuals = linear.fitted.problem.residuals(start)
    solution = replace(linear.fitted.solution, point=start, residuals=residuals)
    return replace(linear, fitted=replace(linear.fitted, solution=solution))


def refine(curve: CurveFit, iterations: int) -> CurveFit:
    """Refit a curve by simulation in two rounds, each of which selects the smoothness anew.

    Args:
        curve: the curve and where it starts.
        iterations: steps of least squares in each round.
    """
    once = minimise_penalised(curve, None, iterations)
    return minimise_penalised(once, None, iterations)


def refine_with_states(curve: CurveFit, iterations: int, rounds: int = 8) -> CurveFit:
    """Refit a curve and search the initial states of its windows anew: one wrong state bends the curve.

    Args:
        curve: the curve and where it starts.
        iterations: steps of least squares in each round.
        rounds: number of rounds. Where no channel measures an angle, most rounds change no window, and the
            one that does is decisive.
    """
    random = np.random.default_rng(0)
    for _ in range(rounds):
        problem, point = curve.fitted.problem, curve.fitted.solution.point
        start = Point(point.z, search_states(problem, point.z, point.states, random))
        curve = minimise_penalised(curve, start, iterations)
    return curve


def minimise_penalised(curve: CurveFit, start: Point | None, iterations: int) -> CurveFit:
    """Minimise the penalised cost of a curve, then select its smoothness.

    Args:
        curve: the curve with its penalty.
        start: where to start; None starts where the curve is.
        iterations: steps of least squares.
    """
    problem, fitted = curve.fitted.problem, curve.fitted
    solution = minimise(problem, start or fitted.solution.point, curve.penalty, iterations)
    linear, _ = Projected.at(problem, solution.point, solution.residuals)
    penalty = _select_penalty(linear, curve.model)
    fitted = fitted.with_solution(solution)
    return replace(
        curve, fitted=fitted, penalty=penalty, linearised=linear, degrees=linear.effective_dof(penalty)
    )


def curve_bic(curve: CurveFit, effective: float) -> float:
    """BIC of a curve with effective degrees of freedom, at the smoothness that makes it least.

    Cross-validation hardly distinguishes neighbouring smoothnesses, degrees of freedom do; one linear step
    leads from one to the next. Where the simulation misses the linear prediction at the present smoothness
    (initial states at a kink), the same is missed at every other one.

    ``effective`` is the number of samples as :func:`labhil.diagnose.evidence.bic` counts them.
    """
    linear, joint = curve.linearised, curve.joint

    def bic_of(residuals: FloatArray, degrees: float) -> float:
        solution = replace(curve.fitted.solution, residuals=residuals)
        return bic(replace(curve.fitted, solution=solution), effective, degrees, joint)

    final_residuals, states = curve.fitted.solution.residuals, curve.n_position_states
    missed = bic_of(final_residuals, 0.0) - bic_of(linear.residuals_at(curve.fitted.solution.point.z), 0.0)
    values = [bic_of(final_residuals, curve.degrees + states)]
    for weight in SMOOTHING_WEIGHTS:
        penalty = _smoothness_penalty(linear, curve.model, weight)
        values.append(
            bic_of(linear.residuals_at(linear.solve(penalty)), linear.effective_dof(penalty) + states)
            + missed
        )
    return min(values)


@dataclass(frozen=True, slots=True)
class Band:
    """A curve ``value`` (m,) at points ``x`` (m,) with ``covariance`` (m, m) and pointwise 99 % band.

    ``half_width`` (m,) is half of the band's width; all in the units of coordinate and force.
    """

    x: FloatArray
    value: FloatArray
    covariance: FloatArray
    half_width: FloatArray


def confidence_band(curve: CurveFit) -> Band:
    """The pointwise 99 % band of a curve over the visited range of its coordinate."""
    spline = curve.model.spline
    design = spline.on(N_CURVE_POINTS)
    spread = design @ coefficient_covariance(curve) @ design.T
    half_width = stats.norm.ppf(0.5 + 0.5 * CONFIDENCE) * np.sqrt(np.maximum(np.diag(spread), 0.0))
    x = np.linspace(spline.low, spline.high, N_CURVE_POINTS)
    return Band(x, design @ curve.projection @ curve.coefficients, spread, np.asarray(half_width))


def has_absorbed_shape(curve: CurveFit) -> bool:
    """Whether the model's own parameters hold the constant or the straight line of a curve."""
    return not np.array_equal(curve.projection, np.eye(len(curve.projection)))


def coefficient_covariance(curve: CurveFit) -> FloatArray:
    """Covariance (K, K) of the spline's coefficients without the shapes that the model stands for."""
    fitted, count = curve.fitted, curve.model.spline.count
    dof = len(fitted.solution.residuals) - curve.degrees - fitted.solution.point.states.size
    joint_covariance = curve.linearised.covariance(curve.penalty, max(dof, 1.0), len(fitted.problem.sigma))
    size = curve.model.coefficients[0].scale
    return np.asarray(curve.projection @ joint_covariance[-count:, -count:] @ curve.projection.T) * size**2


def estimates_beside_curve(curve: CurveFit) -> list[Estimate]:
    """Estimates of the model's own parameters, with errors that include those of the curve."""
    fitted, count = curve.fitted, curve.model.spline.count
    problem = fitted.problem
    free, scale = problem.free[:-count], problem.scale[:-count]
    dof = max(len(fitted.solution.residuals) - curve.degrees - fitted.solution.point.states.size, 1.0)
    joint_covariance = curve.linearised.covariance(curve.penalty, dof, len(problem.sigma))
    transform = np.hstack([np.eye(len(free)), _absorption(curve)])
    spread = transform @ joint_covariance @ transform.T * np.outer(scale, scale)
    values, errors = fitted.theta[free], np.sqrt(np.maximum(np.diag(spread), 0.0))
    half_widths = stats.norm.ppf(0.5 + 0.5 * CONFIDENCE) * errors
    intervals = list(zip((values - half_widths).tolist(), (values + half_widths).tolist(), strict=True))
    parameters = [problem.model.parameters[i] for i in free]
    unknown = np.zeros(len(free), dtype=bool)
    return estimates(parameters, values, spread, spread, len(fitted.solution.residuals), unknown, intervals)


def _absorbable_shapes(curve: CurveFit, max_remaining_power: float = 1e-3) -> FloatArray:
    """Coefficients (K, q) of those of a constant and a straight line that the model's parameters stand for.

    Of their squared response a share below ``max_remaining_power`` is orthogonal to that of the parameters.
    """
    spline = curve.model.spline
    count = spline.count
    model_slopes, curve_slopes = curve.linearised.slopes[:, :-count], curve.linearised.slopes[:, -count:]
    basis, _ = np.linalg.qr(model_slopes / np.maximum(np.linalg.norm(model_slopes, axis=0), 1e-300))
    greville = np.array([spline.knots[k + 1 : k + 4].mean() for k in range(count)])
    line = (greville - greville.mean()) / np.ptp(greville)
    shapes = []
    for shape in (np.ones(count), line):
        column = curve_slopes @ shape
        remainder = column - basis @ (basis.T @ column)
        if remainder @ remainder < max_remaining_power * (column @ column):
            shapes.append(shape)
    return np.column_stack(shapes) if shapes else np.empty((count, 0))


def _flattest_half(values: FloatArray, shapes: FloatArray, iterations: int = 60) -> np.ndarray:
    """Mask (m,) of the half of the range where values (m,) lie closest to a sum of shapes (m, q)."""
    weight = np.ones(len(values))
    for _ in range(iterations):
        # least absolute deviations by reweighting: peaks of the curve do not move the level
        scaled = shapes * weight[:, None]
        level = np.linalg.solve(scaled.T @ shapes, scaled.T @ values)
        deviation = np.abs(values - shapes @ level)
        weight = 1.0 / np.maximum(deviation, 1e-6 * max(float(deviation.max()), 1e-300))
    return np.asarray(deviation <= np.median(deviation))


def _absorption(curve: CurveFit) -> FloatArray:
    """Change (P, K) of the model's own parameters by absorbing each coefficient's share, both scaled."""
    count, slopes = curve.model.spline.count, curve.linearised.slopes
    shapes = slopes[:, -count:] @ (np.eye(count) - curve.projection)
    return np.asarray(np.linalg.lstsq(slopes[:, :-count], shapes, rcond=None)[0])


def _gauge_projection(curve: CurveFit) -> FloatArray:
    """Matrix (K, K) that removes from coefficients the shapes that the model's parameters stand for.

    Afterwards the curve is zero where it is flattest.
    """
    spline, shapes = curve.model.spline, _absorbable_shapes(curve)
    if not shapes.shape[1]:
        return np.eye(spline.count)
    design = spline.on(N_CURVE_POINTS)
    values = design @ shapes
    flat = _flattest_half(design @ curve.coefficients, values)
    share = np.linalg.solve(values[flat].T @ values[flat], values[flat].T @ design[flat])
    return np.asarray(np.eye(spline.count) - shapes @ share)


def fix_gauge(curve: CurveFit, *, iterations: int = 3, max_cost_ratio: float = 1.01) -> CurveFit:
    """Move the part of a curve that the model's own parameters can stand for into these parameters.

    Args:
        curve: the curve.
        iterations: steps of least squares after that exchange.
        max_cost_ratio: growth of the cost beyond which the parameters stay as they are.
    """
    count, fitted = curve.model.spline.count, curve.fitted
    projection, z = _gauge_projection(curve), fitted.solution.point.z
    if np.array_equal(projection, np.eye(count)):
        return curve
    problem, curve = fitted.problem, replace(curve, projection=projection)
    removed = z[-count:] - projection @ z[-count:]
    moved = np.clip(z + np.r_[_absorption(curve) @ z[-count:], -removed], problem.lower, problem.upper)
    # the exchange is exact for the linearised model only; the penalty must not bring the shapes back
    start, penalty = replace(fitted.solution.point, z=moved), curve.penalty.copy()
    penalty[-count:, -count:] = projection.T @ penalty[-count:, -count:] @ projection
    solution = minimise(problem, start, penalty, iterations)
    if solution.cost > max_cost_ratio * fitted.solution.cost:
        return curve
    linearised, _ = Projected.at(problem, solution.point, solution.residuals)
    fitted = fitted.with_solution(solution)
    return replace(curve, fitted=fitted, linearised=linearised)
