"""Forces that no named term explains, beside what was found: of a single part, or joint by joint.

Named terms that only stood in for such a force give way to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labhil.diagnose.curve import criterion
from labhil.diagnose.evidence import Left, bic, effective_samples, unlikelier
from labhil.diagnose.foretold import foretold
from labhil.diagnose.found import Found, Step
from labhil.diagnose.judge import NEEDED_BIC, Data
from labhil.diagnose.refit import refit, without
from labhil.diagnose.rest import UNEXPLAINED, left_by, stands_in, unexplained
from labhil.diagnose.unmodelled import Unmodelled, unmodelled
from labhil.diagnose.weigh import supported_only
from labhil.identify.fitted import Fitted
from labhil.identify.kept_curve import under
from labhil.identify.table import table_of
from labhil.identify.window_states import States, tried
from labhil.physics.extra_force import MovedPart, Yielding
from labhil.physics.model import Model
from labhil.physics.terms import Enters

SURELY, MISNAMED = 2.5, 1.5
"""RMSE over the noise floor that no noise makes, and that doubts what was found.

The floor of a few windows is not well known: each has only one error of its initial state.
"""

OF_A_JOINT = 1.15
"""What a joint leaves, in units of its noise, from which a force on it is looked for.

That is a linear problem, which what the joint moves through poses thousands of times.
"""

DOUBTFUL, NOTHING_NAMED = 1.05, 1.15
"""The same from which on named forces are compared with a curve in their place, or no force with one."""

INFLATED = np.sqrt(10.0)
"""A size is not known beside a curve that makes its standard error so many times as large.

