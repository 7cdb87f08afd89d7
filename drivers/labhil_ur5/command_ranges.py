"""Ranges of a UR arm's commands."""

from __future__ import annotations

import math
from collections.abc import Mapping

from labhil.errors import CommandRefusedError
from labhil_ur5.reported_signals import DIGITAL_OUTPUTS, OUTPUTS, SPEED, TARGET_COLUMNS

MAX_ANGLE = math.radians(363.0)
"""Largest angle of a joint, rad."""


def check_commands(values: Mapping[str, float]) -> None:
    """Raise CommandRefusedError unless each value lies in the range of its command."""
    ranges = dict.fromkeys(TARGET_COLUMNS, (-MAX_ANGLE, MAX_ANGLE))
    ranges |= {SPEED.name: (0.0, 1.0), OUTPUTS.name: (0.0, 2.0**DIGITAL_OUTPUTS - 1)}
    for name, value in values.items():
        if name not in ranges:
            raise CommandRefusedError(f"expected one of the commands {', '.join(ranges)}, found {name!r}")
        low, high = ranges[name]
        if not low <= value <= high:
            raise CommandRefusedError(f"{name}: expected {low:g} … {high:g}, found {value:g}")
    if not float(values.get(OUTPUTS.name, 0.0)).is_integer():
        raise CommandRefusedError(f"{OUTPUTS.name}: expected a whole number, found {values[OUTPUTS.name]:g}")
