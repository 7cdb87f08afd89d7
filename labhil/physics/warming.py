"""Viscous friction that falls with the temperature of what rubs: c(T) = c·exp(−α·(T − 20 °C))."""

from __future__ import annotations

import numpy as np

from labhil.physics.record import Record
from labhil.physics.terms import Enters, Parameter, Term
from labhil.signals import FloatArray

REFERENCE_TEMPERATURE = 20.0
"""Temperature, °C, at which viscous friction and resistance have the values that are stated."""

WARMS = "temperature_dependent_friction"
RATE = f"{WARMS}.rate"

TEMPERATURE = "temperature"
"""Channel with the temperature of what rubs, °C, of an axis and of a user's simulator."""


def warming_friction(part: str, channel: str) -> Term:
    """Make the term of viscous friction that falls with warmth.

    Args:
        part: What warms, for the user: "the axis".
        channel: Name of the channel with its temperature, °C.
    """
    return Term(
        WARMS,
        Enters.FORCE,
        f"viscous friction that falls as {part} warms",
        "c(T) = c·exp(−α·(T − 20 °C))",
        "viscosity of grease",
        f"long runs that warm {part}",
        (Parameter(RATE, "1/K", 0.02, -0.2, 0.2),),
        needs=(channel,),
    )


def viscous_change(rate: float, record: Record, channel: str) -> FloatArray:
    """Viscous friction over that at the reference temperature at each sample, (n,).

    Args:
        rate: α, 1/K.
        record: the recording, with the channel unless the rate is zero.
        channel: Name of the channel with the temperature, °C.
    """
    if not rate:
        return np.ones(len(record))
    return np.asarray(np.exp(-rate * (record.auxiliary[channel] - REFERENCE_TEMPERATURE)))
