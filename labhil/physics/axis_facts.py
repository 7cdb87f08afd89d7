"""Plausibility figures of an axis' recording (see ``physics.facts``)."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

from labhil.physics.facts import Fact, derivative_fact, sampling_rate_fact, second_order_gain
from labhil.physics.record import Record


def facts(record: Record, known: Mapping[str, float], *, mass_factor: float = 4.0) -> list[Fact]:
    """Compute the facts: sampling rate, derivative of position, and acceleration per drive (Newton).

    Args:
        record: The recording.
        known: Numbers that the rig file states.
        mass_factor: Factor within which the regression gives the mass; dry friction biases it.

    Returns:
        The facts.
    """
    figures = [sampling_rate_fact(record, 2.0, 1e6, 1000.0)]
    t, x, drive = record.t, record.outputs[:, 0], record.input_names[0]
    if "velocity" in record.auxiliary:
        figures += derivative_fact(t, "position", x, "velocity", record.auxiliary["velocity"])
    gain = second_order_gain(t, record.inputs[:, 0], x)
    if gain is None:
        return figures
    powers = {"position": 1, drive: -1, "t": -2}
    force = known.get("drive_gain") if drive == "drive_voltage" else 1.0
    if "moving_mass" in known and force is not None:
        what, why = "the acceleration over drive/moving_mass", "moving_mass of the rig file"
        ratio = gain * known["moving_mass"] / force
        figures.append(Fact(what, ratio, "", 1.0 / mass_factor, mass_factor, powers, why, 1.0, dynamic=True))
    else:
        what = f"the acceleration per unit of {drive}"
        figures.append(
            Fact(
                what, gain, "", 0.0, inf, powers, "it accelerates in the direction of the drive", dynamic=True
            )
        )
    return figures
