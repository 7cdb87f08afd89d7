"""Mass and drag of a moved part by a regression of the balance of forces, before any fit.

The balance is taken in its weak form (Shinbrot, ASME Trans. 79, 1957), so no noisy signal is differentiated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from labhil.physics.record import Record
from labhil.signals import FloatArray

SMOOTHED = 0.05
"""Half the span over which positions are averaged for the direction of motion, s."""


class MassAndDrag(NamedTuple):
    """Mass and viscous friction in units of the force; noise can make them negative.

    Attributes:
        mass: M.
        drag: c.
        mass_error: Standard error of M, as if stretches did not overlap: too small by about two.
    """

    mass: float
    drag: float
    mass_error: float


def regress_mass_and_drag(recordings: Sequence[Record], gain: float, test_width: float) -> MassAndDrag:
    """Estimate mass and viscous friction beside dry friction, a spring and a bias.

    F = M·ẍ + c·ẋ + T·sgn ẋ + k·x + b, with the first input and output as force (over ``gain``) and position.

    Args:
        recordings: The recordings.
        gain: Force per unit of the input.
        test_width: Width of the test functions, s; shorter than the motion's changes, and much longer than
            the sampling period.

    Returns:
        M and c.
    """
    weak = np.vstack([_weak_form(recording, gain, test_width) for recording in recordings])
    norms = np.maximum(np.linalg.norm(weak, axis=0), 1e-300)
    columns = weak[:, 1:] / norms[1:]
    scaled = np.linalg.lstsq(columns, weak[:, 0], rcond=None)[0]
    left = weak[:, 0] - columns @ scaled
    variance = float(left @ left) / max(len(left) - columns.shape[1], 1)
    spread = np.sqrt(variance * np.diag(np.linalg.pinv(columns.T @ columns)))
    balance = scaled / norms[1:]
    return MassAndDrag(float(balance[0]), float(balance[1]), float(spread[0] / norms[1]))


def _weak_form(record: Record, gain: float, test_width: float) -> FloatArray:
    """Drive, mass, drag, dry friction, spring and bias under test functions φ, (m, 6).

    The balance is multiplied by φ and integrated by parts; φ and its first two derivatives vanish at both
    ends.
    """
    u, x = gain * record.inputs[:, 0], record.outputs[:, 0] - record.outputs[0, 0]
    half = max(4, min(int(0.5 * test_width / record.period), (len(record) - 1) // 4))
    s = np.arange(-half, half + 1) / half
    width, well = half * record.period, 1.0 - s * s
    functions = {0: well**3, 1: -6.0 * s * well**2 / width, 2: 6.0 * well * (5.0 * s * s - 1.0) / width**2}
    side = np.sign(np.gradient(_smooth(x, max(1, int(SMOOTHED / record.period)))))
    columns = ((u, 0, 1.0), (x, 2, 1.0), (x, 1, -1.0), (side, 0, 1.0), (x, 0, 1.0), (np.ones_like(x), 0, 1.0))
    hop = max(half // 2, 1)
    stretches = (sliding_window_view(values, len(s))[::hop] for values, _, _ in columns)
    weighted = zip(stretches, columns, strict=True)
    return np.column_stack([sign * (values @ functions[order]) for values, (_, order, sign) in weighted])


def _smooth(x: FloatArray, width: int) -> FloatArray:
    """Moving average over 2·width + 1 samples."""
    kernel = np.ones(2 * width + 1) / (2 * width + 1)
    return np.asarray(np.convolve(np.pad(x, width, mode="edge"), kernel, mode="valid"))
