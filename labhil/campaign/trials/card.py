"""The score card of a set of trials: proportions with confidence limits, and their JSON.

``show.py`` prints it, ``plot.py`` draws it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter
from typing import Any

import numpy as np

from labhil.campaign.proportion import Proportion
from labhil.campaign.trials.judge import JudgedTrial

STRENGTH_BINS = (0.0, 1.1, 1.3, 1.6, 2.0, 3.0, 5.0, float("inf"))
GRADES = {"any": 0.0, "weak or more": 1.3, "full": 3.0}
"""Smallest strength of a trial's effects that each grade counts."""
PROBABILITY_BINS = 10
RIGHT_OVERLAP = 0.5
COUNTED = {1: "one effect", 2: "two effects", 3: "three effects"}


@dataclass(frozen=True, slots=True)
class Reliability:
    """A bin of claims: its bounds, the mean of their stated probabilities, and how many were right."""

    low: float
    high: float
    stated: float
    right: Proportion


@dataclass(frozen=True, slots=True)
class ScoreCard:
    """The score of a set of trials.

    Attributes:
        rig: the kind of rig.
        fixed_seed: whether the trials were drawn from a fixed seed.
        trials: number of trials.
        failures: diagnoses that failed.
        false_alarms: of trials in which the oracle detects nothing.
        false_alarms_when_empty: of trials in which nothing was concealed.
        detection: trials with a reported mismatch, by range of the strongest effect's strength.
        named: exact answers to one effect, by range of its strength.
        undecided: answers "not decidable" where the oracle decides.
        naming: exact answers, by number of effects (and "outside the catalogue") and by grade of strength.
        naming_unrivalled: exact answers without a rival, likewise.
        unrivalled: exact answers without a rival, of all trials with effects.
        confusion: counts of pairs of true and named term.
        reliability: claims by bin of their stated probability.
        calibration_error: mean distance of stated probability and frequency, None without claims.
        modelled: trials whose excess error is modelled.
        overlap: trials whose reported regime agrees with the true one.
        right_joints: effects named in their joint, of all that were named.
        after_over_floor: median and 90th percentile of RMSE after over the noise floor, None without any.
        coverage: 99 % intervals that contain the truth, of complete models.
        coverage_incomplete: the same, of incomplete models.
        seconds: median time of a diagnosis, s.
        judged: the trials.
    """

    rig: str
    fixed_seed: bool
    trials: int
    failures: int
    false_alarms: Proportion
    false_alarms_when_empty: Proportion
    detection: Mapping[str, Proportion]
    named: Mapping[str, Proportion]
    undecided: Proportion
    naming: Mapping[str, Mapping[str, Proportion]]
    naming_unrivalled: Mapping[str, Mapping[str, Proportion]]
    unrivalled: Proportion
    confusion: Mapping[tuple[str, str], int]
    reliability: tuple[Reliability, ...]
    calibration_error: float | None
    modelled: Proportion
    overlap: Proportion
    right_joints: Proportion
    after_over_floor: tuple[float, float] | None
    coverage: Proportion
    coverage_incomplete: Proportion
    seconds: float
    judged: tuple[JudgedTrial, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the score as plain JSON data."""
        return {
            "schema": "labhil.score/1",
            "rig": self.rig,
            "fixed_seed": self.fixed_seed,
            "trials": self.trials,
            "failures": self.failures,
            "false_alarms": self.false_alarms.to_json(),
            "false_alarms_with_nothing": self.false_alarms_when_empty.to_json(),
            "detection": {name: share.to_json() for name, share in self.detection.items()},
            "exact_by_strength": {name: share.to_json() for name, share in self.named.items()},
            "not_decidable": self.undecided.to_json(),
            "naming": _grades_to_json(self.naming),
            "single_naming": _grades_to_json(self.naming_unrivalled),
            "single_answers": self.unrivalled.to_json(),
            "confusion": [
                {"true": true, "named": named, "count": count}
                for (true, named), count in sorted(self.confusion.items())
            ],
            "reliability": [
                {"low": r.low, "high": r.high, "stated": r.stated, "right": r.right.to_json()}
                for r in self.reliability
            ],
            "calibration_error": self.calibration_error,
            "modelled": self.modelled.to_json(),
            "regime_overlap": self.overlap.to_json(),
            "right_joint": self.right_joints.to_json(),
            "rmse_after_over_noise_floor": None
            if self.after_over_floor is None
            else {"median": self.after_over_floor[0], "percentile_90": self.after_over_floor[1]},
            "interval_coverage": self.coverage.to_json(),
            "interval_coverage_other": self.coverage_incomplete.to_json(),
            "seconds_median": self.seconds,
            "each": [_trial_row(judged) for judged in self.judged],
        }


def _grades_to_json(naming: Mapping[str, Mapping[str, Proportion]]) -> dict[str, Any]:
    return {
        name: {grade: share.to_json() for grade, share in grades.items()} for name, grades in naming.items()
    }


def _trial_row(judged: JudgedTrial) -> dict[str, Any]:
    """JSON data of one trial."""
    return {
        "trial": judged.trial,
        "verdict": judged.verdict,
        "effects": [[e.key, round(e.strength, 3), round(e.oracle_gain, 1)] for e in judged.detectable],
        "named": [list(pair) for pair in judged.confusions],
        "exact": judged.exact,
        "claims": [[round(stated, 4), right] for stated, right in judged.claims],
        "after_over_floor": judged.after_over_floor,
        "seconds": round(judged.seconds, 2),
    }


def make_score_card(judged: Sequence[JudgedTrial], rig: str, fixed_seed: bool) -> ScoreCard:
    """Count judged trials of a rig kind; ``fixed_seed`` is whether a fixed seed drew them."""
    with_effects = [j for j in judged if j.required]
    ratios = [j.after_over_floor for j in judged if j.after_over_floor is not None]
    claims = [claim for j in judged for claim in j.claims]
    overlaps = [j.overlap for j in judged if j.overlap is not None]
    reliability = reliability_bins(claims)
    return ScoreCard(
        rig=rig,
        fixed_seed=fixed_seed,
        trials=len(judged),
        failures=sum(j.verdict is None for j in judged),
        false_alarms=_proportion([j.reports_mismatch for j in judged if j.is_null]),
        false_alarms_when_empty=_proportion([j.reports_mismatch for j in judged if j.is_empty]),
        detection=_by_strength([(j.strongest, j.detected) for j in judged if j.strongest is not None]),
        named=_by_strength([(j.required[0].strength, j.exact) for j in with_effects if len(j.required) == 1]),
        undecided=Proportion(sum(j.verdict == "not_decidable" for j in with_effects), len(with_effects)),
        naming=_by_number(with_effects, attrgetter("exact")),
        naming_unrivalled=_by_number(with_effects, attrgetter("unrivalled")),
        unrivalled=Proportion(sum(j.unrivalled for j in with_effects), len(with_effects)),
        confusion=Counter(pair for j in judged for pair in j.confusions),
        reliability=reliability,
        calibration_error=_calibration_error(reliability),
        modelled=_proportion([j.modelled for j in judged if j.modelled is not None]),
        overlap=_proportion([overlap >= RIGHT_OVERLAP for overlap in overlaps]),
        right_joints=_proportion([right for j in judged for right in j.right_joints]),
        after_over_floor=(float(np.median(ratios)), float(np.quantile(ratios, 0.9))) if ratios else None,
        coverage=_proportion([c for j in judged if j.is_complete for c in j.coverage]),
        coverage_incomplete=_proportion([c for j in judged if not j.is_complete for c in j.coverage]),
        seconds=float(np.median([j.seconds for j in judged])) if judged else 0.0,
        judged=tuple(judged),
    )


def reliability_bins(claims: Sequence[tuple[float, bool]]) -> tuple[Reliability, ...]:
    """Bin claims (stated probability, right) by tenths of probability; empty bins are left out."""
    bins = []
    for k in range(PROBABILITY_BINS):
        binned = [(p, right) for p, right in claims if min(int(p * PROBABILITY_BINS), 9) == k]
        if binned:
            stated = float(np.mean([p for p, _ in binned]))
            bins.append(
                Reliability(k / 10, (k + 1) / 10, stated, _proportion([right for _, right in binned]))
            )
    return tuple(bins)


def _calibration_error(bins: Sequence[Reliability]) -> float | None:
    """Mean distance of the stated probability from the share that was right, over all claims."""
    total = sum(b.right.total for b in bins)
    if not total:
        return None
    return sum(b.right.total * abs(b.stated - b.right.value) for b in bins) / total


def _by_strength(hits: Sequence[tuple[float, bool]]) -> dict[str, Proportion]:
    """Count hits by range of strength."""
    return {
        f"{low:g} to {high:g}": _proportion([hit for strength, hit in hits if low <= strength < high])
        for low, high in pairwise(STRENGTH_BINS)
    }


def _by_number(
    trials: Sequence[JudgedTrial], right: Callable[[JudgedTrial], bool]
) -> dict[str, dict[str, Proportion]]:
    """Count right answers by the number of effects and the grade of the weakest."""
    groups: dict[str, list[JudgedTrial]] = {name: [] for name in (*COUNTED.values(), "outside the catalogue")}
    for j in trials:
        known = all(effect.catalogue for effect in j.required)
        group = COUNTED.get(len(j.required)) if known else "outside the catalogue"
        if group is not None:
            groups[group].append(j)
    return {
        name: {
            grade: _proportion([right(j) for j in group if min(e.strength for e in j.required) >= least])
            for grade, least in GRADES.items()
        }
        for name, group in groups.items()
    }


def _proportion(hits: Sequence[bool]) -> Proportion:
    return Proportion(sum(hits), len(hits))
