"""The remaining error on held-out data: its size, the share that the answer explains, and its regimes.

``locate.py`` locates the explained error; this module locates the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.locate import HeldOut, Regime, regimes
from labhil.identify.score import Score
from labhil.physics.model import Model, unit_of
from labhil.physics.record import Record
from labhil.physics.terms import keyed
from labhil.signals import FloatArray

MAX_NOISE_FLOORS = 1.1
"""RMSE over the noise floor up to which only noise remains: a floor is known to some ten per cent."""

DRY_FRICTION = ("coulomb_friction", "stribeck_friction", "static_friction")


@dataclass(frozen=True, slots=True)
class Remainder:
    """The error that the named effects leave.

    Attributes:
        explained: share of the squared error beyond the noise that is explained, of the worst output.
        noise_floors: remaining RMSE of that output, over its noise floor.
        is_noise: whether only noise remains.
        channel: that output.
        joint: its joint, of an arm.
        regimes: ranges of a coordinate that hold most of the remaining error.
        statement: the same in one or two sentences.
    """

    explained: float
    noise_floors: float
    is_noise: bool
    channel: str
    joint: int | None
    regimes: tuple[Regime, ...]
    statement: str


def find_remainder(
    names: Sequence[str],
    model: Model,
    theta: FloatArray,
    held_out: Record,
    before: Score,
    after: Score,
    *,
    max_noise_floors: float = MAX_NOISE_FLOORS,
) -> Remainder | None:
    """Find how much of the held-out error the named effects explain, and where the rest is.

    Args:
        names: keys of the effects.
        model: the final model, with a curve where there is one.
        theta: its parameter vector.
        held_out: the held-out data.
        before: score of the baseline on them.
        after: score of the final model on the same windows.
        max_noise_floors: RMSE over the noise floor up to which only noise remains.

    Returns:
        The remaining error; None without named effects, or where the baseline leaves only noise.
    """
    excess_before = [(c.rmse / c.noise_floor) ** 2 - 1.0 for c in before.channels]
    excess_after = [(c.rmse / c.noise_floor) ** 2 - 1.0 for c in after.channels]
    worst = int(np.argmax(excess_before))
    if not names or excess_before[worst] <= 0.0:
        return None
    channel = after.channels[worst]
    explained = float(np.clip(1.0 - excess_after[worst] / excess_before[worst], 0.0, 1.0))
    floors = channel.rmse / channel.noise_floor
    is_noise = floors <= max_noise_floors
    ranges = () if is_noise else _remaining_regimes(model, theta, HeldOut(held_out, before, after), worst)
    stated = None if is_noise else floors
    statement = _statement(names, explained, stated, keyed(channel.channel, channel.joint), ranges)
    return Remainder(explained, floors, is_noise, channel.channel, channel.joint, ranges, statement)


def _remaining_regimes(model: Model, theta: FloatArray, held_out: HeldOut, worst: int) -> tuple[Regime, ...]:
    """The ranges of one coordinate that hold most of the remaining error of an output."""
    record, windows, states, counted = held_out.motion
    along = model.coordinates(theta, record, windows, states)
    floor = held_out.after.channels[worst].noise_floor
    remaining = np.maximum((held_out.after.errors[:, worst] / floor) ** 2 - 1.0, 0.0)
    units = {name: unit_of(model.coordinate_units, name) for name in along}
    ranges = regimes({name: along[name][counted] for name in along if units[name] is not None}, remaining)
    return tuple(replace(regime, unit=units[regime.coordinate] or "") for regime in ranges)


def _two_digits(value: float) -> str:
    """The value with two digits, without an exponent up to a million."""
    return f"{float(f'{value:.2g}'):,g}" if value < 1e6 else f"{value:.2g}"


def _statement(
    names: Sequence[str], explained: float, floors: float | None, channel: str, ranges: Sequence[Regime]
) -> str:
    """One or two sentences; ``floors`` is None where only noise remains."""
    verb = "explains" if len(names) == 1 else "explain"
    text = f"Together {' and '.join(names)}" if len(names) > 1 else names[0].replace("a force", "A force", 1)
    # 100 % beside an error that remains would contradict itself
    stated = f"{100.0 * explained:.0f} %" if floors is None or explained < 0.995 else "over 99 %"
    text = f"{text} {verb} {stated} of the error in {channel} beyond its noise"
    if floors is None:
        return f"{text}; what remains is noise."
    text += f"; {_two_digits(floors)} noise floors remain"
    if not ranges:
        return f"{text}, spread over all that was visited."
    coordinate, unit = ranges[0].coordinate, ranges[0].unit
    share = sum(regime.share_of_excess for regime in ranges)
    bounds = " or ".join(f"between {regime.low:.3g} and {regime.high:.3g}" for regime in ranges)
    text += f", {100.0 * share:.0f} % of them at {coordinate} {bounds} {unit}".rstrip().replace("-", "−")
    slow = coordinate.endswith("velocity") and any(regime.low < 0.0 < regime.high for regime in ranges)
    if slow and any(name.partition("[")[0] in DRY_FRICTION for name in names):
        return f"{text}: near reversals, where a contact yields before it slips (presliding)."
    return f"{text}."
