"""One trial judged: the stated answer against the truth, by the contract's rules."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labhil.campaign.trials.answer import Answer, TrueEffect
from labhil.campaign.trials.stated_answer import Named, StatedAnswer
from labhil.physics.terms import keyed, unkeyed

NULL_GAIN = 3.0
"""Oracle's gain (nats) below which an effect does not count as a difference."""
SURE_GAIN = 10.0
"""Oracle's gain (nats) from which an effect has to be named."""
RIVAL_LOSS = 5.0
"""Nats by which a rival, refitted, may fall short of the truth and still be an honest one."""
MODELLED = 0.8
UNMODELLED = "unmodelled"
NONE = "none"
UNNAMED = frozenset({"unexplained_mismatch", "not_decidable"})
"""Verdicts that blame no physics."""
OUTSIDE = "outside the catalogue"

Loss = Callable[[TrueEffect, str], float]


@dataclass(frozen=True, slots=True)
class Judged:
    """What counts of one trial.

    ``nothing`` says that nothing was concealed; ``real`` effects make a difference to the oracle (none is a
    ``null``), ``sure`` ones have to be named (10 nats or more); ``exact`` says that they were named and
    nothing else was, ``single`` that no name of the answer had a rival beside it.
    ``confused`` holds pairs of true and named terms, ``claims`` pairs of a stated probability and whether it
    was right, ``covered`` for each interval whether it holds the truth, ``complete`` whether the final model
    holds every listed effect. ``modelled`` and ``after_over_floor`` are None where there is nothing
    to compare. ``joints`` holds for each sure effect in a joint whether the answer names that joint.
    ``disturbed`` says that more acted on the rig than any model has.
    """

    trial: str
    verdict: str | None
    nothing: bool
    null: bool
    real: tuple[TrueEffect, ...]
    sure: tuple[TrueEffect, ...]
    strongest: float | None
    detected: bool
    exact: bool
    single: bool
    confused: tuple[tuple[str, str], ...]
    claims: tuple[tuple[float, bool], ...]
    covered: tuple[bool, ...]
    complete: bool
    modelled: bool | None
    after_over_floor: float | None
    overlap: float | None
    seconds: float
    joints: tuple[bool, ...] = ()
    disturbed: bool = False

    @property
    def alarm(self) -> bool:
        """Whether the answer reports a mismatch; a disturbed rig's may be left unexplained."""
        return self.verdict != "no_mismatch" and not (self.disturbed and self.verdict in UNNAMED)


@dataclass(frozen=True, slots=True)
class Matched:
    """Which claim stands for which effect; ``over`` are claims that stand for none."""

    pairs: tuple[tuple[TrueEffect, Named], ...]
    over: tuple[Named, ...]

    def of(self, effect: TrueEffect) -> Named | None:
        """The claim for this effect."""
        return next((named for true, named in self.pairs if true is effect), None)


def judge(answer: Answer, stated: StatedAnswer, loss: Loss, overlap: float | None = None) -> Judged:
    """Judge a trial; ``loss`` is how many nats a rival, refitted in the place of an effect, loses to it."""
    real = [effect for effect in answer.effects if effect.oracle_gain >= NULL_GAIN]
    sure = sorted(
        (effect for effect in real if effect.oracle_gain >= SURE_GAIN), key=lambda effect: -effect.oracle_gain
    )
    optional = [effect for effect in real if effect not in sure]
    claims = claims_of(stated)
    matched = match([*sure, *optional], claims)
    matching = [matched.of(effect) for effect in sure]
    honest = all(
        named is not None and is_honest(effect, named, loss)
        for effect, named in zip(sure, matching, strict=True)
    )
    exact = bool(sure) and honest and not matched.over
    return Judged(
        trial=answer.trial,
        verdict=stated.verdict,
        nothing=not answer.effects,
        null=not real,
        real=tuple(real),
        sure=tuple(sure),
        strongest=max((effect.strength for effect in real), default=None),
        detected=stated.verdict in {"missing_physics", "unexplained_mismatch"},
        exact=exact,
        single=exact and all(named is not None and not named.rivals for named in matching),
        confused=confusions(sure, bool(real), matched, stated),
        claims=_claims(real, stated),
        covered=_coverage(answer, stated),
        complete=_holds_all(real, stated),
        modelled=_is_modelled(answer, stated) if sure else None,
        after_over_floor=_after_over_floor(answer, stated),
        overlap=overlap,
        seconds=stated.seconds,
        joints=_joints(sure, stated),
        disturbed="disturbance" in answer.conditions,
    )


def claims_of(stated: StatedAnswer) -> tuple[Named, ...]:
    """The claims of an answer; an unexplained mismatch claims an effect without a name."""
    if stated.verdict == "unexplained_mismatch" and not stated.named:
        return (Named(UNMODELLED, None),)
    return stated.named


