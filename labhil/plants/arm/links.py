"""Links of an arm: standard Denavit-Hartenberg parameters, masses, centres and inertias.

Frame i is at the far end of link i and moves with it; joint i (from 1) turns about the z axis of
frame i − 1: T = Rot_z(q)·Trans_z(d)·Trans_x(a)·Rot_x(alpha).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi

from labhil.errors import UsageError

JOINTS = 6

Vector = tuple[float, float, float]
Tensor = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Link:
    """One link: ``d``, ``a`` m, ``alpha`` rad, ``mass`` kg; ``centre`` m, in the link's own frame.

    ``inertia`` kg·m² about the centre, along the axes of the link's frame: xx yy zz xy xz yz.
    """

    d: float
    a: float
    alpha: float
    mass: float
    centre: Vector
    inertia: Tensor


@dataclass(frozen=True, slots=True)
class Links:
    """Six links from the base to the flange; UsageError for another number, or a link without mass."""

    name: str
    links: tuple[Link, ...]

    def __post_init__(self) -> None:
        if len(self.links) != JOINTS:
            raise UsageError(f"links of {self.name}: expected {JOINTS} links, found {len(self.links)}")
        for number, link in enumerate(self.links):
            if not link.mass > 0.0 or min(link.inertia[:3]) <= 0.0:
                raise UsageError(
                    f"links of {self.name}: mass and moments of inertia of link {number} must be positive"
                )


def _axes(xx: float, yy: float, zz: float) -> Tensor:
    return (xx, yy, zz, 0.0, 0.0, 0.0)


UR5 = Links(
    "UR5",
    (
        Link(0.089159, 0.0, pi / 2, 3.7, (0.0, -0.02561, 0.00193), _axes(0.0085, 0.0064, 0.0085)),
        Link(0.0, -0.425, 0.0, 8.393, (0.2125, 0.0, 0.11336), _axes(0.0085, 0.212, 0.212)),
        Link(0.0, -0.39225, 0.0, 2.33, (0.15, 0.0, 0.0265), _axes(0.0017, 0.0473, 0.0473)),
        Link(0.10915, 0.0, pi / 2, 1.219, (0.0, -0.0018, 0.01634), _axes(0.0018, 0.0018, 0.0014)),
        Link(0.09465, 0.0, -pi / 2, 1.219, (0.0, 0.0018, 0.01634), _axes(0.0018, 0.0018, 0.0014)),
        Link(0.0823, 0.0, 0.0, 0.1879, (0.0, 0.0, -0.001159), _axes(0.00008, 0.00008, 0.00013)),
    ),
)
"""The reference text's tables 4.1 and 4.2 and its equations 4.54–4.59 (the manufacturer's figures)."""

_UR10E_WRIST: Tensor = (0.00296, 0.00222, 0.00258, -0.00001, 0.0, -0.00024)
UR10E = Links(
    "UR10e",
    (
        Link(
            0.1807, 0.0, pi / 2, 7.369, (0.021, 0.0, 0.027),
            (0.03408, 0.03529, 0.02156, 0.00002, -0.00425, 0.00008),
        ),
        Link(
            0.0, -0.6127, 0.0, 13.051, (0.38, 0.0, 0.158),
            (0.02814, 0.77068, 0.76943, 0.00005, -0.01561, 0.00002),
        ),
        Link(
            0.0, -0.57155, 0.0, 3.989, (0.24, 0.0, 0.068),
            (0.01014, 0.30928, 0.30646, 0.00008, 0.00916, 0.0),
        ),
        Link(0.17415, 0.0, pi / 2, 2.1, (0.0, 0.007, 0.018), _UR10E_WRIST),
        Link(0.11985, 0.0, -pi / 2, 1.98, (0.0, 0.007, 0.018), _UR10E_WRIST),
        Link(0.11655, 0.0, 0.0, 0.615, (0.0, 0.0, -0.026), _axes(0.0004, 0.00041, 0.00034)),
    ),
)  # fmt: skip
"""Lengths, masses, centres and inertias as the manufacturer publishes them for the UR10e."""

UR3E = Links(
    "UR3e",
    (
        Link(0.15185, 0.0, pi / 2, 1.98, (0.0, -0.02, 0.0), _axes(0.0046, 0.0036, 0.0046)),
        Link(0.0, -0.24355, 0.0, 3.4445, (0.13, 0.0, 0.1157), _axes(0.0053, 0.0197, 0.0197)),
        Link(0.0, -0.2132, 0.0, 1.437, (0.05, 0.0, 0.0238), _axes(0.0012, 0.0061, 0.0061)),
        Link(0.13105, 0.0, pi / 2, 0.871, (0.0, 0.0, 0.01), _axes(0.0009, 0.0009, 0.0006)),
        Link(0.08535, 0.0, -pi / 2, 0.805, (0.0, 0.0, 0.01), _axes(0.0008, 0.0008, 0.0006)),
        Link(0.0921, 0.0, 0.0, 0.261, (0.0, 0.0, -0.02), _axes(0.00013, 0.00013, 0.00018)),
    ),
)
"""Lengths, masses and centres as the manufacturer publishes them; the inertias are cylinders of ours."""

ARMS: Mapping[str, Links] = {"ur5": UR5, "ur10e": UR10E, "ur3e": UR3E}
"""The known arms by name."""
