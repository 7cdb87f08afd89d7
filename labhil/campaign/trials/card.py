"""All trials counted: the figures that are promised, as shares with limits and as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter
from typing import Any

import numpy as np

from labhil.campaign.share import Share
from labhil.campaign.trials.judge import Judged

STRENGTH_BINS = (0.0, 1.1, 1.3, 1.6, 2.0, 3.0, 5.0, float("inf"))
GRADES = {"any": 0.0, "weak or more": 1.3, "full": 3.0}
"""Strengths from which on answers are counted, by name."""
PROBABILITY_BINS = 10
RIGHT_OVERLAP = 0.5
COUNTED = {1: "one effect", 2: "two effects", 3: "three effects"}


@dataclass(frozen=True, slots=True)
class Reliability:
    """Claims whose stated probability lies in one bin: its bounds, their mean, and how many were right."""

    low: float
    high: float
    stated: float
    right: Share


@dataclass(frozen=True, slots=True)
class Card:
    """The score of a set of trials.

    ``false_alarms`` are those on trials in which nothing makes a difference to the oracle, ``with_nothing``
    those on trials in which nothing was concealed at all. ``naming`` maps the number of effects (and "outside
    the catalogue") and a grade of strength to the share of exact answers, ``alone`` to that of exact ones
    without a rival beside them; ``detection`` maps a range of the strongest effect's strength to the share
    detected, ``named`` to the share of exact answers to one effect; ``undecided`` is the share of "cannot
    tell" where an oracle can; ``confusion`` counts pairs of true and named term; ``joints`` is the share of
    effects in a joint that were named in it, of all that were named. ``after_over_floor`` are
    median and 90th percentile of RMSE after over the noise floor, None without any; ``each`` are the trials.
    """

    rig: str
    fixed_seed: bool
    trials: int
    failures: int
    false_alarms: Share
    with_nothing: Share
    detection: Mapping[str, Share]
    named: Mapping[str, Share]
    undecided: Share
    naming: Mapping[str, Mapping[str, Share]]
    alone: Mapping[str, Mapping[str, Share]]
    single: Share
    confusion: Mapping[tuple[str, str], int]
    reliability: tuple[Reliability, ...]
    calibration_error: float | None
    modelled: Share
    overlap: Share
    joints: Share
    after_over_floor: tuple[float, float] | None
    covered: Share
    covered_apart: Share
    seconds: float
    each: tuple[Judged, ...]

    def to_json(self) -> dict[str, Any]:
        """As plain JSON data."""
        return {
            "schema": "labhil.score/1",
            "rig": self.rig,
            "fixed_seed": self.fixed_seed,
            "trials": self.trials,
            "failures": self.failures,
            "false_alarms": self.false_alarms.to_json(),
            "false_alarms_with_nothing": self.with_nothing.to_json(),
            "detection": {name: share.to_json() for name, share in self.detection.items()},
            "exact_by_strength": {name: share.to_json() for name, share in self.named.items()},
            "not_decidable": self.undecided.to_json(),
            "naming": _grades_to_json(self.naming),
            "single_naming": _grades_to_json(self.alone),
            "single_answers": self.single.to_json(),
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
            "right_joint": self.joints.to_json(),
            "rmse_after_over_noise_floor": None
            if self.after_over_floor is None
            else {"median": self.after_over_floor[0], "percentile_90": self.after_over_floor[1]},
            "interval_coverage": self.covered.to_json(),
            "interval_coverage_other": self.covered_apart.to_json(),
            "seconds_median": self.seconds,
            "each": [_trial_row(judged) for judged in self.each],
        }


def _grades_to_json(naming: Mapping[str, Mapping[str, Share]]) -> dict[str, Any]:
    return {
        name: {grade: share.to_json() for grade, share in grades.items()} for name, grades in naming.items()
    }


def _trial_row(judged: Judged) -> dict[str, Any]:
    """One trial as a line of a table."""
    return {
        "trial": judged.trial,
        "verdict": judged.verdict,
        "effects": [[e.key, round(e.strength, 3), round(e.oracle_gain, 1)] for e in judged.real],
        "named": [list(pair) for pair in judged.confused],
        "exact": judged.exact,
        "claims": [[round(stated, 4), right] for stated, right in judged.claims],
        "after_over_floor": judged.after_over_floor,
        "seconds": round(judged.seconds, 2),
    }


def count(judged: Sequence[Judged], rig: str, fixed_seed: bool) -> Card:
    """Count trials that were judged one by one."""
    with_effects = [j for j in judged if j.sure]
    ratios = [j.after_over_floor for j in judged if j.after_over_floor is not None]
    claims = [claim for j in judged for claim in j.claims]
    overlaps = [j.overlap for j in judged if j.overlap is not None]
    reliability = reliabilities(claims)
    return Card(
        rig=rig,
        fixed_seed=fixed_seed,
        trials=len(judged),
        failures=sum(j.verdict is None for j in judged),
        false_alarms=_share([j.alarm for j in judged if j.null]),
        with_nothing=_share([j.alarm for j in judged if j.nothing]),
        detection=_by_strength([(j.strongest, j.detected) for j in judged if j.strongest is not None]),
        named=_by_strength([(j.sure[0].strength, j.exact) for j in with_effects if len(j.sure) == 1]),
        undecided=Share(sum(j.verdict == "not_decidable" for j in with_effects), len(with_effects)),
        naming=_by_number(with_effects, attrgetter("exact")),
        alone=_by_number(with_effects, attrgetter("single")),
        single=Share(sum(j.single for j in with_effects), len(with_effects)),
        confusion=Counter(pair for j in judged for pair in j.confused),
        reliability=reliability,
        calibration_error=_calibration_error(reliability),
        modelled=_share([j.modelled for j in judged if j.modelled is not None]),
        overlap=_share([overlap >= RIGHT_OVERLAP for overlap in overlaps]),
        joints=_share([right for j in judged for right in j.joints]),
        after_over_floor=(float(np.median(ratios)), float(np.quantile(ratios, 0.9))) if ratios else None,
        covered=_share([c for j in judged if j.complete for c in j.covered]),
        covered_apart=_share([c for j in judged if not j.complete for c in j.covered]),
        seconds=float(np.median([j.seconds for j in judged])) if judged else 0.0,
        each=tuple(judged),
    )


def reliabilities(claims: Sequence[tuple[float, bool]]) -> tuple[Reliability, ...]:
    """Claims (stated probability, right) in bins of a tenth, empty ones left out."""
    bins = []
    for k in range(PROBABILITY_BINS):
        inside = [(p, right) for p, right in claims if min(int(p * PROBABILITY_BINS), 9) == k]
        if inside:
            stated = float(np.mean([p for p, _ in inside]))
            bins.append(Reliability(k / 10, (k + 1) / 10, stated, _share([right for _, right in inside])))
    return tuple(bins)


def _calibration_error(bins: Sequence[Reliability]) -> float | None:
    """Mean distance of the stated probability from the share that was right, over all claims."""
    total = sum(b.right.of for b in bins)
    if not total:
        return None
    return sum(b.right.of * abs(b.stated - b.right.value) for b in bins) / total


def _by_strength(hits: Sequence[tuple[float, bool]]) -> dict[str, Share]:
    """Strengths with what is counted, in ranges."""
    return {
        f"{low:g} to {high:g}": _share([hit for strength, hit in hits if low <= strength < high])
        for low, high in pairwise(STRENGTH_BINS)
    }


def _by_number(trials: Sequence[Judged], right: Callable[[Judged], bool]) -> dict[str, dict[str, Share]]:
    """What is right of answers, by the number of effects and the least strength of any."""
    groups: dict[str, list[Judged]] = {name: [] for name in (*COUNTED.values(), "outside the catalogue")}
    for j in trials:
        known = all(effect.catalogue for effect in j.sure)
        group = COUNTED.get(len(j.sure)) if known else "outside the catalogue"
        if group is not None:
            groups[group].append(j)
    return {
        name: {
            grade: _share([right(j) for j in group if min(e.strength for e in j.sure) >= least])
            for grade, least in GRADES.items()
        }
        for name, group in groups.items()
    }


def _share(hits: Sequence[bool]) -> Share:
    return Share(sum(hits), len(hits))
