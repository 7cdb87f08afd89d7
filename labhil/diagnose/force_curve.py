"""Nonparametric forces: a force that no named term explains, as a curve over one coordinate.

``find_joint_torque`` fits one to a joint of an arm, ``state_curve`` states one that the structure search
chose (``structures/curves.py``). How a curve is fitted is in ``curve.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.closed_forms import fit_closed_form
from labhil.diagnose.curve import (
    Band,
    CurveFit,
    confidence_band,
    curve_bic,
    cut_into_blocks,
    estimates_beside_curve,
    fit_linearised_curve,
    fix_gauge,
    has_absorbed_shape,
    minimise_penalised,
    restart,
)
from labhil.diagnose.evidence import Evidence, best_heldout_gain, bic, effective_samples, heldout_gain
from labhil.diagnose.judge import SEARCH_P_VALUE_FLOOR, Data, is_supported
from labhil.diagnose.search_result import FittedCurve
from labhil.identify.extended import UNMODELLED_FORCE, Coordinate, ExtendedModel
from labhil.identify.fitted import Fitted
from labhil.identify.problem import Problem
from labhil.identify.saved_curve import SavedCurve
from labhil.identify.score import Score, score, scored_horizon
from labhil.identify.statistics import Estimate
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, MovedPart, PositionUnobserved
from labhil.physics.model import unit_of
from labhil.physics.terms import Enters
from labhil.signals import FloatArray

FRICTION_NAMES: Mapping[CurveArgument, str] = {
    CurveArgument.POSITION_AGAINST: "dry friction",
    CurveArgument.SPEED_AGAINST: "friction",
    CurveArgument.DAMPING: "viscous friction",
}


@dataclass(frozen=True, slots=True)
class ForceCurve:
    """A force that no named term explains, as the answer of a diagnosis states it.

    Attributes:
        term: key of the curve among the terms of the model.
        joint: joint of an arm that it acts on.
        enters: where in the model it enters.
        depends_on: the coordinates that it depends on.
        acts: whether it is a force along the positive direction, the level of a friction (−value·sgn v) or a
            damping (−value·v).
        x: points of the first coordinate, (m,), in ``x_unit``.
        value: the curve there, (m,), in ``unit``.
        low: lower end of its pointwise 99 % band, (m,).
        high: upper end of the band, (m,).
        unit: unit of the force.
        x_unit: unit of the coordinate.
        formula: a short formula within the band, if there is one.
        statement: one or two sentences for people.
        evidence: evidence for the force.
        curve_fit: the fit behind it.
        before: held-out score without it.
        after: held-out score with it.
        share: share of the mismatch that it explains on held-out data, of its joint where it has one,
            (mse_before − mse_after)/(mse_before − floor²).
        rows: estimates of the model's own parameters beside it.
        probability: probability that the force is there, where structures were compared.
    """

    term: str
    joint: int | None
    enters: str
    depends_on: tuple[str, ...]
    acts: CurveArgument
    x: FloatArray
    value: FloatArray
    low: FloatArray
    high: FloatArray
    unit: str
    x_unit: str
    formula: str | None
    statement: str
    evidence: Evidence
    curve_fit: CurveFit
    before: Score
    after: Score
    share: float
    rows: list[Estimate]
    probability: float | None = None

    @property
    def model(self) -> ExtendedModel:
        """The model with the curve in it."""
        return self.curve_fit.model

    @property
    def fit(self) -> Fitted:
        """The fit of that model."""
        return self.curve_fit.fitted

    @property
    def kept(self) -> SavedCurve:
        """The curve in the form in which a model file holds it."""
        coordinate = self.model.coordinate
        return SavedCurve(coordinate, self.x, self.value, self.low, self.high, self.unit, self.formula)


def find_joint_torque(
    data: Data,
    final: Fitted,
    part: MovedPart,
    *,
    min_excess: float = 1.05,
    min_explained_share: float = 0.5,
) -> ForceCurve | None:
    """Find the torque on a joint, over one coordinate, that brings a fitted arm closest to the data.

    Search and held-out data both have to support it.

    Args:
        data: the data of the search.
        final: the fit of inverse dynamics; its model has to accept an extra force.
        part: the joint.
        min_excess: RMS of residuals or held-out RMSE, in units of the noise, below which nothing is left to
            explain.
        min_explained_share: share of the held-out mismatch that the torque has to explain; one that explains
            less only substitutes another effect.

    Returns:
        The torque, or None.
    """
    model = final.problem.model
    assert isinstance(model, AcceptsExtraForce)
    judged = data.score_held_out(final.theta)[0]
    if max(final.noise, judged.rmse / judged.noise_floor) < min_excess:
        return None
    chosen = _best_curve(final, model, part)
    if chosen is None:
        return None
    evidence = _evidence(data, final, judged, chosen)
    if not is_supported(evidence, SEARCH_P_VALUE_FLOOR):
        return None
    curve = _force_curve(data, final, chosen, evidence)
    return None if curve.share < min_explained_share else curve


def state_curve(data: Data, curve: FittedCurve) -> ForceCurve:
    """State a curve that the structure search chose, with its held-out scores and its probability.

    Args:
        data: the data of the search.
        curve: the refitted curve with its log odds over the likeliest named terms.

    Returns:
        The force as the answer states it.
    """
    named_fit, odds, curve_fit = curve.beside, curve.log_odds, curve.curve_fit
    after = replace(data, model=curve_fit.model).score_held_out(curve_fit.fitted.theta)
    gain, p_value = best_heldout_gain(data.score_held_out(named_fit.theta), after)
    evidence = Evidence(-2.0 * odds, p_value, gain)
    answer = _force_curve(data, named_fit, curve_fit, evidence)
    return replace(answer, probability=float(1.0 / (1.0 + np.exp(-odds))))


def position_variants(final: Fitted) -> list[Fitted]:
    """A fit, and the same with positions as window states where recordings do not measure them.

    A force over a position that no channel measures needs to know where each window starts.
    """
    placed = _with_position_states(final)
    return [final] if placed is final else [final, placed]


def motion_coordinates(model: AcceptsExtraForce, part: MovedPart) -> list[Coordinate]:
    """List the motion coordinates that a force on a part may depend on, and how it may act over each.

    Positions of other parts are among them: a cable or a spring may connect both.

    Args:
        model: the model.
        part: the part that the force acts on.

    Returns:
        Positions and velocities, as a force, as a friction and as a damping.
    """
    other_positions = [moved.position for moved in model.moved if moved != part]
    ways = [
        *(
            (part.position, acts)
            for acts in (CurveArgument.POSITION, CurveArgument.POSITION_AGAINST, CurveArgument.DAMPING)
        ),
        *((part.velocity, acts) for acts in (CurveArgument.VELOCITY, CurveArgument.SPEED_AGAINST)),
        *((position, CurveArgument.POSITION) for position in other_positions),
    ]
    units = model.coordinate_units
    return [Coordinate(name, unit_of(units, name) or "", acts, part) for name, acts in ways if name]


def given_coordinates(final: Fitted, part: MovedPart) -> list[Coordinate]:
    """List the inputs of the recording and their rates as coordinates of a force on a part."""
    model, record = final.problem.model, final.problem.record
    names = {f"{name}{rate}" for name in record.input_names for rate in ("", "_rate")}
    units = {name: unit for name, unit in model.coordinate_units.items() if name in names}
    return [Coordinate(name, unit, CurveArgument.TIME, part) for name, unit in units.items()]


def _best_curve(
    final: Fitted, model: AcceptsExtraForce, part: MovedPart, *, iterations: int = 8
) -> CurveFit | None:
    """The curve with the least BIC, of all coordinates that vary, refitted in ``iterations`` steps.

    Inverse dynamics is linear in a curve, so that one linear step compares the coordinates.
    """
    short = cut_into_blocks(final)
    linear_fits = _linearised_curves(short, motion_coordinates(model, part) + given_coordinates(short, part))
    if not linear_fits:
        return None
    effective = _effective_samples_of(linear_fits)
    best = min(linear_fits, key=lambda curve: curve_bic(curve, effective))
    return fix_gauge(minimise_penalised(restart(best), None, iterations))


def _linearised_curves(fitted: Fitted, possible: Sequence[Coordinate]) -> list[CurveFit]:
    """A curve by one linear step over each coordinate that varies."""
    problem, states = fitted.problem, fitted.solution.point.states
    along = problem.model.coordinates(fitted.theta, problem.record, problem.windows, states)
    sampled = [(coordinate, coordinate.values(along)) for coordinate in possible]
    return [
        fit_linearised_curve(fitted, coordinate, values)
        for coordinate, values in sampled
        if np.ptp(values) > 0.0
    ]


def _with_position_states(final: Fitted) -> Fitted:
    """The fit with unmeasured positions as window states; unchanged where all positions are measured."""
    model, old = final.problem.model, final.problem
    if not isinstance(model, PositionUnobserved) or model.with_place() is model:
        return final
    problem = Problem(model.with_place(), old.record, old.windows, old.free, final.theta, old.sigma)
    point = final.solution.point
    states = np.column_stack([point.states, problem.guess[:, point.states.shape[1] :]])
    solution = replace(final.solution, point=replace(point, states=states))
    return replace(final, problem=problem, solution=solution, rivals=())


def _effective_samples_of(trials: Sequence[CurveFit]) -> float:
    """Effective samples of the curve with the least residuals: those of a poor fit are all correlated."""
    best = min(trials, key=lambda trial: trial.fitted.solution.cost)
    return effective_samples(best.fitted, best.joint)


def _evidence(data: Data, final: Fitted, before: Score, chosen: CurveFit) -> Evidence:
    """ΔBIC of a curve, and its gain on held-out data, of the joint that it acts on."""
    joint = chosen.joint
    effective = effective_samples(chosen.fitted, joint)
    after = score(chosen.model, chosen.fitted.theta, data.test, data.test_sigma, before.horizon)
    gain, p_value = heldout_gain(before.of_joint(joint), after.of_joint(joint))
    return Evidence(curve_bic(chosen, effective) - bic(final, effective, joint=joint), p_value, gain)


def _force_curve(data: Data, final: Fitted, chosen: CurveFit, evidence: Evidence) -> ForceCurve:
    """The curve as the answer states it, scored on the metric's windows of the held-out data."""
    horizon = scored_horizon(data.model, final.theta, data.test)
    before = score(data.model, final.theta, data.test, data.test_sigma, horizon)
    after = score(chosen.model, chosen.fitted.theta, data.test, data.test_sigma, horizon)
    coordinate = chosen.model.coordinate
    curve = confidence_band(chosen)
    unit = chosen.model.coefficients[0].unit
    part = coordinate.part
    velocity = (
        (part.velocity,) if coordinate.acts in (CurveArgument.POSITION_AGAINST, CurveArgument.DAMPING) else ()
    )
    return ForceCurve(
        term=UNMODELLED_FORCE,
        joint=part.joint,
        enters=part.enters.value,
        depends_on=(coordinate.name, *velocity),
        acts=coordinate.acts,
        x=curve.x,
        value=curve.value,
        low=curve.value - curve.half_width,
        high=curve.value + curve.half_width,
        unit=unit,
        x_unit=coordinate.unit,
        formula=fit_closed_form(curve.x, curve.value, curve.covariance, curve.half_width),
        statement=_statement(chosen, curve, unit),
        evidence=evidence,
        curve_fit=chosen,
        before=before,
        after=after,
        share=_explained_share(before.of_joint(part.joint), after.of_joint(part.joint)),
        rows=estimates_beside_curve(chosen),
    )


def _explained_share(before: Score, after: Score) -> float:
    """Share of the mean square beyond the noise floor that the curve explains."""
    excess = before.mse - after.noise_floor**2
    return (before.mse - after.mse) / excess if excess > 0.0 else 0.0


def _statement(chosen: CurveFit, curve: Band, unit: str) -> str:
    """One or two sentences: the kind of force, its coordinate, its largest value and where that is."""
    coordinate = chosen.model.coordinate
    most = int(np.argmax(np.abs(curve.value)))
    joint = coordinate.part.joint
    effort = "a force" if joint is None else "a torque"
    if coordinate.part.enters is Enters.DIFFERENCE:
        effort = "a difference of the output"
    kind = FRICTION_NAMES.get(coordinate.acts, effort)
    where = "" if joint is None else f" on joint {joint}"
    text = (
        f"Something that no named effect explains acts{where} as {kind} that depends on {coordinate.name}: "
        f"{curve.value[most]:.3g} {unit} where it is strongest, at {curve.x[most]:.3g} {coordinate.unit}."
    )
    if has_absorbed_shape(chosen):
        text += " It is zero where it is quietest: the model's own parameters can stand for the rest."
    return text.replace("-", "−")
