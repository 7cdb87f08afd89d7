"""Plausibility figures of a ball-and-beam recording (see ``physics.facts``)."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

from labhil.physics.facts import Fact, amplitude_fact, sampling_rate_fact, second_order_gain
from labhil.physics.record import Record

ROLLING_GAIN = 9.81 / 1.4
"""Acceleration g/(1 + 2/5) of a solid ball per radian of a small slope, m/s²."""


def facts(
    record: Record,
    known: Mapping[str, float],
    *,
    max_beam_length: float = 3.0,
    min_gain_share: float = 0.12,
    max_gain_share: float = 2.0,
    min_linkage_ratio: float = 0.02,
) -> list[Fact]:
    """Compute the facts: bounds on position, angle, acceleration per radian and sampling rate.

    Args:
        record: The recording.
        known: Numbers that the rig file states.
        max_beam_length: Longest beam of a bench, m.
        min_gain_share: Least acceleration per radian over that of a rolling solid ball: control loops, lags,
            friction and noise of the angle lower it.
        max_gain_share: Largest acceleration per radian over that of a rolling solid ball.
        min_linkage_ratio: Least crank radius over beam length where the rig file does not state them.

    Returns:
        The facts.
    """
    t, u, x, name = record.t, record.inputs[:, 0], record.outputs[:, 0], record.input_names[0]
    length = known.get("beam_length", max_beam_length)
    why = "beam_length of the rig file" if "beam_length" in known else "a bench's beam is shorter"
    figures = [
        sampling_rate_fact(record, 2.0, 1e5),
        amplitude_fact("ball_position", "m", x, 1.1 * length, 0.15, why),
    ]
    if name == "servo_angle":
        figures.append(
            amplitude_fact(name, "rad", u, 1.1 * pi, 0.5, "a crank that goes beyond half a turn comes back")
        )
        sides = [known.get("crank_radius"), known.get("beam_length")]
        low = high = (sides[0] or 0.0) / (sides[1] or 1.0)
        if None in sides:
            low, high = min_linkage_ratio, 1.0
    else:
        figures.append(amplitude_fact(name, "rad", u, 0.5 * pi, 0.1, "the beam would stand upright"))
        low = high = 1.0
    gain = second_order_gain(t, u, x)
    if gain is not None:
        powers = {"ball_position": 1, name: -1, "t": -2}
        typical = ROLLING_GAIN * (low * high) ** 0.5
        figures.append(
            Fact(
                f"the ball's acceleration per unit of {name}", gain, "m/s²",
                min_gain_share * ROLLING_GAIN * low, max_gain_share * ROLLING_GAIN * high, powers,
                "gravity and the linkage", typical, dynamic=True,
            )
        )  # fmt: skip
    return figures
