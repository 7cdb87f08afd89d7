"""Write effects for which an arm's file has no attribute as a Python file: joint friction and drives.

The Python file accompanies the repaired one and does not import labhil. ``Friction`` returns torques against
the motion in addition to those of the file, ``measured`` the readings of the drives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import NamedTuple

from labhil.physics.terms import keyed
from labhil.simulators.companion import FIRM_FRICTION_NOTE, WIDTH

OUTPUT_PARAMETERS = ("sensor_offset.offset", "torque_constant.gain")
SHAPES = ("stribeck_friction.velocity", "torque_ripple.order")


class Law(NamedTuple):
    """An effect: its equation in text, its parameters, and a Python expression."""

    equation: str
    parameters: tuple[str, ...]
    line: str


LAWS: Mapping[str, Law] = {
    "viscous_friction": Law("tau = c qd", ("coefficient",), "{coefficient} * qd[{j}]"),
    "coulomb_friction": Law("tau = tau_c sgn qd", ("level",), "{level} * side[{j}]"),
    "added_inertia": Law("tau = J qdd", ("inertia",), "{inertia} * qdd[{j}]"),
    "stribeck_friction": Law(
        "tau = tau_st exp(-|qd| / qd_s) sgn qd",
        ("level", "velocity"),
        "{level} * math.exp(-abs(qd[{j}]) / {velocity}) * side[{j}]",
    ),
    "quadratic_viscous_friction": Law(
        "tau = c2 qd |qd|", ("coefficient",), "{coefficient} * qd[{j}] * abs(qd[{j}])"
    ),
    "cubic_viscous_friction": Law("tau = c3 qd^3", ("coefficient",), "{coefficient} * qd[{j}] ** 3"),
    "friction_asymmetry": Law("tau = c_a |qd|", ("coefficient",), "{coefficient} * abs(qd[{j}])"),
    "position_dependent_friction": Law("tau = s q sgn qd", ("slope",), "{slope} * q[{j}] * side[{j}]"),
    "load_dependent_friction": Law(
        "tau = mu |tau_load| sgn qd, tau_load the torque of the links alone",
        ("coefficient",),
        "{coefficient} * abs(load[{j}]) * side[{j}]",
    ),
    "torque_ripple": Law(
        "tau = a sin(N q) + b cos(N q)",
        ("sine", "cosine", "order"),
        "{sine} * math.sin({order} * q[{j}]) + {cosine} * math.cos({order} * q[{j}])",
    ),
}
BRISTLE_LAW = Law(
    "ds = (dq - s |dq|) / l in the place of sgn qd (Dahl); the file's dry friction turns over at once, this "
    "adds the difference",
    ("length",),
    "",
)

SUPPORTED = frozenset(
    {
        *OUTPUT_PARAMETERS,
        "presliding_friction.length",
        *(f"{t}.{part}" for t, law in LAWS.items() for part in law.parameters),
    }
)
"""Parameters that a companion can contain; the repaired file is run without the others."""

TEXT = '''"""What {file} cannot hold of the physics that was found; by `labhil patch`. SI units.

Joints: {joints}.

In each step of a simulation, with friction = Friction() and load = numpy.zeros(model.nv) before,

    mujoco.mj_rne(model, data, 1, load)  # torques of the links alone
    data.qfrc_applied[:] = -friction(data.qpos, data.qvel, data.qacc, load)

{rotors}{firm}and what is measured of the drives is measured(torques of the drives).
"""

import math

import numpy as np

AT_REST = 1e-4  # rad/s below which dry friction counts as holding
BRISTLES = {bristles}  # rad over which dry friction turns over after a reversal; 0: at once
DRY = {dry}  # N·m, the file's own dry friction
PER_TORQUE = {per_torque}  # {measured} per N·m
OFFSET = {offset}
ARMATURE = {armature}  # kg·m², rotors that the file has no place for


class Friction:
    """Torques against the motion beside the file's own, N·m; it remembers bristles."""

    def __init__(self):
        self.last = self.bristles = None

    def __call__(self, q, qd, qdd, load):
        """Torques of all joints at angles, velocities, accelerations and torques of the links."""
        tau = np.zeros({n})
        side = self.turn(q, qd)
{laws}        return tau

    def turn(self, q, qd):
        """Direction of dry friction of each joint, from -1 to 1."""
        side = np.tanh(np.asarray(qd) / AT_REST)
        if self.last is None:
            self.last, self.bristles = np.array(q), side.copy()
        for j, length in enumerate(BRISTLES):
            way = q[j] - self.last[j]
            if length and way:
                to = math.copysign(1.0, way)
                self.bristles[j] += (to - self.bristles[j]) * (1.0 - math.exp(-abs(way) / length))
            side[j] = self.bristles[j] if length else side[j]
        self.last = np.array(q)
        return side


