"""What an answer explains of the error on held-out data, how much remains, and where that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from labhil.diagnose.locate import HeldOut, Regime, regimes
from labhil.identify.score import Score
from labhil.physics.model import Model, Record, unit_of
from labhil.physics.terms import keyed
from labhil.signals import FloatArray

NOISE = 1.1
"""RMSE over the noise floor up to which nothing remains: a floor is known to some ten per cent."""

DRY_FRICTION = ("coulomb_friction", "stribeck_friction", "static_friction")


@dataclass(frozen=True, slots=True)
class Remainder:
    """The error that the named effects leave.

    Attributes:
        explained: share of the squared error beyond the noise that is explained, of the worst output.
        noise_floors: RMSE that remains there, over the noise floor.
        is_noise: whether nothing remains but noise.
        channel: that output.
        joint: its joint, of an arm.
        regimes: stretches of a coordinate that hold most of what remains.
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
    names: Sequence[str], model: Model, theta: FloatArray, held_out: Record, before: Score, after: Score
) -> Remainder | None:
    """Say what the named effects explain of held-out data, and where the rest of the error is.

    Args:
        names: the effects, each by its key.
        model: the final model, with a curve where there is one.
        theta: its vector.
        held_out: data that the search never saw.
        before: errors of the baseline on them.
        after: errors of the final model on the same windows.

    Returns:
        None without any effect, or where the baseline leaves no more than noise.
    """
    excess_before = [(c.rmse / c.noise_floor) ** 2 - 1.0 for c in before.channels]
    excess_after = [(c.rmse / c.noise_floor) ** 2 - 1.0 for c in after.channels]
    worst = int(np.argmax(excess_before))
    if not names or excess_before[worst] <= 0.0:
        return None
    channel = after.channels[worst]
    explained = float(np.clip(1.0 - excess_after[worst] / excess_before[worst], 0.0, 1.0))
    floors = channel.rmse / channel.noise_floor
    is_noise = floors <= NOISE
    places = () if is_noise else _places(model, theta, HeldOut(held_out, before, after), worst)
    remains = None if is_noise else floors
    statement = _statement(names, explained, remains, keyed(channel.channel, channel.joint), places)
    return Remainder(explained, floors, is_noise, channel.channel, channel.joint, places, statement)


def _places(model: Model, theta: FloatArray, held_out: HeldOut, worst: int) -> tuple[Regime, ...]:
    """The stretches of one coordinate that hold most of what remains in an output."""
    record, windows, states, counted = held_out.motion
    along = model.coordinates(theta, record, windows, states)
    floor = held_out.after.channels[worst].noise_floor
    rest = np.maximum((held_out.after.errors[:, worst] / floor) ** 2 - 1.0, 0.0)
    units = {name: unit_of(model.coordinate_units, name) for name in along}
    stretches = regimes({name: along[name][counted] for name in along if units[name] is not None}, rest)
    return tuple(replace(regime, unit=units[regime.coordinate] or "") for regime in stretches)


def _two_digits(value: float) -> str:
    """Two digits, without an exponent."""
    return f"{float(f'{value:.2g}'):,g}" if value < 1e6 else f"{value:.2g}"


def _statement(
    names: Sequence[str], explained: float, floors: float | None, channel: str, places: Sequence[Regime]
) -> str:
    verb = "explains" if len(names) == 1 else "explain"
    text = f"Together {' and '.join(names)}" if len(names) > 1 else names[0].replace("a force", "A force", 1)
    text = f"{text} {verb} {100.0 * explained:.0f} % of the error in {channel} beyond its noise"
    if floors is None:
        return f"{text}; what remains is noise."
    text += f"; {_two_digits(floors)} noise floors remain"
    if not places:
        return f"{text}, spread over all that was visited."
    coordinate, unit = places[0].coordinate, places[0].unit
    share = sum(place.share_of_excess for place in places)
    stretches = " or ".join(f"between {place.low:.3g} and {place.high:.3g}" for place in places)
    text += f", {100.0 * share:.0f} % of them at {coordinate} {stretches} {unit}".rstrip().replace("-", "−")
    slow = coordinate.endswith("velocity") and any(place.low < 0.0 < place.high for place in places)
    if slow and any(name.partition("[")[0] in DRY_FRICTION for name in names):
        return f"{text}: near reversals, where a contact yields before it slips (presliding)."
    return f"{text}."
