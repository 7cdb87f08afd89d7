"""An arm of a user's MuJoCo file as a rig: measured motion in, measured torques or currents out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labhil.errors import UsageError
from labhil.kinds import INPUT, OUTPUT, STATUS, Known, RigKind, declare_kind
from labhil.physics.arm import ArmModel
from labhil.physics.arm.chain import Chain
from labhil.physics.arm.first_estimate import LAWS
from labhil.physics.arm.motion import PreparedRecord
from labhil.physics.arm.rigid_body import PER_LINK, gravity_in_base
from labhil.physics.model import Record
from labhil.physics.rigs import RigModel, declare_model
from labhil.physics.terms import Term, keyed
from labhil.rig import RigFile, parse_rig
from labhil.signals import FloatArray, Signal
from labhil.simulators.arm_file import ArmFile, read_arm
from labhil.simulators.mjcf_file import load_model, names_of
from labhil.simulators.names import identifier

CURRENT, TORQUE = KINDS = ("current", "torque")
"""What may be measured of a joint's drive."""

UNITS = {CURRENT: "A", TORQUE: "N·m"}
HELD = ("viscous_friction", "coulomb_friction", "added_inertia")
"""What every MuJoCo file can hold of a joint: damping, frictionloss, armature."""

OFFSET = "sensor_offset"
GEARED = ("load_dependent_friction", "cubic_viscous_friction")
"""What is usual in geared joints beside that; linear, so that a fit of all takes seconds."""

WRONG_WAY = -10.0
"""Standard errors from 0 at which a joint's torque is taken to have the other sign."""