def measured(torque):
    """What is measured of the drives at their torques, N·m."""
    return np.asarray(torque) * PER_TORQUE + OFFSET
'''


ROTOR_NOTE = """The file has no place for rotors; when it is loaded,

    model.dof_armature[:] += ARMATURE
    mujoco.mj_setConst(model, mujoco.MjData(model))

"""


@dataclass(frozen=True, slots=True)
class ArmCompanion:
    """The companion of an arm's file.

    Attributes:
        values: Values of effects by key.
        constants: Torque constants (n,), N·m/A; None where torques are measured.
        joints: Names of the joints.
        dry: Dry friction in the file, (n,), N·m.
        firm: Whether the user has to make that firm after loading, since the format has no attribute for it.
        armature: Rotor inertias (n,) for which the format has no attribute, kg·m².
    """

    values: Mapping[str, float]
    constants: Sequence[float] | None
    joints: tuple[str, ...]
    dry: Sequence[float]
    firm: bool = False
    armature: tuple[float, ...] = ()

    @property
    def unsupported(self) -> tuple[str, ...]:
        """Keys of values that the companion cannot contain either."""
        return tuple(key for key in self.values if key.partition("[")[0] not in SUPPORTED)

    def text(self, file: str) -> str:
        """Return the text of the Python file that accompanies ``file``."""
        n = len(self.joints)
        gain = [1.0 + self._of("torque_constant.gain", j) for j in range(n)]
        constants = [1.0] * n if self.constants is None else list(self.constants)
        per_torque = [g / k for g, k in zip(gain, constants, strict=True)]
        return TEXT.format(
            file=file,
            rotors=ROTOR_NOTE if any(self.armature) else "",
            armature=_row(self.armature or [0.0] * n),
            firm=f"{FIRM_FRICTION_NOTE.strip()}\n\n" if self.firm else "",
            joints=", ".join(f"{j} {name}" for j, name in enumerate(self.joints)),
            bristles=_row([self._of("presliding_friction.length", j) for j in range(n)]),
            dry=_row(self.dry),
            per_torque=_row(per_torque),
            measured="reading" if self.constants is None else "current, A,",
            offset=_row([self._of("sensor_offset.offset", j) for j in range(n)]),
            n=n,
            laws="".join(f"        {line}\n" for line in self._lines()),
        )

    def _of(self, name: str, joint: int) -> float:
        return self.values.get(keyed(name, joint), 0.0)

    def _lines(self) -> list[str]:
        lines = []
        for j, name in enumerate(self.joints):
            if self._of("presliding_friction.length", j):
                lines += [f"# {t}" for t in wrap(f"bristles of {name}: {BRISTLE_LAW.equation}", WIDTH - 10)]
                lines.append(f"tau[{j}] += DRY[{j}] * (side[{j}] - math.tanh(qd[{j}] / AT_REST))")
            for term, law in LAWS.items():
                values = {part: self._of(f"{term}.{part}", j) for part in law.parameters}
                if not any(v for part, v in values.items() if f"{term}.{part}" not in SHAPES):
                    continue
                lines += [f"# {t}" for t in wrap(f"{term} of {name}: {law.equation}", WIDTH - 10)]
                stated = {part: f"{v:.6g}" if v >= 0 else f"({v:.6g})" for part, v in values.items()}
                lines.append(f"tau[{j}] += {law.line.format(j=j, **stated)}")
        return lines


def _row(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{x:.6g}' for x in values)}]"
