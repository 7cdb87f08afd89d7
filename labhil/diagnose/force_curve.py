"""A force that no named term explains: over which coordinate it acts, its curve, and its evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.adequacy import STANDS_IN
from labhil.diagnose.closed_forms import fit_closed_form
from labhil.diagnose.curve import (
    Band,
    Curved,
    band,
    criterion,
    fix_gauge,
    glance,
    holds_shape,
    in_blocks,
    minimise_penalised,
    restart,
    rows_beside,
)
from labhil.diagnose.evidence import Evidence, best_heldout_gain, bic, effective_samples, heldout_gain
from labhil.diagnose.judge import TRUSTED, Data, is_supported
from labhil.diagnose.search_result import FittedCurve
from labhil.identify.extended import NAME, Coordinate, ExtendedModel
from labhil.identify.fitted import Fitted
from labhil.identify.problem import Problem
from labhil.identify.saved_curve import SavedCurve
from labhil.identify.score import Score, score, scored_horizon
from labhil.identify.statistics import Estimate
from labhil.physics.extra_force import AcceptsExtraForce, CurveArgument, MovedPart, PositionUnobserved
from labhil.physics.model import unit_of
from labhil.physics.terms import Enters
from labhil.signals import FloatArray

REACHED = 1.05
"""A model whose errors are at most this much above the noise has nothing left to explain."""

ITERATIONS = 8
"""Steps on the windows of each length."""

WAYS: Mapping[CurveArgument, str] = {
    CurveArgument.POSITION_AGAINST: "dry friction",
    CurveArgument.SPEED_AGAINST: "friction",
    CurveArgument.DAMPING: "viscous friction",
}


@dataclass(frozen=True, slots=True)
class ForceCurve:
    """A force that no named term explains.

    ``depends_on`` are the coordinates; the curve has the values ``value`` (m,) in ``unit`` at the places
    ``x`` (m,) of the first of them, with a pointwise 99 % band ``low`` … ``high``. By ``acts`` it is a force
    along the positive direction, or the level of a friction (−value·sgn v), or a damping (−value·v).
    ``before`` and ``after`` are held-out scores; ``share`` is what of
    the mismatch it explains there, (mse_before − mse_after)/(mse_before − floor²), of its joint where it has
    one. ``curved`` is the fit behind it, ``rows`` the model's own parameters in it.
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
    curved: Curved
    before: Score
    after: Score
    share: float
    rows: list[Estimate]
    probability: float | None = None

    @property
    def model(self) -> ExtendedModel:
        """The model with the curve in it."""
        return self.curved.model

    @property
    def fit(self) -> Fitted:
        """That model's fit."""
        return self.curved.fitted

    @property
    def kept(self) -> SavedCurve:
        """The curve as a part of a model."""
        coordinate = self.model.coordinate
        return SavedCurve(coordinate, self.x, self.value, self.low, self.high, self.unit, self.formula)


def unmodelled(data: Data, final: Fitted, part: MovedPart) -> ForceCurve | None:
    """The torque on a joint over one coordinate that brings a fitted arm closest to the data, or None.

    It has to be supported by the search data and by the held-out ones, and has to explain half of what these
    show, or it only stands in for something else. The model must take a force.
    """
    model = final.problem.model
    assert isinstance(model, AcceptsExtraForce)
    judged = data.judge(final.theta)[0]
    if max(final.noise, judged.rmse / judged.noise_floor) < REACHED:
        return None
    chosen = _best(final, model, part)
    if chosen is None:
        return None
    evidence = _evidence(data, final, judged, chosen)
    if not is_supported(evidence, TRUSTED):
        return None
    curve = _force_curve(data, final, chosen, evidence)
    return None if curve.share < STANDS_IN else curve


def state_curve(data: Data, curve: FittedCurve) -> ForceCurve:
    """State a curve that evidence chose, with its scores and its probability."""
    named_fit, odds, curved = curve.beside, curve.log_odds, curve.curved
    after = replace(data, model=curved.model).judge(curved.fitted.theta)
    gain, p_value = best_heldout_gain(data.judge(named_fit.theta), after)
    evidence = Evidence(-2.0 * odds, p_value, gain)
    answer = _force_curve(data, named_fit, curved, evidence)
    return replace(answer, probability=float(1.0 / (1.0 + np.exp(-odds))))


def with_placed(final: Fitted) -> list[Fitted]:
    """A fit, and the same where windows know where their part stands, if recordings do not measure it."""
    placed = _place(final)
    return [final] if placed is final else [final, placed]