@dataclass(frozen=True, eq=False)
class ArmSimulator:
    """A MuJoCo file with several joints as a rig; wherever a rig may be named, it may.

    Example:
        >>> import labhil as lh
        >>> arm = lh.mujoco_simulator("docs/measured/ur10e.xml")
        >>> arm.joints[:2], arm.output, arm.unit
        (('shoulder_pan', 'shoulder_lift'), 'actual_current', 'A')
    """

    arm: ArmFile
    name: str
    output: str
    measures: str

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the columns of a recording."""
        return self.arm.joints

    @property
    def unit(self) -> str:
        """Unit of what is measured of the drives."""
        return UNITS[self.measures]

    @property
    def kind(self) -> RigKind:
        """The rig kind that it is: its signals, and what ``[known]`` may say."""
        n = len(self.joints)
        names = ", ".join(self.joints)
        known = {"gear_ratio": Known("1", width=n)}
        planned: tuple[Signal, ...] = ()
        if self.measures == CURRENT:
            known["torque_constant"] = Known("N·m/A", width=n)
            planned = (
                Signal("target_current", "A", STATUS, n, description="currents that the controller expects"),
                Signal("target_moment", "N·m", STATUS, n, description="torques that the controller expects"),
            )
        return RigKind(
            self.name,
            (
                Signal("actual_q", "rad", INPUT, n, description=f"angles of {names}"),
                Signal("actual_qd", "rad/s", INPUT, n, description=f"velocities of {names}"),
            ),
            (("actual_q", "actual_qd"),),
            (Signal(self.output, self.unit, OUTPUT, n, description=f"{self.measures} of {names}"),),
            known,
            auxiliary=(
                Signal("joint_temperatures", "°C", STATUS, n, description="of the joints"),
                *planned,
            ),
        )

    @property
    def rig_file(self) -> RigFile:
        """A rig file that says nothing but that the rig is this simulator."""
        return parse_rig(f'[rig]\nkind = "{self.name}"\n', Path(f"{self.name}.toml"))

    @property
    def begins(self) -> tuple[str, ...]:
        """Terms that a diagnosis begins with: what such a file can hold of every joint, and an offset.

        A file that leaves damping, frictionloss and armature out says that they are 0, which data contradict.
        """
        in_file = {name.partition(".")[0] for name, value in self.arm.nominal.items() if value}
        return tuple(dict.fromkeys((*HELD, OFFSET, *sorted(in_file))))


def arm_simulator(
    path: Path,
    inputs: Mapping[str, str] | None = None,
    outputs: Mapping[str, str] | None = None,
    name: str = "",
) -> ArmSimulator:
    """Take a MuJoCo file with several hinges for a rig; see ``labhil.mujoco_simulator``."""
    model = load_model(path)
    has = names_of(model)
    if inputs:
        raise UsageError(
            f"{path}: inputs: of a file with several joints the measured motion is the input, actual_q and "
            f"actual_qd with {len(has.joints)} columns each ({', '.join(has.joints)}), found "
            f"{', '.join(inputs)}; say under [channels] which columns these are"
        )
    output, measures = _measured(path, outputs)
    arm = read_arm(path, model, has)
    named = bytes(model.names).split(b"\0", 1)[0].decode("utf-8", "replace")
    called = identifier(name or (path.stem if named in ("", "MuJoCo Model") else named))
    made = ArmSimulator(arm, called, identifier(output), measures)
    declare_kind(made.kind)

    def of_rig(rig: RigFile, record: Record | None) -> ArmFileModel:
        return ArmFileModel(made, rig, record)

    begins = made.begins
    declare_model(made.name, RigModel(of_rig, begins, tuple(dict.fromkeys((*begins, *GEARED)))))
    return made


def _measured(path: Path, outputs: Mapping[str, str] | None) -> tuple[str, str]:
    """Name of the recorded output, and what it is."""
    if not outputs:
        return "actual_current", CURRENT
    if len(outputs) != 1 or next(iter(outputs.values())) not in KINDS:
        raise UsageError(
            f"{path}: outputs: of a file with several joints expected one signal with a column for each, "
            f'{{ actual_current = "current" }} or {{ joint_torque = "torque" }}, found '
            f"{', '.join(f'{signal} = {of!r}' for signal, of in outputs.items())}"
        )
    return next(iter(outputs.items()))


class ArmFileModel(ArmModel):
    """Inverse dynamics of a user's MuJoCo file.

    The inertial parameters that a recording can distinguish from the file's are estimated, the others stay,
    as do those that act just as an armature.
    """

    first_laws = (*LAWS, "added_inertia.inertia")

    def __init__(self, simulator: ArmSimulator, rig: RigFile, record: Record | None = None) -> None:
        self.simulator, self.kind = simulator, simulator.name
        self.output_unit = simulator.unit
        super().__init__(rig, record)
        self.nominal = dict(simulator.arm.nominal) | self._inertia_of_file()
        self.notes = (*self.notes, *self._notes(record))

    def _chain(self, rig: RigFile) -> Chain:
        return self.simulator.arm.tree

    def _reference(self) -> Chain:
        """Without torque constants the file's masses are what torques are measured by."""
        tree = self.simulator.arm.tree
        return replace(tree, inertial=tree.begin)

    def _absent(self, everything: Mapping[str, Term], warm: bool) -> dict[str, str]:
        unknown = {
            keyed("torque_ripple", j): "needs gear_ratio under [known]"
            for j in range(self.joints)
            if keyed("torque_ripple", j) not in everything
        }
        return super()._absent(everything, warm) | unknown

    def _stated_constants(self, rig: RigFile) -> list[float] | None:
        if self.simulator.measures == TORQUE:
            return [1.0] * self.joints
        return rig.known_numbers("torque_constant")

    def _gear_ratio(self, rig: RigFile) -> Sequence[float | None]:
        return rig.known_numbers("gear_ratio") or (None,) * self.joints

    def _inertia_of_file(self) -> dict[str, float]:
        """Grouped parameters as the file has them, by key."""
        if self.first is None:
            return {}
        names = (keyed(name, link) for name, _, link in self.first.grouped.names())
        return dict(zip(names, self.first.prior_values.tolist(), strict=True))

    def constants_at(self, theta: FloatArray) -> list[float]:
        """Torque constants (n,), N·m/A, without their estimated errors."""
        constants = self._constant if self.fixed else self._of_joints(theta, "torque_constant")
        return [float(constant) for constant in constants]

    def inertial_at(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the links act like, (10 n,), and what of that is a payload on the last, (10,)."""
        payload = self._payload(theta)
        return self._inertial(theta) - payload, payload[-PER_LINK:]

    def _notes(self, record: Record | None) -> tuple[str, ...]:
        if record is None:
            return ()
        notes = [] if self.first is not None else [
            "torque_constant is not known: it is estimated by the masses of the file, which stay as they "
            "are. State it under [known] to have the masses estimated."
        ]  # fmt: skip
        for recording in record.recordings():
            for joint in self._reversed_joints(self.prepare(recording)):
                name = self.simulator.joints[joint]
                notes.append(
                    f"{name} (joint {joint}): what is measured falls where the torque of the file grows. The "
                    "joint turns the other way in the file, its column is another joint's, or its sign is "
                    "the other one; see [channels] (scale = -1)."
                )
        return tuple(dict.fromkeys(notes))

    def _reversed_joints(self, record: PreparedRecord) -> list[int]:
        """Joints whose output has the other sign than the file's rigid body."""
        torque = self._view(record).rigid(gravity_in_base(), 0.0) @ self.links.begin
        reversed_joints = []
        for joint in range(self.joints):
            qd = record.inputs[:, self.joints + joint]
            columns = np.column_stack([torque[:, joint], qd, np.sign(qd), np.ones_like(qd)])
            size = np.linalg.norm(columns, axis=0)
            if not np.all(size > 0.0):
                continue
            columns /= size
            shares, *_ = np.linalg.lstsq(columns, record.outputs[:, joint], rcond=None)
            residuals = record.outputs[:, joint] - columns @ shares
            error = np.sqrt(residuals.var() * np.linalg.pinv(columns.T @ columns)[0, 0])
            if shares[0] < WRONG_WAY * error:
                reversed_joints.append(joint)
        return reversed_joints
