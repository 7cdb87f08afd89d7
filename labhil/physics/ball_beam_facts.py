"""What gravity and the beam say of a ball-and-beam recording before anything is fitted."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

from labhil.physics.facts import Fact, rate_fact, second_order_gain, size_fact
from labhil.physics.model import Record

ROLLS = 9.81 / 1.4
"""m/s² per radian of a solid ball that rolls down a small slope."""

LONGEST_BEAM = 3.0
"""m; of a bench."""

LEAST_SHARE, MOST_SHARE = 0.12, 2.0
"""Of that acceleration which recordings show: loops, lags and friction lower it, noise in the angle too."""

SMALLEST_RATIO = 0.02
"""Crank over beam where the rig file does not know them."""


def facts(record: Record, known: Mapping[str, float]) -> list[Fact]:
    """Bounds on position, angle, acceleration per radian and rate."""
    t, u, x, name = record.t, record.inputs[:, 0], record.outputs[:, 0], record.input_names[0]
    length = known.get("beam_length", LONGEST_BEAM)
    why = "beam_length of the rig file" if "beam_length" in known else "a bench's beam is shorter"
    figures = [
        rate_fact(record, 2.0, 1e5),
        size_fact("ball_position", "m", x, 1.1 * length, 0.15, why),
    ]
    if name == "servo_angle":
        figures.append(
            size_fact(name, "rad", u, 1.1 * pi, 0.5, "a crank that goes beyond half a turn comes back")
        )
        sides = [known.get("crank_radius"), known.get("beam_length")]
        low = high = (sides[0] or 0.0) / (sides[1] or 1.0)
        if None in sides:
            low, high = SMALLEST_RATIO, 1.0
    else:
        figures.append(size_fact(name, "rad", u, 0.5 * pi, 0.1, "the beam would stand upright"))
        low = high = 1.0
    gain = second_order_gain(t, u, x)
    if gain is not None:
        powers = {"ball_position": 1, name: -1, "t": -2}
        typical = ROLLS * (low * high) ** 0.5
        figures.append(
            Fact(
                f"the ball's acceleration per unit of {name}", gain, "m/s²", LEAST_SHARE * ROLLS * low,
                MOST_SHARE * ROLLS * high, powers, "gravity and the linkage", typical, dynamic=True,
            )
        )  # fmt: skip
    return figures
