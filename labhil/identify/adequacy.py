"""Adequacy of a model: whether its residuals are noise.

The measure is RMSE over noise floor of each channel, in the windows by which the rig is scored. ``labhil
fit``, ``labhil verify``, the worker of a lab, the screen and the pages all state the verdict of
:func:`adequacy_of`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import inf, isfinite, sqrt

from labhil.identify.score import ChannelScore, Score
from labhil.physics.terms import keyed

NOISE_FLOOR_FACTOR = 1.15
"""Factor to which the noise floor is known: a controller that reacts to noise makes it look too small."""

RATIO_OF_EQUAL_MISFIT = sqrt(2.0)
"""RMSE over noise where noise and misfit have the same variance; beyond it, misfit is the larger part."""

MAX_EXPLAINED_RATIO = NOISE_FLOOR_FACTOR * RATIO_OF_EQUAL_MISFIT
"""RMSE over noise floor up to which a channel counts as explained, 1.63.

This is not a test: a good recording shows far smaller misfits, and ``labhil diagnose`` tests for them. From
this ratio on, standard errors, which are computed from residuals, describe the misfit and not the noise.
"""


class FitVerdict(StrEnum):
    """Whether a model explains what it was fitted to and what it was tested on."""

    EXPLAINED = "explained"
    UNEXPLAINED = "unexplained"
    WORSE_THAN_MEAN = "worse_than_mean"


@dataclass(frozen=True, slots=True)
class Adequacy:
    """Whether a model explains its data, and by how much it misses.

    Attributes:
        verdict: Over all channels.
        residual_over_noise: RMSE over noise floor by channel (with the joint, as ``keyed``).
        worst: The channel with the largest ratio.
        r2: Smallest R² of the channels that are not explained, a fraction; NaN where there is none.
    """

    verdict: FitVerdict
    residual_over_noise: Mapping[str, float]
    worst: str
    r2: float

    @property
    def explained(self) -> bool:
        """Whether the residuals are noise."""
        return self.verdict is FitVerdict.EXPLAINED


def adequacy_of(scores: Sequence[Score], level: float = MAX_EXPLAINED_RATIO) -> Adequacy:
    """Decide from a model's scores whether it explains the data.

    Args:
        scores: On the data of the fit and, where there are any, on test data; each channel counts where it
            is worst.
        level: RMSE over noise floor up to which a channel is explained.

    Returns:
        ``explained`` when every channel is; else ``worse_than_mean`` when the measured mean would predict
        some channel better (R² < 0); else ``unexplained``.
    """
    ratios: dict[str, float] = {}
    r2 = inf
    for channel in (channel for score in scores for channel in score.channels):
        ratio = _ratio(channel)
        key = keyed(channel.channel, channel.joint)
        ratios[key] = max(ratio, ratios.get(key, 0.0))
        if ratio > level and isfinite(channel.r2):
            r2 = min(r2, channel.r2)
    worst = max(ratios, key=lambda key: ratios[key])
    verdict = FitVerdict.EXPLAINED
    if ratios[worst] > level:
        verdict = FitVerdict.WORSE_THAN_MEAN if r2 < 0.0 else FitVerdict.UNEXPLAINED
    return Adequacy(verdict, ratios, worst, r2 if isfinite(r2) else float("nan"))


def _ratio(channel: ChannelScore) -> float:
    """RMSE over noise floor; infinite where a simulation diverged."""
    return channel.rmse / channel.noise_floor if isfinite(channel.rmse) else inf
