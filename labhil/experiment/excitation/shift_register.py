"""Pseudo-random binary sequences from a linear feedback shift register."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from labhil.experiment.excitation.function import Seed
from labhil.experiment.excitation.levels import Steps, check_dwell, check_order, count_holds

TAPS: Mapping[int, tuple[int, ...]] = {
    2: (2, 1),
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 11, 10, 4),
    13: (13, 12, 11, 8),
    14: (14, 13, 12, 2),
    15: (15, 14),
    16: (16, 15, 13, 4),
    17: (17, 14),
    18: (18, 11),
    19: (19, 18, 17, 14),
    20: (20, 17),
}
"""Feedback taps by the number of stages: their sum modulo 2 is fed back, and the register then takes every
state but zero before it repeats (primitive polynomials over GF(2), as in the usual tables)."""


def maximum_length_sequence(stages: int, start: int = 1) -> NDArray[np.bool_]:
    """Return one period of a maximum-length sequence.

    Args:
        stages: Stages of the shift register.
        start: Initial state, 1 … 2^stages − 1. Another state gives the same sequence, shifted.

    Returns:
        Bits (2^stages − 1,).

    Raises:
        ValueError: ``stages`` or ``start`` is out of range.
    """
    if stages not in TAPS:
        raise ValueError(f"`stages` must be {min(TAPS)} to {max(TAPS)} stages, found {stages}")
    length = 2**stages - 1
    if not 1 <= start <= length:
        raise ValueError(f"`start` must be 1 to {length}, found {start}")
    mask = sum(1 << stage - 1 for stage in TAPS[stages])
    state = start
    bits = np.empty(length, dtype=np.bool_)
    for i in range(length):
        bits[i] = state >> stages - 1
        state = (state << 1 & length) | (state & mask).bit_count() % 2
    return bits


def prbs(
    low: float,
    high: float,
    dwell: float,
    duration: float,
    stages: int | None = None,
    seed: Seed = 0,
    *,
    min_stages: int = 5,
) -> Steps:
    """Return a pseudo-random binary sequence between two levels, each bit held for ``dwell`` s.

    Over a whole period ``high`` is held once more often than ``low``, the normalised autocorrelation is
    −1/(2^stages − 1) at every lag but zero, and the power is flat up to about 0.44/``dwell`` Hz (−3 dB).

    Args:
        low: Lower level.
        high: Upper level.
        dwell: Duration of a bit, s.
        duration: Duration of the step, s.
        stages: Stages of the shift register; without them the shortest whose period,
            (2^stages − 1)·``dwell``, lasts for ``duration`` is taken.
        seed: Seed of the place in the period at which the sequence begins.
        min_stages: Fewest stages that are taken where ``stages`` is not given.
    """
    check_order(low, high)
    check_dwell(dwell)
    if stages is None:
        stages = min(max(count_holds(duration, dwell).bit_length(), min_stages), max(TAPS))
    elif stages not in TAPS:
        raise ValueError(f"`stages` must be {min(TAPS)} to {max(TAPS)} stages, found {stages}")
    start = int(np.random.default_rng(seed).integers(1, 2**stages))
    bits = maximum_length_sequence(stages, start)
    return Steps(tuple(np.where(bits, high, low).tolist()), dwell)
