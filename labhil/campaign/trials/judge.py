"""The judgement of one trial: the stated answer against the truth.

``score.py`` judges all trials of a folder, ``card.py`` counts them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labhil.campaign.trials.answer import Answer, TrueEffect
from labhil.campaign.trials.stated_answer import NamedEffect, StatedAnswer
from labhil.physics.terms import keyed, unkeyed

MIN_DETECTABLE_GAIN = 3.0
"""Gain (nats) on the test data below which the oracle does not detect an effect."""
MIN_REQUIRED_GAIN = 10.0
"""Gain (nats) on the test data from which a diagnosis has to name an effect."""
MAX_RIVAL_LOSS = 5.0
"""Loss (nats) of a refitted rival against the true effect up to which it is a legitimate rival."""
UNMODELLED = "unmodelled"
OTHER_LAWS = {"maxwell_slip_friction": "presliding_friction"}
"""Effects outside the catalogue that are the same physics as a term of it, with another law."""
NONE = "none"
UNNAMED = frozenset({"unexplained_mismatch", "not_decidable"})
"""Verdicts that name no missing physics."""
OUTSIDE = "outside the catalogue"

Loss = Callable[[TrueEffect, str], float]


@dataclass(frozen=True, slots=True)
class JudgedTrial:
    """What is counted of one trial.

    Attributes:
        trial: its name.
        verdict: the stated verdict, None where the diagnosis failed.
        is_empty: whether nothing was concealed.
        is_null: whether the oracle detects no concealed effect.
        detectable: effects that the oracle detects (``MIN_DETECTABLE_GAIN``).
        required: those that have to be named (``MIN_REQUIRED_GAIN``), the largest gain first.
        strongest: strength of the strongest detectable effect.
        detected: whether the answer reports a mismatch.
        exact: whether all required effects were named and nothing else was.
        unrivalled: whether the answer is exact and none of its names has a rival.
        confusions: pairs of true and named term.
        claims: pairs of a stated probability and whether the name was right.
        coverage: whether each interval contains the truth.
        is_complete: whether the final model contains every detectable effect.
        modelled: whether the excess error is modelled; None where nothing has to be named.
        after_over_floor: RMSE after over the noise floor; None where there is nothing to compare.
        overlap: agreement of the reported regimes with the true one.
        seconds: time of the diagnosis, s.
        right_joints: for each required effect in a joint, whether the answer names that joint.
        disturbed: whether a disturbance acted that no model has.
    """

    trial: str
    verdict: str | None
    is_empty: bool
    is_null: bool
    detectable: tuple[TrueEffect, ...]
    required: tuple[TrueEffect, ...]
    strongest: float | None
    detected: bool
    exact: bool
    unrivalled: bool
    confusions: tuple[tuple[str, str], ...]
    claims: tuple[tuple[float, bool], ...]
    coverage: tuple[bool, ...]
    is_complete: bool
    modelled: bool | None
    after_over_floor: float | None
    overlap: float | None
    seconds: float
    right_joints: tuple[bool, ...] = ()
    disturbed: bool = False

    @property
    def reports_mismatch(self) -> bool:
        """Whether the answer reports missing physics or an unexplained mismatch; of a disturbed rig, physics.

        A changed value is neither: only a user's own simulator states values, which are not the plant's.
        """
        if self.verdict in ("no_mismatch", "parameter_change"):
            return False
        return not (self.disturbed and self.verdict in UNNAMED)


@dataclass(frozen=True, slots=True)
class Matching:
    """Pairs of an effect and the claim that names it, and claims that name none."""

    pairs: tuple[tuple[TrueEffect, NamedEffect], ...]
    unmatched_claims: tuple[NamedEffect, ...]

    def claim_for(self, effect: TrueEffect) -> NamedEffect | None:
        """Return the claim that names this effect."""
        return next((named for true, named in self.pairs if true is effect), None)


def judge(answer: Answer, stated: StatedAnswer, loss: Loss, overlap: float | None = None) -> JudgedTrial:
    """Judge one trial.

    Args:
        answer: the truth.
        stated: the answer of the diagnosis.
        loss: returns how many nats a rival, refitted in the place of a true effect, loses to it.
        overlap: agreement of the reported regimes with the true one.
    """
    detectable = [effect for effect in answer.effects if effect.oracle_gain >= MIN_DETECTABLE_GAIN]
    required = sorted(
        (effect for effect in detectable if effect.oracle_gain >= MIN_REQUIRED_GAIN),
        key=lambda effect: -effect.oracle_gain,
    )
    optional = [effect for effect in detectable if effect not in required]
    claims = claimed_effects(stated)
    matching = match_claims([*required, *optional], claims)
    matching_claims = [matching.claim_for(effect) for effect in required]
    acceptable = all(
        named is not None and is_acceptable(effect, named, loss)
        for effect, named in zip(required, matching_claims, strict=True)
    )
    exact = bool(required) and acceptable and not matching.unmatched_claims
    return JudgedTrial(
        trial=answer.trial,
        verdict=stated.verdict,
        is_empty=not answer.effects,
        is_null=not detectable,
        detectable=tuple(detectable),
        required=tuple(required),
        strongest=max((effect.strength for effect in detectable), default=None),
        detected=stated.verdict in {"missing_physics", "unexplained_mismatch"},
        exact=exact,
        unrivalled=exact and all(named is not None and not named.rivals for named in matching_claims),
        confusions=confusion_pairs(required, bool(detectable), matching, stated),
        claims=_claim_outcomes(detectable, stated),
        coverage=_coverage(answer, stated),
        is_complete=_model_is_complete(detectable, stated),
        modelled=_is_modelled(answer, stated) if required else None,
        after_over_floor=_after_over_floor(answer, stated),
        overlap=overlap,
        seconds=stated.seconds,
        right_joints=_right_joints(required, stated),
        disturbed="disturbance" in answer.conditions,
    )


def claimed_effects(stated: StatedAnswer) -> tuple[NamedEffect, ...]:
    """Return the effects that an answer claims; an unexplained mismatch claims one without a name."""
    if stated.verdict == "unexplained_mismatch" and not stated.named:
        return (NamedEffect(UNMODELLED, None),)
    return stated.named


def is_right_name(effect: TrueEffect, name: str) -> bool:
    """Return whether a name, with its joint, is right for an effect.

    An effect outside the catalogue has no name of its own, or that of a term with another law for the same
    physics; one that acts on several joints may be claimed in any of them.
    """
    if not effect.catalogue:
        if name == OTHER_LAWS.get(effect.term):
            return True
        return name.startswith(UNMODELLED) and (
            effect.joint is None or unkeyed(name)[1] in (None, effect.joint)
        )
    return name == keyed(effect.term, effect.joint)


def match_claims(effects: Sequence[TrueEffect], claims: Sequence[NamedEffect]) -> Matching:
    """Assign to every effect the claim whose first name it is, else one that has it among its rivals.

    An effect outside the catalogue that acts on several joints may have a curve on each of them.
    """
    unmatched = list(claims)
    pairs: list[tuple[TrueEffect, NamedEffect]] = []
    for first_only in (True, False):
        for effect in effects:
            if any(paired is effect for paired, _ in pairs):
                continue
            names = [(claim, claim.names[:1] if first_only else claim.names) for claim in unmatched]
            claim = next(
                (c for c, candidates in names if any(is_right_name(effect, name) for name in candidates)),
                None,
            )
            if claim is not None:
                pairs.append((effect, claim))
                unmatched.remove(claim)
    shared = [effect for effect, _ in pairs if not effect.catalogue and effect.joint is None]
    unmatched_claims = [
        claim for claim in unmatched if not any(is_right_name(effect, claim.term) for effect in shared)
    ]
    return Matching(tuple(pairs), tuple(unmatched_claims))


def is_acceptable(effect: TrueEffect, named: NamedEffect, loss: Loss) -> bool:
    """Return whether a claim has the true name, and its other names explain the test data nearly as well."""
    others = [name for name in named.names if not is_right_name(effect, name)]
    return len(others) < len(named.names) and all(loss(effect, name) < MAX_RIVAL_LOSS for name in others)


def confusion_pairs(
    required: Sequence[TrueEffect], differs: bool, matching: Matching, stated: StatedAnswer
) -> tuple[tuple[str, str], ...]:
    """Return pairs of true and named term.

    An effect that was not named is paired with an unmatched claim or with the verdict; a null is paired with
    its verdict.
    """
    unmatched_claims = [named.term for named in matching.unmatched_claims]
    pairs = []
    for effect in required:
        named = matching.claim_for(effect)
        label = keyed(effect.term, effect.joint) if effect.catalogue else OUTSIDE
        if named is not None:
            pairs.append((label, UNMODELLED if named.term.startswith(UNMODELLED) else named.term))
        else:
            pairs.append(
                (label, unmatched_claims.pop(0) if unmatched_claims else _label_without_name(stated))
            )
    if not required and not differs and not unmatched_claims:
        pairs.append((NONE, _label_without_name(stated)))
    return (*pairs, *((NONE, name) for name in unmatched_claims))


def _label_without_name(stated: StatedAnswer) -> str:
    """Return the label of an answer without a name."""
    if stated.verdict is None:
        return "failed"
    return NONE if stated.verdict in {"no_mismatch", "missing_physics"} else stated.verdict


def _claim_outcomes(detectable: Sequence[TrueEffect], stated: StatedAnswer) -> tuple[tuple[float, bool], ...]:
    claims = [pair for named in stated.named for pair in ((named.term, named.probability), *named.rivals)]
    return tuple(
        (float(p), any(is_right_name(effect, name) for effect in detectable))
        for name, p in claims
        if p is not None
    )


def _right_joints(required: Sequence[TrueEffect], stated: StatedAnswer) -> tuple[bool, ...]:
    """Return for each effect in a joint whether that joint was named; empty where no effect was named."""
    if stated.verdict != "missing_physics":
        return ()
    named = {unkeyed(named.term)[1] for named in stated.named} - {None} or {stated.joint}
    return tuple(effect.joint in named for effect in required if effect.joint is not None)


def _coverage(answer: Answer, stated: StatedAnswer) -> tuple[bool, ...]:
    return tuple(
        row.low <= answer.truth[row.key] <= row.high for row in stated.intervals if row.key in answer.truth
    )


def _model_is_complete(detectable: Sequence[TrueEffect], stated: StatedAnswer) -> bool:
    final_terms = set(stated.final_terms)
    return all(
        effect.catalogue and bool({effect.term, keyed(effect.term, effect.joint)} & final_terms)
        for effect in detectable
    )


def _is_modelled(answer: Answer, stated: StatedAnswer, min_explained: float = 0.8) -> bool:
    """Return whether this share of the squared excess over the true noise floor is explained."""
    errors = _errors_over_noise_floors(answer, stated)
    if not errors:
        return False
    before, after = (float(np.mean([error[k] ** 2 for error in errors])) for k in (0, 1))
    return before > 1.0 and (before - after) / (before - 1.0) >= min_explained


def _after_over_floor(answer: Answer, stated: StatedAnswer) -> float | None:
    errors = _errors_over_noise_floors(answer, stated)
    return float(np.mean([after for _, after in errors])) if errors else None


def _errors_over_noise_floors(answer: Answer, stated: StatedAnswer) -> list[tuple[float, float]]:
    """RMSE before and after of every output over its true noise floor; empty where an output is missing."""
    channel_errors = {f.channel: f for f in stated.channel_errors}
    if not set(answer.noise_floors) <= set(channel_errors):
        return []
    return [
        (channel_errors[channel].rmse_before / floor, channel_errors[channel].rmse_after / floor)
        for channel, floor in answer.noise_floors.items()
    ]
