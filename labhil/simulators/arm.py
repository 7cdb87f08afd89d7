"""An arm of a user's MuJoCo file as a rig: measured motion in, measured torques or currents out.

:mod:`labhil.simulators.arm_file` reads the file, ``arm_patches`` writes estimated values into it.
"""

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
from labhil.physics.record import Record
from labhil.physics.rigs import RigModel, declare_model
from labhil.physics.terms import Term, keyed
from labhil.rig import RigFile, default_rig
from labhil.rig_sections import ModelSection
from labhil.signals import FloatArray, Signal
from labhil.simulators.arm_file import ArmFile, read_arm
from labhil.simulators.mjcf_file import load_model, names_of
from labhil.simulators.names import identifier

CURRENT, TORQUE = KINDS = ("current", "torque")
"""Quantities that may be measured of a joint's drive."""

UNITS = {CURRENT: "A", TORQUE: "N·m"}
FILE_TERMS = ("viscous_friction", "coulomb_friction", "added_inertia")
"""Terms for which MuJoCo files have an attribute of the joint: damping, frictionloss, armature."""

OFFSET_TERM = "sensor_offset"
GEAR_TERMS = ("load_dependent_friction", "cubic_viscous_friction")
"""Further terms that are usual in geared joints; linear, so that a fit of all takes seconds."""


@dataclass(frozen=True, eq=False)
class ArmSimulator:
    """A MuJoCo file with several joints; it can be given wherever a rig can.

    Attributes:
        arm: The file.
        name: Name of the rig kind.
        output: Name of the measured signal.
        measures: Its quantity, ``"current"`` or ``"torque"``.
        section: The table ``[model]`` of a rig file that states the same file and names.

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
    section: ModelSection | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the columns of a recording."""
        return self.arm.joints

    @property
    def unit(self) -> str:
        """Unit of the measured signal."""
        return UNITS[self.measures]

    @property
    def kind(self) -> RigKind:
        """The rig kind: signals, and the keys that ``[known]`` may have."""
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
        """A rig file with the kind, and the file that the arm was read from."""
        return default_rig(self.name).model_copy(update={"model": self.section})

    @property
    def initial_terms(self) -> tuple[str, ...]:
        """Terms that a diagnosis starts with: those that MuJoCo has for every joint, and an offset.

        A file without damping, frictionloss and armature sets them to 0, which recordings contradict.
        """
        in_file = {name.partition(".")[0] for name, value in self.arm.nominal.items() if value}
        return tuple(dict.fromkeys((*FILE_TERMS, OFFSET_TERM, *sorted(in_file))))


def arm_simulator(
    path: Path,
    inputs: Mapping[str, str] | None = None,
    outputs: Mapping[str, str] | None = None,
    name: str = "",
) -> ArmSimulator:
    """Read a MuJoCo file with several hinges as a rig; arguments as for ``labhil.mujoco_simulator``."""
    model = load_model(path)
    names = names_of(model)
    if inputs:
        raise UsageError(
            f"{path}: inputs: of a file with several joints the measured motion is the input, actual_q and "
            f"actual_qd with {len(names.joints)} columns each ({', '.join(names.joints)}), found "
            f"{', '.join(inputs)}; say under [channels] which columns these are"
        )
    output, measures = _measured(path, outputs)
    arm = read_arm(path, model, names)
    model_name = bytes(model.names).split(b"\0", 1)[0].decode("utf-8", "replace")
    rig_name = identifier(name or (path.stem if model_name in ("", "MuJoCo Model") else model_name))
    section = ModelSection(mujoco=str(path), outputs={output: measures})
    simulator = ArmSimulator(arm, rig_name, identifier(output), measures, section)
    declare_kind(simulator.kind)

    def make_model(rig: RigFile, record: Record | None) -> ArmFileModel:
        return ArmFileModel(simulator, rig, record)

    initial_terms = simulator.initial_terms
    declare_model(
        simulator.name,
        RigModel(make_model, initial_terms, tuple(dict.fromkeys((*initial_terms, *GEAR_TERMS)))),
    )
    return simulator


def _measured(path: Path, outputs: Mapping[str, str] | None) -> tuple[str, str]:
    """Return the name of the recorded output, and its quantity."""
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

    Inertial parameters are estimated as far as the recording determines them. The others keep the values of
    the file, as do those that act in the same way as an armature.
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
        """Without torque constants, the masses of the file determine the scale of the torques."""
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
        """Return the grouped parameters of the file by key."""
        if self.first is None:
            return {}
        names = (keyed(name, link) for name, _, link in self.first.grouped.names())
        return dict(zip(names, self.first.prior_values.tolist(), strict=True))

    def constants_at(self, theta: FloatArray) -> list[float]:
        """Return the torque constants (n,), N·m/A, without their estimated errors."""
        constants = self._constant if self.fixed else self._of_joints(theta, "torque_constant")
        return [float(constant) for constant in constants]

    def inertial_at(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the inertial parameters of the links without payload (10 n,), and of the payload (10,)."""
        payload = self._payload(theta)
        return self._inertial(theta) - payload, payload[-PER_LINK:]

    def _notes(self, record: Record | None) -> tuple[str, ...]:
        if record is None:
            return ()
        notes = [] if self.first is not None else [
            "torque_constant is not known: it is estimated from the masses of the file, which stay as they "
            "are. State it under [known] to have the masses estimated."
        ]  # fmt: skip
        for recording in record.recordings():
            for joint in self._reversed_joints(self.prepare(recording)):
                name = self.simulator.joints[joint]
                notes.append(
                    f"{name} (joint {joint}): the measured signal falls where the torque of the file grows. "
                    "The joint turns the other way in the file, its column belongs to another joint, or its "
                    "sign is reversed; see [channels] (scale = -1)."
                )
        return tuple(dict.fromkeys(notes))

    def _reversed_joints(self, record: PreparedRecord, *, min_errors: float = 10.0) -> list[int]:
        """Find joints whose output falls with the torque of the rigid body, by ``min_errors`` sigma."""
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
            if shares[0] < -min_errors * error:
                reversed_joints.append(joint)
        return reversed_joints
