"""Nonparametric torques on the joints of an arm, fitted joint by joint.

Each torque is fitted beside those before it, worst joint first. ``force_curve.py`` fits a single one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labhil.diagnose.adequacy import residual_rms
from labhil.diagnose.force_curve import ForceCurve, find_joint_torque
from labhil.diagnose.judge import Data
from labhil.diagnose.refit import refit
from labhil.diagnose.search_result import SearchResult
from labhil.identify.fitted import Fitted
from labhil.identify.saved_curve import apply_curves
from labhil.physics.extra_force import AcceptsExtraForce, MovedPart


def fit_joint_curves(
    data: Data, result: SearchResult, *, min_rms: float = 1.15, certain_rms: float = 1.5
) -> tuple[ForceCurve, ...]:
    """Fit the torques on the joints of an arm that no named term explains.

    The joint with the largest residuals comes first.

    Args:
        data: the data of the search.
        result: the result of the search for named terms.
        min_rms: RMS of a joint's residuals, in units of its noise, from which a torque is fitted. It is close
            to 1: inverse dynamics is a linear problem with thousands of samples.
        certain_rms: RMS that an imperfect estimate of the noise never reaches. Below it the first joint
            without a torque ends the fitting, above it the next joint follows.

    Returns:
        The torques in the order in which they were fitted.
    """
    data = replace(data, held=result.final.held)
    model, curves = data.model, tuple[ForceCurve, ...]()
    remaining = list(model.moved) if isinstance(model, AcceptsExtraForce) else []
    while remaining:
        part, rms = _worst_joint(data, result, curves, remaining)
        if rms < min_rms:
            break
        data_with_curves, final = _refit_with_curves(data, result.final, curves)
        curve = find_joint_torque(data_with_curves, final, part)
        if curve is None and rms < certain_rms:
            break
        curves = curves if curve is None else (*curves, curve)
        remaining.remove(part)
    return curves


def sort_by_heldout_gain(curves: Sequence[ForceCurve]) -> list[ForceCurve]:
    """Sort force curves by their likelihood gain on held-out data, the largest first."""
    return sorted(curves, key=lambda curve: -curve.evidence.heldout_loglik_gain)


def _worst_joint(
    data: Data, result: SearchResult, curves: Sequence[ForceCurve], parts: Sequence[MovedPart]
) -> tuple[MovedPart, float]:
    """The part with the largest residuals, and their RMS in units of the noise."""
    rms = np.max(residual_rms(*_refit_with_curves(data, result.final, curves)), axis=0)
    of_joint = dict(zip(data.search.output_joints, rms.tolist(), strict=True))
    worst = max(parts, key=lambda part: of_joint[part.joint])
    return worst, of_joint[worst.joint]


def _refit_with_curves(data: Data, final: Fitted, curves: Sequence[ForceCurve]) -> tuple[Data, Fitted]:
    """Refit the same terms to a model that has these curves as fixed forces."""
    if not curves:
        return data, final
    assert isinstance(data.model, AcceptsExtraForce)
    data = replace(data, model=apply_curves(data.model, [curve.kept for curve in curves], data.search))
    return data, refit(data, final, final.terms, ())
