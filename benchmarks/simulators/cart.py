"""A simulator of the axis as a user would write it: a mass that is driven, and nothing else."""

import labhil as lh


def push(t, x, u, p):
    """Rates of position and velocity."""
    return x.velocity, u.drive_force / p.mass


cart = lh.simulator(
    push,
    name="cart",
    states={"position": "m", "velocity": "m/s"},
    inputs={"drive_force": "N"},
    parameters={"mass": lh.Quantity(20.0, "kg")},
)