def motion_coordinates(model: AcceptsExtraForce, part: MovedPart) -> list[Coordinate]:
    """All coordinates that a force on a part may depend on, with and without the sign of velocity.

    Positions of other parts are among them: a cable or a spring may be tied to both.
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
    """Inputs and their rates, which the record gives."""
    model, record = final.problem.model, final.problem.record
    names = {f"{name}{rate}" for name in record.input_names for rate in ("", "_rate")}
    units = {name: unit for name, unit in model.coordinate_units.items() if name in names}
    return [Coordinate(name, unit, CurveArgument.TIME, part) for name, unit in units.items()]


def _best(final: Fitted, model: AcceptsExtraForce, part: MovedPart) -> Curved | None:
    """The curve with the least criterion, of all coordinates that vary.

    Inverse dynamics is linear in a curve: a glance is as good as what follows.
    """
    short = in_blocks(final)
    looks = _glances(short, motion_coordinates(model, part) + given_coordinates(short, part))
    if not looks:
        return None
    effective = _effective_samples_of(looks)
    best = min(looks, key=lambda look: criterion(look, effective))
    return fix_gauge(minimise_penalised(restart(best), None, ITERATIONS))


def _glances(fitted: Fitted, possible: Sequence[Coordinate]) -> list[Curved]:
    """One glance at a curve over each of these coordinates that varies."""
    problem, states = fitted.problem, fitted.solution.point.states
    along = problem.model.coordinates(fitted.theta, problem.record, problem.windows, states)
    sampled = [(coordinate, coordinate.of(along)) for coordinate in possible]
    return [glance(fitted, coordinate, values) for coordinate, values in sampled if np.ptp(values) > 0.0]


def _place(final: Fitted) -> Fitted:
    """Place a fit: its windows know where their part stands, as far as recordings do not measure it."""
    model, old = final.problem.model, final.problem
    if not isinstance(model, PositionUnobserved) or model.with_place() is model:
        return final
    problem = Problem(model.with_place(), old.record, old.windows, old.free, final.theta, old.sigma)
    point = final.solution.point
    states = np.column_stack([point.states, problem.guess[:, point.states.shape[1] :]])
    solution = replace(final.solution, point=replace(point, states=states))
    return replace(final, problem=problem, solution=solution, rivals=())


def _effective_samples_of(trials: Sequence[Curved]) -> float:
    """Samples that count: of the fit with the least residuals, for those of a bad one are all alike."""
    best = min(trials, key=lambda trial: trial.fitted.solution.cost)
    return effective_samples(best.fitted, best.joint)


def _evidence(data: Data, final: Fitted, before: Score, chosen: Curved) -> Evidence:
    joint = chosen.joint
    effective = effective_samples(chosen.fitted, joint)
    after = score(chosen.model, chosen.fitted.theta, data.test, data.test_sigma, before.horizon)
    gain, p_value = heldout_gain(before.of_joint(joint), after.of_joint(joint))
    return Evidence(criterion(chosen, effective) - bic(final, effective, joint=joint), p_value, gain)


def _force_curve(data: Data, final: Fitted, chosen: Curved, evidence: Evidence) -> ForceCurve:
    horizon = scored_horizon(data.model, final.theta, data.test)
    before = score(data.model, final.theta, data.test, data.test_sigma, horizon)
    after = score(chosen.model, chosen.fitted.theta, data.test, data.test_sigma, horizon)
    coordinate = chosen.model.coordinate
    curve = band(chosen)
    unit = chosen.model.coefficients[0].unit
    part = coordinate.part
    also = (
        (part.velocity,) if coordinate.acts in (CurveArgument.POSITION_AGAINST, CurveArgument.DAMPING) else ()
    )
    return ForceCurve(
        term=NAME,
        joint=part.joint,
        enters=part.enters.value,
        depends_on=(coordinate.name, *also),
        acts=coordinate.acts,
        x=curve.x,
        value=curve.value,
        low=curve.value - curve.reach,
        high=curve.value + curve.reach,
        unit=unit,
        x_unit=coordinate.unit,
        formula=fit_closed_form(curve.x, curve.value, curve.covariance, curve.reach),
        statement=_statement(chosen, curve, unit),
        evidence=evidence,
        curved=chosen,
        before=before,
        after=after,
        share=_share(before.of_joint(part.joint), after.of_joint(part.joint)),
        rows=rows_beside(chosen),
    )


def _share(before: Score, after: Score) -> float:
    """Share of the excess over the noise floor that the better model explains."""
    excess = before.mse - after.noise_floor**2
    return (before.mse - after.mse) / excess if excess > 0.0 else 0.0


def _statement(chosen: Curved, curve: Band, unit: str) -> str:
    """One or two sentences: over what, which way, how strong and where."""
    coordinate = chosen.model.coordinate
    most = int(np.argmax(np.abs(curve.value)))
    joint = coordinate.part.joint
    pushes = "a force" if joint is None else "a torque"
    if coordinate.part.enters is Enters.DIFFERENCE:
        pushes = "a difference of the output"
    way = WAYS.get(coordinate.acts, pushes)
    where = "" if joint is None else f" on joint {joint}"
    text = (
        f"Something that no named effect explains acts{where} as {way} that depends on {coordinate.name}: "
        f"{curve.value[most]:.3g} {unit} where it is strongest, at {curve.x[most]:.3g} {coordinate.unit}."
    )
    if holds_shape(chosen):
        text += " It is zero where it is quietest: the model's own parameters can stand for the rest."
    return text.replace("-", "−")
