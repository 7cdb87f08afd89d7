"""Links of an arm as standard Denavit-Hartenberg rows (1955), with their inertia where it is known.

Frame i is fixed to link i at its far end; joint i (from 1) turns about z of frame i − 1, so that
T = Rot_z(q)·Trans_z(d)·Trans_x(a)·Rot_x(alpha) leads from frame i − 1 to frame i (eq. 4.20 of the
reference text, whose print has two slips).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from labhil.documents import DocumentError, parse_toml, read_document
from labhil.errors import RigFileError
from labhil.kinds import JOINTS
from labhil.physics.arm.rigid_body import PER_LINK, regressor, torques
from labhil.signals import FloatArray
from labhil.unreadable import LINKS, reason_unreadable
from labhil.validation_errors import format_validation_error

Number = Annotated[float, Field(allow_inf_nan=False)]
Moment = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class JointRow(BaseModel):
    """One ``[[joint]]``: ``d``, ``a`` (m), ``alpha`` (rad), and mass, centre, inertia of its link (SI)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    d: Number
    a: Number
    alpha: Number
    mass: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    centre: tuple[Number, Number, Number] | None = None
    inertia: tuple[Moment, Moment, Moment, Number, Number, Number] | None = None

    @model_validator(mode="after")
    def _all_or_none(self) -> JointRow:
        given = {"mass": self.mass, "centre": self.centre, "inertia": self.inertia}
        missing = [name for name, value in given.items() if value is None]
        if 0 < len(missing) < len(given):
            raise ValueError(
                f"{' and '.join(missing)} missing: give mass, centre and inertia together, or none of them"
            )
        return self


class LinksFile(BaseModel):
    """A file of links."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    joint: tuple[JointRow, ...]

    @model_validator(mode="after")
    def _six_alike(self) -> LinksFile:
        if len(self.joint) != JOINTS:
            raise ValueError(f"expected {JOINTS} tables [[joint]], found {len(self.joint)}")
        with_mass = [j for j, row in enumerate(self.joint) if row.mass is not None]
        if 0 < len(with_mass) < JOINTS:
            without = sorted(set(range(JOINTS)) - set(with_mass))
            raise ValueError(
                f"joints {', '.join(map(str, without))} (from 0) have no mass, the others do: "
                "give all six, or none to have the identifiable combinations estimated"
            )
        return self


@dataclass(frozen=True, slots=True)
class Links:
    """Geometry ``d``, ``a`` (m), ``alpha`` (rad), (6,) each, and ``inertial`` (60,), None if not known."""

    d: FloatArray
    a: FloatArray
    alpha: FloatArray
    inertial: FloatArray | None

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.d)

    @property
    def begin(self) -> FloatArray:
        """Prior inertial parameters of an estimate: zero."""
        return np.zeros(JOINTS * PER_LINK)

    def loaded(self, link: int) -> Sequence[int]:
        """All joints from the base to a link."""
        return range(link + 1)

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: FloatArray) -> FloatArray:
        """See ``physics.arm.rigid_body.regressor``."""
        return regressor(self, q, qd, qdd, gravity)

    def torques(
        self, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: FloatArray, inertial: FloatArray
    ) -> FloatArray:
        """See ``physics.arm.rigid_body.torques``."""
        return torques(self, q, qd, qdd, gravity, inertial)

    @classmethod
    def of(cls, rows: tuple[JointRow, ...]) -> Links:
        """Make links of six rows, in order from the base."""
        known = [inertial_of(row.mass, row.centre, row.inertia) for row in rows if row.mass is not None
                 and row.centre is not None and row.inertia is not None]  # fmt: skip
        return cls(
            np.array([row.d for row in rows]),
            np.array([row.a for row in rows]),
            np.array([row.alpha for row in rows]),
            np.concatenate(known) if known else None,
        )


def inertial_of(
    mass: float, centre: tuple[float, ...], inertia: tuple[float, ...] = (0.0,) * 6
) -> FloatArray:
    """Inertial parameters about the frame's origin from those at the centre of mass (Steiner's theorem).

    Args:
        mass: Mass m, kg.
        centre: Centre of mass c in the frame, (3,), m.
        inertia: xx, yy, zz, xy, xz, yz about the centre of mass, kg·m².

    Returns:
        m, m·c and the inertia about the origin, (10,).
    """
    x, y, z = centre
    xx, yy, zz, xy, xz, yz = inertia
    return np.array(
        [
            mass,
            mass * x,
            mass * y,
            mass * z,
            xx + mass * (y * y + z * z),
            yy + mass * (x * x + z * z),
            zz + mass * (x * x + y * y),
            xy - mass * x * y,
            xz - mass * x * z,
            yz - mass * y * z,
        ]
    )


def load_links(path: Path) -> Links:
    """Read a file of links.

    Raises:
        RigFileError: The file is not readable or not valid; the message names the field.
    """
    try:
        text = read_document(path)
    except (OSError, DocumentError) as error:
        reason = reason_unreadable(path, error, LINKS)
        raise RigFileError(f"{path}: cannot be read as a table of links (TOML): {reason}") from error
    return links_of(text, str(path))


def links_of(text: str, source: str) -> Links:
    """Read links from the text of a file named ``source``; raises as :func:`load_links`."""
    try:
        data: dict[str, Any] = parse_toml(text)
    except DocumentError as error:
        raise RigFileError(f"{source}: not TOML: {error}") from error
    try:
        return Links.of(LinksFile.model_validate(data).joint)
    except ValidationError as error:
        raise RigFileError(format_validation_error(error, Path(source), LinksFile)) from error


def _row(
    lengths: tuple[float, float, float],
    mass: float,
    centre: tuple[float, float, float],
    axes: tuple[float, float, float],
) -> JointRow:
    d, a, alpha = lengths
    return JointRow(d=d, a=a, alpha=alpha, mass=mass, centre=centre, inertia=(*axes, 0.0, 0.0, 0.0))


UR5 = Links.of(
    (
        _row((0.089159, 0.0, pi / 2), 3.7, (0.0, -0.02561, 0.00193), (0.0085, 0.0064, 0.0085)),
        _row((0.0, -0.425, 0.0), 8.393, (0.2125, 0.0, 0.11336), (0.0085, 0.212, 0.212)),
        _row((0.0, -0.39225, 0.0), 2.33, (0.15, 0.0, 0.0265), (0.0017, 0.0473, 0.0473)),
        _row((0.10915, 0.0, pi / 2), 1.219, (0.0, -0.0018, 0.01634), (0.0018, 0.0018, 0.0014)),
        _row((0.09465, 0.0, -pi / 2), 1.219, (0.0, 0.0018, 0.01634), (0.0018, 0.0018, 0.0014)),
        _row((0.0823, 0.0, 0.0), 0.1879, (0.0, 0.0, -0.001159), (0.00008, 0.00008, 0.00013)),
    )
)
"""The manufacturer's UR5: tables 4.1 and 4.2 and equations 4.54 to 4.59 of the reference text."""
