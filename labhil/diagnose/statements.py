"""Entries of the answer, with their sentences: terms, curves, rivals, location and what is undecided.

``diagnosis.py`` assembles them; the data classes are in ``answer.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from labhil.diagnose import error_times, locate
from labhil.diagnose.answer import Curve, Missing, RivalTerm, Undecided
from labhil.diagnose.claim_probability import claim_probability
from labhil.diagnose.conclude import DOUBTFUL_EXCESS
from labhil.diagnose.force_curve import ForceCurve
from labhil.diagnose.minor import MIN_EXPLAINED_SHARE
from labhil.diagnose.search_result import Rival, SearchResult, Step
from labhil.identify.fitted import Fitted
from labhil.identify.intervals import quantile
from labhil.identify.score import Score
from labhil.identify.statistics import Estimate
from labhil.physics.model import Model
from labhil.physics.record import Record
from labhil.physics.terms import Enters, Term, keyed, unkeyed
from labhil.signals import FloatArray

AUGMENTED_SEARCH = (
    " The searched recording does not tell it by itself: every other part of the held-out one was searched, "
    "too, and figures are of the parts between."
)


def missing_term(
    model: Model, step: Step, result: SearchResult, final: list[Estimate], claims: int
) -> Missing:
    """The entry of a missing term.

    Args:
        model: the model.
        step: the step of the search that added it.
        result: the result of the search.
        final: rows of the final parameter table.
        claims: number of claims of the diagnosis.
    """
    (key,) = step.terms
    term = model.terms[key]
    rows = [row for row in final if (row.term, row.joint) == (term.name, term.joint)]
    some_are_known = any(row.identifiable for row in rows)
    sizes = ", ".join(
        f"{_short(row)} = {row.value:.4g} {_unit(row)}".rstrip()
        if row.identifiable or not some_are_known
        else f"{_short(row)} is not determined by these data"
        for row in rows
    )
    is_negative = bool(term.statement_if_negative) and rows[0].value < 0.0
    lacks = term.statement_if_negative if is_negative else term.statement
    posterior = 1.0 if step.probability is None else step.probability
    at = "" if term.joint is None else f" of joint {term.joint}"
    return Missing(
        term=term.name,
        joint=term.joint,
        statement=f"The model leaves out {lacks}{at}: {sizes}.{_size_note(result.final, rows)}",
        equation=term.equation,
        probability=claim_probability(claims) * posterior,
        parameters=rows,
        evidence=step.evidence,
    )


def _unit(row: Estimate) -> str:
    """Unit of an estimate, "" of a dimensionless one."""
    return "" if row.unit == "1" else row.unit


def _size_note(fitted: Fitted, rows: Sequence[Estimate]) -> str:
    """A sentence on sizes that are not identifiable individually; "" if some are."""
    combined = _combined_size(fitted, rows)
    if combined or any(row.identifiable for row in rows):
        return combined
    return " These data show that it is there, not how large it is."


def _combined_size(fitted: Fitted, rows: Sequence[Estimate]) -> str:
    """The sum or difference of two sizes where only that is known, as the width of a dead zone."""
    if len(rows) != 2 or rows[0].unit != rows[1].unit or any(row.significant for row in rows):
        return ""
    keys = [fitted.problem.model.parameters[place].key for place in fitted.problem.free]
    if any(row.key not in keys for row in rows):
        return ""
    robust, _, _ = fitted.covariances
    places = [keys.index(row.key) for row in rows]
    name, value, error = sum_or_difference(
        np.array([row.value for row in rows]), robust[np.ix_(places, places)]
    )
    interval = f"{value:.4g} ± {quantile() * error:.2g} {_unit(rows[0])}".rstrip()
    return f" Only their {name} is known: {interval} (99 %)."


def sum_or_difference(values: FloatArray, covariance: FloatArray) -> tuple[str, float, float]:
    """Choose the better known of sum and difference of two values.

    Args:
        values: both values, (2,).
        covariance: their covariance, (2, 2).

    Returns:
        "sum" or "difference", its value and its standard error.
    """
    combinations = {"sum": np.array([1.0, 1.0]), "difference": np.array([1.0, -1.0])}
    variances = {name: float(signs @ covariance @ signs) for name, signs in combinations.items()}
    name = min(variances, key=lambda combination: variances[combination])
    return name, float(combinations[name] @ values), float(np.sqrt(max(variances[name], 0.0)))


def _short(row: Estimate) -> str:
    """Name of a parameter within its term."""
    return keyed(row.name.partition(".")[2], None, row.recording)


def missing_curve(force_curve: ForceCurve, claims: int) -> Missing:
    """The entry of a force that no named term explains; arguments as of :func:`missing_term`."""
    formula = f"; about {force_curve.formula}" if force_curve.formula else ""
    return Missing(
        term=force_curve.term,
        joint=force_curve.joint,
        statement=force_curve.statement,
        equation=f"a curve over {', '.join(force_curve.depends_on)}{formula}",
        probability=claim_probability(claims) * (force_curve.probability or 1.0),
        parameters=[],
        evidence=force_curve.evidence,
    )


def curve_entry(force_curve: ForceCurve) -> Curve:
    """The curve of a force that no named term explains, without its fit."""
    return Curve(
        depends_on=force_curve.depends_on[0],
        acts=force_curve.acts.name.lower(),
        x=force_curve.x,
        value=force_curve.value,
        low=force_curve.low,
        high=force_curve.high,
        unit=force_curve.unit,
        x_unit=force_curve.x_unit,
        formula=force_curve.formula,
        share=force_curve.share,
        joint=force_curve.joint,
    )


def rival_term(model: Model, rival: Rival, claims: int) -> RivalTerm:
    """The entry of a rival, with the excitation that would decide; arguments as of :func:`missing_term`."""
    term = model.terms[rival.term]
    return RivalTerm(
        term=term.name,
        instead_of=rival.instead_of,
        joint=term.joint,
        probability=claim_probability(claims) * rival.probability,
        delta_bic=rival.delta_bic,
        distinguishable=False,
        experiment=f"excite with {term.revealed_by}",
    )


def _minor_terms(result: SearchResult) -> tuple[Undecided, ...]:
    """Entries of terms that explain no more than an imperfect law of a larger effect leaves."""
    share = f"{100.0 * MIN_EXPLAINED_SHARE:.0f} %"
    reason = (
        f"below the noise and {share} of the mismatch, as what an imperfect law of a larger effect leaves"
    )
    terms = sorted(unkeyed(minor.term) for minor in result.minor)
    return tuple(Undecided(*term, (), reason) for term in terms)


def _doubtful_terms(result: SearchResult) -> tuple[Undecided, ...]:
    """Entries of terms that were to be named, but explain nothing of held-out data."""
    reason = "the best explanation found, but held-out data are predicted no better with it"
    return tuple(Undecided(*unkeyed(term), (), reason) for term in result.doubtful)


def _open_terms(result: SearchResult) -> tuple[Undecided, ...]:
    """Entries of terms that are about as likely as not, and neither named nor rivals."""
    listed = {*result.final.terms, *result.doubtful, *(rival.term for rival in result.rivals)}
    reason = "these data speak neither for nor against"
    return tuple(Undecided(*unkeyed(term), (), reason) for term in result.open if term not in listed)


def undecided_terms(result: SearchResult) -> tuple[Undecided, ...]:
    """Entries of all terms that a search leaves undecided."""
    return (*_doubtful_terms(result), *_minor_terms(result), *_open_terms(result))


def unobservable_terms(model: Model) -> tuple[Undecided, ...]:
    """Entries of terms that no recording of this rig can show, with the reason."""
    return tuple(Undecided(*unkeyed(key), (), reason) for key, reason in model.unobservable_terms.items())


def location(
    result: SearchResult,
    before: Score,
    after: Score,
    held_out: Record,
    curves: Sequence[ForceCurve],
    *,
    augmented: bool,
) -> locate.Location | None:
    """Locate the mismatch in time and along a coordinate.

    Args:
        result: the result of the search.
        before: score of the baseline on held-out data.
        after: score of the final model on the same windows.
        held_out: the held-out data.
        curves: forces that no named term explains, the strongest first.
        augmented: whether the search had half of the held-out data.

    Returns:
        The location, or None without any missing effect.
    """
    if result.missing:
        place = _named_location(result, before, after, held_out)
    elif curves:
        place = _curve_location(result, before, after, held_out, curves[0])
    else:
        return None
    return replace(
        place,
        statement=place.statement
        + (AUGMENTED_SEARCH if augmented else error_times.recording_shares(before, after)),
    )


def _named_location(result: SearchResult, before: Score, after: Score, held_out: Record) -> locate.Location:
    """The location of named terms."""
    model = result.final.problem.model
    strongest = model.terms[result.missing[0].terms[0]]
    scores = locate.HeldOut(held_out, before, after)
    terms = [step.terms[0] for step in result.missing]
    channel, joint = _channel(before, after)
    _, regimes = locate.locate_terms(result.final, terms, scores, joint)
    times, recordings = error_times.times(before, after, held_out)
    return locate.Location(
        channel=channel,
        joint=joint,
        enters=strongest.enters.value,
        times=times,
        regimes=tuple(regime for ranges in regimes.values() for regime in ranges),
        statement=location_statement(keyed(channel, joint), strongest, regimes),
        recordings=recordings,
    )


ERROR_KINDS = {
    Enters.RIG: "a wrong size of the rig",
    Enters.FORCE: "a missing force",
    Enters.INPUT: "an effect at the input",
    Enters.OUTPUT: "an effect of the measurement",
    Enters.ELECTRICAL: "a missing electrical effect",
    Enters.MAGNETIC: "a missing magnetic effect",
    Enters.LOAD: "a missing load",
    Enters.DIFFERENCE: "a difference between simulation and measurement",
}
"""What an error is, by where its cause enters the model."""


def location_statement(
    channel: str, strongest: Term, regimes: Mapping[str, tuple[locate.Regime, ...]]
) -> str:
    """State in two sentences which effect is the strongest, where it enters, and where an effect acts.

    Args:
        channel: the output with the largest error.
        strongest: the strongest missing term.
        regimes: ranges of each missing term.
    """
    error = f"The error in {channel} is {ERROR_KINDS[strongest.enters]}, mostly {strongest.key}."
    named = next(((term, ranges) for term, ranges in regimes.items() if ranges), None)
    if named is None:
        return f"{error} It is spread over all that was visited."
    term, ranges = named
    share = sum(regime.share_of_excess for regime in ranges)
    between = " or ".join(f"between {r.low:.3g} and {r.high:.3g}" for r in ranges).replace("-", "−")
    coordinate = ranges[0].coordinate
    at = "where it is" if coordinate == term else f"at {coordinate}"
    effect = f"{100 * share:.0f} % of the effect of {term} is {at} {between} {ranges[0].unit}".rstrip()
    return f"{error} {effect}."


def _curve_location(
    result: SearchResult, before: Score, after: Score, held_out: Record, force_curve: ForceCurve
) -> locate.Location:
    """The location of a force that no named term explains."""
    name, model = force_curve.depends_on[0], force_curve.model
    record, windows, states, counted = locate.HeldOut(held_out, before, after).motion
    motion = model.coordinates(force_curve.fit.theta, record, windows, states)
    along = model.coordinate.values(motion)[counted]
    regimes = locate.regimes({name: along}, np.interp(along, force_curve.x, force_curve.value) ** 2)
    channel, joint = _channel(before, after)
    times, recordings = error_times.times(before, after, held_out)
    return locate.Location(
        channel=channel,
        joint=joint,
        enters=force_curve.enters,
        times=times,
        regimes=tuple(
            replace(regime, unit=force_curve.x_unit, term=force_curve.term, joint=force_curve.joint)
            for regime in regimes
        ),
        statement=f"The error in {keyed(channel, joint)} is {ERROR_KINDS[Enters(force_curve.enters)]} that "
        f"follows {name}.{_remaining_joints(after)}",
        recordings=recordings,
    )


def _remaining_joints(after: Score, min_excess: float = DOUBTFUL_EXCESS) -> str:
    """A sentence on the joints that still leave more than noise; "" if none do."""
    ratios = {
        keyed(c.channel, c.joint): c.rmse / c.noise_floor for c in after.channels if c.joint is not None
    }
    remaining = [
        f"{key} {ratio:.1f} times its noise floor" for key, ratio in ratios.items() if ratio > min_excess
    ]
    return f" That is not all: it leaves {', '.join(remaining)}." if remaining else ""


def _channel(before: Score, after: Score) -> tuple[str, int | None]:
    """The output whose mean square error falls most, in squared noise floors."""
    gains = [(b.mse - a.mse) / a.noise_floor**2 for b, a in zip(before.channels, after.channels, strict=True)]
    most = before.channels[int(np.argmax(gains))]
    return most.channel, most.joint
