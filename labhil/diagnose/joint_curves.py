"""Torques on an arm's joints that no named term explains, joint by joint, each beside those before it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labhil.diagnose.adequacy import residual_rms
from labhil.diagnose.force_curve import ForceCurve, unmodelled
from labhil.diagnose.judge import Data
from labhil.diagnose.refit import refit
from labhil.diagnose.search_result import SearchResult
from labhil.identify.fitted import Fitted
from labhil.identify.saved_curve import apply_curves
from labhil.physics.extra_force import AcceptsExtraForce, MovedPart

LEFT = 1.15
"""RMS of a joint's residuals, in units of its noise, from which a torque on it is looked for.

This is a linear problem, which the joint's motion poses thousands of times.
"""

MUCH_LEFT = 1.5
"""The same that is no imperfection of the noise: without a curve there the search goes on at other joints."""


def joint_curves(data: Data, result: SearchResult) -> tuple[ForceCurve, ...]:
    """Torques that no named term explains.

    The joints have their turns by what is left of them, until little is left or the worst of what is little
    more than noise has none.
    """
    data = replace(data, held=result.final.held)
    model, curves = data.model, tuple[ForceCurve, ...]()
    waiting = list(model.moved) if isinstance(model, AcceptsExtraForce) else []
    while waiting:
        part, most = _worst(data, result, curves, waiting)
        if most < LEFT:
            break
        data_with_curves, final = _beside(data, result.final, curves)
        curve = unmodelled(data_with_curves, final, part)
        if curve is None and most < MUCH_LEFT:
            break
        curves = curves if curve is None else (*curves, curve)
        waiting.remove(part)
    return curves


def strongest(curves: Sequence[ForceCurve]) -> list[ForceCurve]:
    """Those that bring held-out data closest to the noise first."""
    return sorted(curves, key=lambda curve: -curve.evidence.heldout_loglik_gain)


def _worst(
    data: Data, result: SearchResult, curves: Sequence[ForceCurve], parts: Sequence[MovedPart]
) -> tuple[MovedPart, float]:
    """The part whose output leaves most, and how much that is, in units of the noise."""
    rms = np.max(residual_rms(*_beside(data, result.final, curves)), axis=0)
    of_joint = dict(zip(data.search.output_joints, rms.tolist(), strict=True))
    worst = max(parts, key=lambda part: of_joint[part.joint])
    return worst, of_joint[worst.joint]


def _beside(data: Data, final: Fitted, curves: Sequence[ForceCurve]) -> tuple[Data, Fitted]:
    """Data whose model is under these curves, and a fit of it with the same terms."""
    if not curves:
        return data, final
    assert isinstance(data.model, AcceptsExtraForce)
    data = replace(data, model=apply_curves(data.model, [curve.kept for curve in curves], data.search))
    return data, refit(data, final, final.terms, ())
