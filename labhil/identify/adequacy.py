"""The one gate between a fit that explains its data and one that does not.

A model explains a recording when what it leaves is noise. The measure is RMSE over noise floor, by channel,
in the windows by which the rig is scored: ``labhil fit``, ``labhil verify``, the worker of a lab, the screen
and the pages all state the verdict of :func:`adequacy_of`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import inf, isfinite, sqrt

from labhil.identify.score import ChannelScore, Score
from labhil.physics.terms import keyed

FLOOR_KNOWN_TO = 1.15
"""Factor to which the noise floor is known: a controller that reacts to noise makes it look too small."""

MISFIT_AS_LARGE_AS_NOISE = sqrt(2.0)
"""RMSE over noise where noise and misfit have the same variance: beyond it, most of the rest is misfit."""

EXPLAINED_TO = FLOOR_KNOWN_TO * MISFIT_AS_LARGE_AS_NOISE
"""RMSE over noise floor up to which a channel counts as explained, 1.63.

It is no test: a good recording shows far smaller misfits, and ``labhil diagnose`` tests for them. It is the
level at which standard errors, which are made of residuals, begin to describe the misfit and not the noise.
"""


class FitVerdict(StrEnum):
    """Whether a model explains what it was fitted to and what it was tested on."""

    EXPLAINED = "explained"
    UNEXPLAINED = "unexplained"
    WORSE_THAN_MEAN = "worse_than_mean"


@dataclass(frozen=True, slots=True)
class Adequacy:
    """The verdict of the gate.

    ``residual_over_noise`` maps channels (with the joint, as ``keyed``) to the ratio; ``worst`` is the one
    with the largest, ``r2`` the smallest R² of any channel that is not explained, a fraction (not a
    number where there is none).
    """

    verdict: FitVerdict
    residual_over_noise: Mapping[str, float]
    worst: str
    r2: float

    @property
    def explained(self) -> bool:
        """Whether noise is all that is left."""
        return self.verdict is FitVerdict.EXPLAINED


def adequacy_of(scores: Sequence[Score], level: float = EXPLAINED_TO) -> Adequacy:
    """Judge a model by its scores: on the data of the fit and, where there are any, on others.

    Args:
        scores: One score or more of the same channels; each channel counts where it is worst.
        level: RMSE over noise floor up to which a channel is explained.

    Returns:
        ``explained`` when every channel is; else ``worse_than_mean`` when the mean of what was measured would
        predict some channel better (R² < 0), which is ``unexplained`` otherwise.
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
    """RMSE over noise floor; infinite where a simulation ran away."""
    return channel.rmse / channel.noise_floor if isfinite(channel.rmse) else inf
