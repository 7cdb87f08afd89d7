"""A pendulum as its user would write it: nothing but inertia and gravity."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import labhil as lh


def swing(t: float, x: Any, u: Any, p: Any) -> Any:
    return x.rate, (u.torque - p.gravity_torque * math.sin(x.angle)) / p.inertia


def pendulum(f: Callable[..., Any] = swing, **changes: Any) -> lh.Simulator:
    stated: dict[str, Any] = {
        "name": "pendulum",
        "states": {"angle": "rad", "rate": "rad/s"},
        "inputs": {"torque": "N·m"},
        "parameters": {"inertia": lh.Quantity(0.02, "kg·m²"), "gravity_torque": lh.Quantity(0.5, "N·m")},
    }
    return lh.simulator(f, **{**stated, **changes})
