"""Zero-order hold of an input, recognised from its recorded values where nobody states it.

Where the values do not decide, :func:`labhil.diagnose.timing.estimate_hold` compares fits of the rig's model.
"""

from __future__ import annotations

import numpy as np

from labhil.signals import FloatArray, Hold, IntArray


def level_changes(
    u: FloatArray,
    *,
    min_changes: int = 3,
    min_share_constant: float = 0.5,
    min_share_isolated: float = 0.8,
) -> IntArray:
    """Return where a piecewise constant input changes its level.

    Args:
        u: input (n,).
        min_changes: changes from which an input counts as piecewise constant: one or two may be anything.
        min_share_constant: share of neighbouring samples that are equal, at least.
        min_share_isolated: share of the changes that have no other change beside them, at least. A ramp or
            a clipped sine has few such.

    Returns:
        First sample of each new level (k,); empty for an input that is not piecewise constant.
    """
    changed = np.r_[False, np.diff(u) != 0.0]
    changes = np.flatnonzero(changed).astype(np.int64)
    if len(changes) < min_changes or changed[1:].mean() > 1.0 - min_share_constant:
        return np.empty(0, dtype=np.int64)
    neighbour_changed = changed[np.maximum(changes - 1, 0)] | changed[np.minimum(changes + 1, len(u) - 1)]
    return changes if np.mean(~neighbour_changed) >= min_share_isolated else np.empty(0, dtype=np.int64)


def detect_hold(u: FloatArray) -> Hold | None:
    """Return the hold of an input between samples where its values show it.

    Args:
        u: input (n,).

    Returns:
        ``Hold.ZERO`` for a piecewise constant input, None where the values do not decide.
    """
    return Hold.ZERO if len(level_changes(u)) else None