The usual limit of the variance's inflation by what is collinear.
"""


CONSTANT = "constant_force"

MOST = 0.5
"""Share of what the baseline leaves beyond noise that is most of it."""


def beyond(data: Data, found: Found, excess: float) -> tuple[Found, tuple[Unmodelled, ...]]:
    """Forces that no named term explains, and what was found without the terms that they make needless.

    ``excess`` is the worst output's over its noise floor, by the metric.
    The joints of an arm have their turns by what is left of them, each beside the curves of those before it,
    until little is left or the worst of what is little more than noise has none.
    """
    model, curves = data.model, tuple[Unmodelled, ...]()
    if not isinstance(model, Yielding):
        return found, ()
    waiting = list(model.moved)
    while waiting:
        part, most = _worst(data, found, curves, waiting)
        if most < OF_A_JOINT:
            break
        found, curve = _of_part(data, found, curves, part, excess)
        if curve is None and most < MISNAMED:
            break
        curves = curves if curve is None else (*curves, curve)
        waiting.remove(part)
    return found, curves


def strongest(curves: Sequence[Unmodelled]) -> list[Unmodelled]:
    """Those that bring held-out data closest to the noise first."""
    return sorted(curves, key=lambda curve: -curve.evidence.heldout_loglik_gain)


def _worst(
    data: Data, found: Found, curves: Sequence[Unmodelled], parts: Sequence[MovedPart]
) -> tuple[MovedPart, float]:
    """The part whose output leaves most, and how much that is, in units of the noise."""
    if len(parts) == 1 and parts[0].joint is None:
        return parts[0], float("inf")
    left = np.max(left_by(*_beside(data, found.final, curves)), axis=0)
    of_joint = dict(zip(data.search.output_joints, left.tolist(), strict=True))
    worst = max(parts, key=lambda part: of_joint[part.joint])
    return worst, of_joint[worst.joint]


def _of_part(
    data: Data, found: Found, curves: Sequence[Unmodelled], part: MovedPart, excess: float
) -> tuple[Found, Unmodelled | None]:
    """The force on one part, and what was found without the terms there that it makes needless.

    Where a curve is the answer, or none is and most of the excess is still there, named terms only stood in
    for something else.
    """
    beside = _curve(data, found.final, curves, part)
    own = [step for step in found.missing if data.model.terms[step.terms[0]].joint == part.joint]
    if not own:
        return found, beside
    doubtful = _not_constant(data, found, own)
    if beside is None:
        return (found, None) if part.joint is not None else _instead(data, found, part, excess)
    simpler = _less(data, found, doubtful)
    alone = _curve(data, simpler.final, curves, part) if doubtful else None
    # what is named beside a curve needs as strong evidence as without one, of as many candidates
    needed = 2.0 * len(doubtful) * np.log(found.looks) - NEEDED_BIC
    if doubtful and alone is not None and _behind(data, alone, beside) < needed:
        return simpler, alone
    return found, _told_apart(data, found, curves, part, own, beside)


def _not_constant(data: Data, found: Found, steps: Sequence[Step]) -> list[Step]:
    """The steps that a curve may take the place of: not a constant force that explains most by itself.

    Every curve has a constant part, so beside one nothing speaks for such a force, however large it is.
    """
    others = [step for step in steps if data.model.terms[step.terms[0]].name != CONSTANT]
    if len(others) == len(steps):
        return others
    before, after = found.baseline.solution.cost, _less(data, found, others).final.solution.cost
    return others if before - after > MOST * (before - found.baseline.dof) else list(steps)


def _told_apart(
    data: Data,
    found: Found,
    curves: Sequence[Unmodelled],
    part: MovedPart,
    doubtful: Sequence[Step],
    beside: Unmodelled,
) -> Unmodelled | None:
    """The curve beside named forces: where it leaves the size of one unknown, beside sizes that are held.

    All that were known without it: a curve over the same coordinate can stand for them. None where that is
    all that it does.
    """
    known = {row.key: row.std_error for row in table_of(found.final).rows if row.significant}
    lost = {
        row.key
        for row in beside.rows
        if row.key in known and not (row.significant and row.std_error < INFLATED * known[row.key])
    }
    named = {p.key for step in doubtful for p in data.model.terms[step.terms[0]].parameters}
    if not lost & named:
        return beside
    held = replace(data, held=data.held | lost, window=found.final.window)
    return _curve(held, refit(held, found.final, found.final.terms, ()), curves, part)


def imitated(data: Data, found: Found, excess: float) -> tuple[Found, tuple[Unmodelled, ...]]:
    """What was found, or a curve where named forces only imitate that, or where nothing was found.

    It is looked for where the worst output of a single part is off by ``excess`` times its noise floor, more
    where nothing was found, and where there are several such forces.
    """
    model = data.model
    forces = _forces(model, found)
    doubtful = excess >= (DOUBTFUL if found.missing else NOTHING_NAMED) or len(forces) > 1
    if (found.missing and not forces) or not doubtful:
        return found, ()
    if not isinstance(model, Yielding) or len(model.moved) > 1:
        return found, ()
    found, curve = _or_curve(data, found, model.moved[0], excess)
    return found, (() if curve is None else (curve,))


def _instead(data: Data, found: Found, part: MovedPart, excess: float) -> tuple[Found, Unmodelled | None]:
    """A curve in the place of named terms, or nothing where these only stood in for something else."""
    found, curve = _or_curve(data, found, part, excess)
    replaced = curve is not None or not stands_in(found.baseline, found.final)
    forces = _forces(data.model, found)
    if not replaced and forces and unexplained(data, left_by(data, found.final)):
        return _still_supported(data, _less(data, found, forces)), None
    return found, curve


def _or_curve(data: Data, found: Found, part: MovedPart, excess: float) -> tuple[Found, Unmodelled | None]:
    """What was found, or a curve alone where that has very strong evidence over the named terms.

    Over one that leaves an ``excess`` of more than noise, and over several forces, it needs no more than that
    it is likelier, each of these chosen among as many (the extended BIC): that a rig has them all is less
    likely than that it has one which they imitate.
    """
    doubtful = _not_constant(data, found, found.missing)
    simpler = _less(data, found, doubtful)
    alone = _curve(data, simpler.final, (), part) if doubtful or not found.missing else None
    if alone is None:
        return found, None
    named = len(_forces(data.model, found))
    chance = 2.0 * max(named - 1, 0) * np.log(found.looks)
    needed = NEEDED_BIC if named < 2 and excess < UNEXPLAINED else 0.0
    behind = _behind(data, alone, settled(data, found.final, alone.fit))
    return (simpler, alone) if behind - chance < needed else (found, None)


def _behind(data: Data, alone: Unmodelled, named: Fitted | Unmodelled) -> float:
    """−2 times the log odds of a curve against named terms, by themselves or beside another one.

    Of an arm by the searched data alone, and by the joint's own output.
    """
    effective = effective_samples(alone.fit, alone.joint)
    seen = criterion(alone.curved, effective)
    if isinstance(named, Unmodelled):
        seen -= criterion(named.curved, effective)
    else:
        seen -= bic(named, effective, joint=alone.joint)
    if not data.model.state_names:
        return seen
    return seen + unlikelier(_foretold(data, named), _foretold(data, alone))


def _foretold(data: Data, each: Fitted | Unmodelled) -> Left:
    if isinstance(each, Unmodelled):
        return foretold(data, each.fit, each.curved.penalty)
    return foretold(data, each)


def _forces(model: Model, found: Found) -> list[Step]:
    """What was found that pushes a moving part."""
    return [step for step in found.missing if model.terms[step.terms[0]].enters is Enters.FORCE]


def _less(data: Data, found: Found, steps: Sequence[Step]) -> Found:
    """What was found without some of its steps, on the same windows."""
    if not steps:
        return found
    kept = tuple(step for step in found.missing if step not in steps)
    if not kept:
        return found.nothing
    terms = found.final.terms
    for step in steps:
        terms = without(data.model, terms, step.terms[0])
    return found.ending(refit(replace(data, window=found.final.window), found.final, terms, ()), kept)


def _still_supported(data: Data, found: Found) -> Found:
    """What is still supported where forces went: a sensor's offset may show by a spring only."""
    if not found.missing:
        return found
    base = refit(data, found.baseline, found.baseline.terms, ())
    return found.ending(*supported_only(data, base, found.final, found.looks))


def _curve(data: Data, final: Fitted, curves: Sequence[Unmodelled], part: MovedPart) -> Unmodelled | None:
    """A force beside a fit, judged on windows as long as those of that fit."""
    data, final = _beside(data, final, curves)
    return unmodelled(replace(data, window=final.window), final, part)


def settled(data: Data, final: Fitted, curved: Fitted) -> Fitted:
    """The same terms where windows have looked for better states, also at those that they have under a curve.

    A curve that only found a window's state would be taken for physics.
    """
    searched = refit(replace(data, window=final.window), final, final.terms, (), thorough=True)
    problem, point = searched.problem, searched.solution.point
    own = States(point.states, searched.solution.residuals)
    # under a curve over a place that recordings do not tell, windows have that as one more state
    common = curved.solution.point.states[:, : point.states.shape[1]]
    better = own.or_better(problem, tried(problem, point.z, common))
    if better.cost == own.cost:
        return searched
    begun = replace(searched, solution=replace(searched.solution, point=replace(point, states=better.states)))
    return refit(replace(data, window=final.window), begun, final.terms, ())


def _beside(data: Data, final: Fitted, curves: Sequence[Unmodelled]) -> tuple[Data, Fitted]:
    """Data whose model is under these curves, and a fit of it with the same terms."""
    if not curves:
        return data, final
    assert isinstance(data.model, Yielding)
    data = replace(data, model=under(data.model, [curve.kept for curve in curves], data.search))
    return data, refit(data, final, final.terms, ())