def fits(effect: TrueEffect, name: str) -> bool:
    """Whether a name, with its joint, is right for an effect; one outside the catalogue has no own name.

    What pulls at several joints shows in any of them.
    """
    if not effect.catalogue:
        return name.startswith(UNMODELLED) and (
            effect.joint is None or unkeyed(name)[1] in (None, effect.joint)
        )
    return name == keyed(effect.term, effect.joint)


def match(effects: Sequence[TrueEffect], claims: Sequence[Named]) -> Matched:
    """Give every effect the claim whose first choice it is, then one that has it among the rivals.

    What is outside the catalogue and acts on several joints may have a curve on each of them.
    """
    unmatched = list(claims)
    pairs: list[tuple[TrueEffect, Named]] = []
    for first_only in (True, False):
        for effect in effects:
            if any(paired is effect for paired, _ in pairs):
                continue
            names = [(claim, claim.names[:1] if first_only else claim.names) for claim in unmatched]
            claim = next(
                (c for c, candidates in names if any(fits(effect, name) for name in candidates)), None
            )
            if claim is not None:
                pairs.append((effect, claim))
                unmatched.remove(claim)
    shared = [effect for effect, _ in pairs if not effect.catalogue and effect.joint is None]
    over = [claim for claim in unmatched if not any(fits(effect, claim.term) for effect in shared)]
    return Matched(tuple(pairs), tuple(over))


def is_honest(effect: TrueEffect, named: Named, loss: Loss) -> bool:
    """Whether the truth is among the names and every other one explains the test data nearly as well."""
    others = [name for name in named.names if not fits(effect, name)]
    return len(others) < len(named.names) and all(loss(effect, name) < RIVAL_LOSS for name in others)


def confusions(
    sure: Sequence[TrueEffect], differs: bool, matched: Matched, stated: StatedAnswer
) -> tuple[tuple[str, str], ...]:
    """Pairs of true and named term: an effect that was not named stands beside what was named in its place.

    A trial without sure effects enters where it is a null, with its verdict.
    """
    over = [named.term for named in matched.over]
    pairs = []
    for effect in sure:
        named = matched.of(effect)
        label = keyed(effect.term, effect.joint) if effect.catalogue else OUTSIDE
        if named is not None:
            pairs.append((label, UNMODELLED if named.term.startswith(UNMODELLED) else named.term))
        else:
            pairs.append((label, over.pop(0) if over else _label_without_name(stated)))
    if not sure and not differs and not over:
        pairs.append((NONE, _label_without_name(stated)))
    return (*pairs, *((NONE, name) for name in over))


def _label_without_name(stated: StatedAnswer) -> str:
    """What stands in the place of a name where there is none."""
    if stated.verdict is None:
        return "failed"
    return NONE if stated.verdict in {"no_mismatch", "missing_physics"} else stated.verdict


def _claims(real: Sequence[TrueEffect], stated: StatedAnswer) -> tuple[tuple[float, bool], ...]:
    claims = [pair for named in stated.named for pair in ((named.term, named.probability), *named.rivals)]
    return tuple(
        (float(p), any(fits(effect, name) for effect in real)) for name, p in claims if p is not None
    )


def _joints(sure: Sequence[TrueEffect], stated: StatedAnswer) -> tuple[bool, ...]:
    """Whether each effect in a joint was named in the right one; empty where no effect was named."""
    if stated.verdict != "missing_physics":
        return ()
    named = {unkeyed(named.term)[1] for named in stated.named} - {None} or {stated.joint}
    return tuple(effect.joint in named for effect in sure if effect.joint is not None)


def _coverage(answer: Answer, stated: StatedAnswer) -> tuple[bool, ...]:
    return tuple(
        row.low <= answer.truth[row.key] <= row.high for row in stated.intervals if row.key in answer.truth
    )


def _holds_all(real: Sequence[TrueEffect], stated: StatedAnswer) -> bool:
    held = set(stated.final_terms)
    return all(
        effect.catalogue and bool({effect.term, keyed(effect.term, effect.joint)} & held) for effect in real
    )


def _is_modelled(answer: Answer, stated: StatedAnswer) -> bool:
    """Whether the excess over the true noise floor has gone, in squares of the floor."""
    marks = _errors_over_floors(answer, stated)
    if not marks:
        return False
    before, after = (float(np.mean([mark[k] ** 2 for mark in marks])) for k in (0, 1))
    return before > 1.0 and (before - after) / (before - 1.0) >= MODELLED


def _after_over_floor(answer: Answer, stated: StatedAnswer) -> float | None:
    marks = _errors_over_floors(answer, stated)
    return float(np.mean([after for _, after in marks])) if marks else None


def _errors_over_floors(answer: Answer, stated: StatedAnswer) -> list[tuple[float, float]]:
    """RMSE before and after of every output over its true noise floor; nothing where an output is missing."""
    figures = {f.channel: f for f in stated.figures}
    if not set(answer.noise_floors) <= set(figures):
        return []
    return [
        (figures[name].rmse_before / floor, figures[name].rmse_after / floor)
        for name, floor in answer.noise_floors.items()
    ]
