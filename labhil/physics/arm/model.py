"""White-box model of a six-jointed robot arm by inverse dynamics: measured motion in, motor currents out.

i_j = (1 + g_j)·τ_j(t − T_d)/K_j + i_0j, τ = Y(q, q̇, q̈; gravity)·π + friction and other joint laws; current
i (A), torque τ (N·m), torque constant K (N·m/A) and its error g, clock offset T_d (s), inertial parameters π.
Equations 4.19 to 4.64 of the reference text, with a recursion instead of its symbolic matrices.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import numpy as np

from labhil.errors import UnknownNameError
from labhil.physics.arm.catalogue import GEAR_RATIO, UNOBSERVABLE_TERMS, Sizes, catalogue
from labhil.physics.arm.chain import Chain
from labhil.physics.arm.controller_constants import constant_notes, controller_constants
from labhil.physics.arm.first_estimate import LAWS as FIRST_LAWS
from labhil.physics.arm.first_estimate import FirstEstimate, combine_estimates, first_estimate
from labhil.physics.arm.grouped import group_parameters
from labhil.physics.arm.joint_laws import JointMotion, directions, laws
from labhil.physics.arm.links import UR5, inertial_of, links_of
from labhil.physics.arm.motion import Motion, PreparedRecord, cut_off_of, prepare_record, temperatures
from labhil.physics.arm.own_parameters import TYPICAL_CONSTANT, arm_parameters
from labhil.physics.arm.rigid_body import PER_LINK, gravity_in_base
from labhil.physics.arm.view import RecordViews, View
from labhil.physics.extra_force import ExtraForce, MovedPart
from labhil.physics.model import Metric, index_of
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Parameter, Term, keyed
from labhil.rig import RigFile
from labhil.signals import FloatArray

LOAD_FRICTION = "load_dependent_friction.coefficient"
OFFSET = "sensor_offset.offset"
GAIN = "torque_constant.gain"
COMPLIANCE = "joint_elasticity.compliance"
PRESLIDING_LENGTH = "presliding_friction.length"
WHOLE_ARM = ("payload", "base_tilt", "clock_offset")
CACHED_RECORDS = 8
"""Records whose motion and regressors are cached, for each recording that is fitted."""

LAST_LINK = slice(-PER_LINK, None)


class ArmModel:
    """White-box model of one six-jointed arm (implements ``physics.model.Model``).

    Inputs are ``actual_q`` and ``actual_qd``, outputs the six currents. The rig file's ``links`` (the UR5 of
    the manufacturer by default) give lengths and, if known, inertia; else grouped inertial parameters are
    estimated. Without ``torque_constant`` that is estimated too, relative to a known inertia. With neither,
    it is the controller's if planned torques and currents are recorded (``arm.controller_constants``); else a
    common factor of both is not identifiable, as the statistics show.
    """

    kind = "ur5"
    coordinate_units: Mapping[str, str] = {
        "actual_q": "rad",
        "actual_qd": "rad/s",
        "acceleration": "rad/s²",
        "load": "N·m",
        "joint_temperatures": "°C",
    }
    metric = Metric.INVERSE_DYNAMICS
    state_names: tuple[str, ...] = ()
    state_scale = np.empty(0)
    fading_memory = True
    force_unit = "N·m"
    output_unit = "A"
    first_laws: tuple[str, ...] = FIRST_LAWS
    _forces: tuple[ExtraForce, ...] = ()

    def __init__(self, rig: RigFile, record: Record | None = None) -> None:
        self.links = self._chain(rig)
        self.joints = self.links.joints
        stated = self._stated_constants(rig)
        self.controller = None if record is None else controller_constants(record)
        # known masses are the better reference, so constants are then estimated
        taken = self.controller if stated is None and self.links.inertial is None else None
        known = stated if taken is None else taken.value.tolist()
        if known is None:
            self.links = self._reference()
        self.scale_error = 0.0 if taken is None else taken.relative_error
        constants = self.controller
        self.notes = () if constants is None else constant_notes(constants, stated, taken is not None)
        self._constant = np.full(self.joints, TYPICAL_CONSTANT) if known is None else np.array(known)
        self.fixed = {} if known is None else {keyed("torque_constant", j): k for j, k in enumerate(known)}
        self.cut_off = rig.metric.cut_off or cut_off_of(record)
        self.horizon = rig.metric.horizon or 1.0
        sizes = Sizes.of(record, self._constant)
        self.moved = tuple(
            MovedPart(f"actual_q_{j}", f"actual_qd_{j}", joint=j, force=float(torque), speed=float(speed))
            for j, (torque, speed) in enumerate(zip(sizes.torque, sizes.speed, strict=True))
        )
        warm = None if record is None else temperatures(record)
        self._temperature = np.zeros(self.joints) if warm is None else warm.mean(axis=0)
        size = CACHED_RECORDS * (1 if record is None else len(record.begins))
        self._views = RecordViews(self._temperature, size)
        self.first = self._first(record)
        everything = catalogue(sizes, self._gear_ratio(rig), self.output_unit)
        self._known = {p.key: p.scale for term in everything.values() for p in term.known}
        self.unobservable_terms = dict(UNOBSERVABLE_TERMS) | self._absent(
            everything, record is None or warm is not None
        )
        self.terms: Mapping[str, Term] = {
            k: t for k, t in everything.items() if k not in self.unobservable_terms
        }
        own = arm_parameters(self.joints, self.first, known=bool(self.fixed))
        self.parameters = own + tuple(p for term in self.terms.values() for p in term.parameters)
        self._index, self._laws = index_of(self.parameters), laws()
        self._six = {name: self._places(name) for name in {p.name for p in self.parameters}}

    def _chain(self, rig: RigFile) -> Chain:
        """The rigid bodies of this arm."""
        table = rig.known_file("links")
        return UR5 if table is None else links_of(table.text(), table.source)

    def _reference(self) -> Chain:
        """The rigid bodies if the torque constants are not known."""
        return self.links

    def _stated_constants(self, rig: RigFile) -> list[float] | None:
        """Torque constants of the rig file, N·m/A."""
        return rig.known_numbers("torque_constant")

    def _gear_ratio(self, rig: RigFile) -> Sequence[float | None]:
        """Gear ratio of each joint; None where it is not known."""
        return rig.known_numbers("gear_ratio") or GEAR_RATIO

    def _absent(self, everything: Mapping[str, Term], warm: bool) -> dict[str, str]:
        reasons = {
            key: f"needs {', '.join(term.needs)}"
            for key, term in everything.items()
            if term.needs and not warm
        }
        if not self.fixed:
            reason = "torque_constant is not known, and so estimated anyway"
            reasons |= {keyed("torque_constant", joint): reason for joint in range(self.joints)}
        return reasons

    def _first(self, record: Record | None) -> FirstEstimate | None:
        """First estimate of the inertia; None if that of the links is known."""
        if self.links.inertial is not None:
            return None
        if record is None:
            group = group_parameters(self.links)
            begin = self.links.begin
            return FirstEstimate(group, group.shares @ begin, np.ones(len(group.kept)), begin)
        estimates = [
            first_estimate(self.links, ready, self._view(ready), self._constant, self.first_laws)
            for ready in map(self.prepare, record.recordings())
        ]
        return estimates[0] if len(estimates) == 1 else combine_estimates(self.links, estimates)

    @property
    def combinations(self) -> Mapping[str, str]:
        """Combination that each grouped inertial parameter stands for, by key (links count from 0)."""
        if self.first is None:
            return {}
        names = [keyed(name, link) for name, _, link in self.first.grouped.names()]
        return dict(zip(names, self.first.grouped.combinations, strict=True))

    @property
    def blocks(self) -> Mapping[str, tuple[int, ...]]:
        """Joints whose currents depend on each parameter, by key."""
        joints = {}
        for p in self.parameters:
            alone = p.joint is not None and not p.name.startswith("grouped_") and p.name != COMPLIANCE
            joints[p.key] = self._reach(p) if not alone or p.joint is None else (p.joint,)
        return joints

    def _reach(self, parameter: Parameter) -> tuple[int, ...]:
        """Joints whose currents depend on a parameter of the rigid body or of the whole arm."""
        link = None if parameter.name == COMPLIANCE else parameter.joint
        return tuple(range(self.joints) if link is None else self.links.loaded(link))

    def sizes_of_load(self, mass: float, centre: Sequence[float]) -> dict[str, float]:
        """Change of the grouped parameters by a point ``mass`` (kg) at ``centre`` (m, flange's frame).

        By key; empty if the inertia is known and so has no parameters.
        """
        if self.first is None:
            return {}
        group = self.first.grouped
        added = group.shares[:, LAST_LINK] @ inertial_of(mass, tuple(centre))
        return {keyed(n, link): float(a) for (n, _, link), a in zip(group.names(), added, strict=True)}

    def with_force(self, force: ExtraForce) -> ArmModel:
        """Copy of the arm with a further additional torque on one joint, N·m."""
        other = copy.copy(self)
        other._forces = (*self._forces, force)
        return other

    def horizon_at(self, theta: FloatArray) -> float:
        """Gap before held-out data, s; inverse dynamics has no scored horizon."""
        return self.horizon

    def prepare(self, record: Record) -> PreparedRecord:
        """Filter and thin out (``physics.arm.motion``); RecordingError if there is too little motion."""
        return record if isinstance(record, PreparedRecord) else prepare_record(record, self.cut_off)

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Inverse dynamics has no states: (w, 0)."""
        return np.empty((len(windows), 0))

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Compute the currents of six joints, (N, 6), A; the measured one where a joint rests."""
        current = self._gain(theta) * self._torques(theta, record) + self._of_joints(theta, OFFSET)
        _, motion, rows = self._motion(record)
        return np.where(motion.judged[rows], current, record.outputs)[windows.rows]

    def regressor(self, theta: FloatArray, record: Record, free_keys: Sequence[str]) -> FloatArray:
        """Exact derivatives of :meth:`simulate` over a whole record by linear parameters, (N·6, P), A.

        Raises UnknownNameError for a key that is not a linear parameter of this model.
        """
        linear = {p.key: p for p in self.parameters if p.linear}
        _, motion, rows = self._motion(record)
        out = np.zeros((len(rows), self.joints, len(free_keys)))
        for i, key in enumerate(free_keys):
            if key not in linear:
                raise UnknownNameError("linear parameter of ur5", key, linear)
            self._slope(theta, record, linear[key], out[:, :, i])
        out *= motion.judged[rows][:, :, None]
        return out.reshape(-1, len(free_keys))

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Angle, velocity, acceleration, rigid-body torque (``load``), temperature of each joint, (N,)."""
        _, motion, rows = self._motion(record)
        at = rows[windows.rows]
        columns = {
            "actual_q": motion.q[at],
            "actual_qd": motion.qd[at],
            "acceleration": motion.qdd[at],
            "joint_temperatures": motion.temperature[at],
        }
        along = {f"{name}_{j}": values[:, j] for name, values in columns.items() for j in range(self.joints)}
        return {**along, **self.drive_coordinates(theta, record, windows, along)}

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Rigid-body torque of each joint, (N,), N·m."""
        load = self._rigid(theta, record)[windows.rows]
        return {f"load_{j}": load[:, j] for j in range(self.joints)}

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Torque of each drive at these coordinates, (N, 6), N·m, with dry friction along sgn q̇."""
        return np.column_stack([self._torque_at(theta, coordinates, joint) for joint in range(self.joints)])

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """All 1: joints differ in size, so starts are in the units of the parameters."""
        return dict.fromkeys(CharacteristicScale, 1.0)

    def _places(self, name: str) -> np.ndarray:
        """Index of a parameter in theta for each joint (6,); −1 where a joint has none."""
        return np.array([self._index.get(keyed(name, joint), -1) for joint in range(self.joints)])

    def _of_joints(self, theta: FloatArray, name: str) -> FloatArray:
        """Values of a parameter (6,); zero where a joint has none."""
        places = self._six.get(name)
        return np.zeros(self.joints) if places is None else np.where(places >= 0, theta[places], 0.0)

    def _number(self, theta: FloatArray, name: str) -> float:
        return float(theta[self._index[name]])

    def _gain(self, theta: FloatArray) -> FloatArray:
        """Current per torque (6,), A/(N·m)."""
        constant = self._constant if self.fixed else self._of_joints(theta, "torque_constant")
        return np.asarray((1.0 + self._of_joints(theta, GAIN)) / constant)

    def _gravity(self, theta: FloatArray) -> FloatArray:
        return gravity_in_base(self._number(theta, "base_tilt.roll"), self._number(theta, "base_tilt.pitch"))

    def _payload(self, theta: FloatArray) -> FloatArray:
        """Inertial parameters (60,) of the payload."""
        out = np.zeros(self.joints * PER_LINK)
        centre = tuple(self._number(theta, f"payload.centre_{axis}") for axis in "xyz")
        out[LAST_LINK] = inertial_of(self._number(theta, "payload.mass"), centre)
        return out

    def _inertial(self, theta: FloatArray) -> FloatArray:
        """Inertial parameters (60,) of the arm with its payload."""
        if self.first is None:
            return self._load_inertial(theta)
        names = [keyed(name, link) for name, _, link in self.first.grouped.names()]
        values = theta[[self._index[name] for name in names]]
        return self.first.inertial(values) + self._payload(theta)

    def _load_inertial(self, theta: FloatArray) -> FloatArray:
        """Inertial parameters (60,) for the load on the gears: known ones or the first estimate."""
        known = self.links.inertial
        if known is None:
            assert self.first is not None
            known = self.first.inertial(self.first.values)
        return np.asarray(known + self._payload(theta))

    def _motion(self, record: Record) -> tuple[FloatArray, Motion, np.ndarray]:
        return self._views.motion(record)

    def _view(self, record: Record) -> View:
        return self._views.of(self.links, record)

    def _delay(self, theta: FloatArray) -> float:
        return self._number(theta, "clock_offset.offset")

    def _rigid_regressor(self, theta: FloatArray, record: Record) -> FloatArray:
        view, gravity, delay = self._view(record), self._gravity(theta), self._delay(theta)
        compliance = self._of_joints(theta, COMPLIANCE)
        if not np.any(compliance):
            return view.rigid(gravity, delay)
        return view.elastic_regressor(compliance, self._load_inertial(theta), gravity, delay)

    def _rigid(self, theta: FloatArray, record: Record) -> FloatArray:
        """Torques of the rigid body (n, 6), N·m; cached, since most steps of a fit change friction only."""
        inertial, compliance = self._inertial(theta), self._of_joints(theta, COMPLIANCE)
        key = (
            inertial.tobytes(), self._gravity(theta).tobytes(), compliance.tobytes(), self._delay(theta)
        )  # fmt: skip
        return self._view(record).torques.of(key, lambda: self._rigid_torques(theta, record, inertial))

    def _rigid_torques(self, theta: FloatArray, record: Record, inertial: FloatArray) -> FloatArray:
        view, gravity, delay = self._view(record), self._gravity(theta), self._delay(theta)
        compliance = self._of_joints(theta, COMPLIANCE)
        if not np.any(compliance):
            return view.straight_torques(gravity, delay, inertial)
        return view.elastic_torques(compliance, self._load_inertial(theta), gravity, delay, inertial)

    def _torques(self, theta: FloatArray, record: Record) -> FloatArray:
        """Torques of the drives (n, 6), N·m: rigid body, joint laws, additional forces."""
        view = self._view(record)
        torques = self._rigid(theta, record).copy()
        for name in self._laws:
            for joint, level in enumerate(self._of_joints(theta, name)):
                if level:
                    torques[:, joint] += level * self._law(theta, view, joint, name)
        for joint, share in enumerate(self._of_joints(theta, LOAD_FRICTION)):
            if share:
                torques[:, joint] += share * self._load(theta, view, joint)
        lengths, delay = self._of_joints(theta, PRESLIDING_LENGTH), self._delay(theta)
        for force in self._forces:
            assert force.joint is not None
            torques[:, force.joint] -= view.push(force, float(lengths[force.joint]), delay)
        return torques

    def _law(self, theta: FloatArray, view: View, joint: int, name: str) -> FloatArray:
        length = float(self._of_joints(theta, PRESLIDING_LENGTH)[joint])
        return view.law(
            joint, name, self._laws[name], self._shape(theta, joint, name), length, self._delay(theta)
        )

    def _shape(self, theta: FloatArray, joint: int, name: str) -> float:
        """Value of a law's shape parameter, known or estimated; 0 if it has none."""
        shaped_by = self._laws[name].shaped_by
        if shaped_by is None:
            return 0.0
        known = self._known.get(keyed(shaped_by, joint))
        return float(self._of_joints(theta, shaped_by)[joint]) if known is None else known

    def _load(self, theta: FloatArray, view: View, joint: int) -> FloatArray:
        length = float(self._of_joints(theta, PRESLIDING_LENGTH)[joint])
        inertial, gravity = self._load_inertial(theta), self._gravity(theta)
        return view.load(joint, length, inertial, gravity, self._delay(theta))

    def _slope(self, theta: FloatArray, record: Record, parameter: Parameter, out: FloatArray) -> None:
        """Fill ``out`` (n, 6) with the derivative by one linear parameter, A per unit."""
        view, gain, joint = self._view(record), self._gain(theta), parameter.joint
        assert joint is not None
        if parameter.name == OFFSET:
            out[:, joint] = 1.0
        elif parameter.name == LOAD_FRICTION:
            out[:, joint] = gain[joint] * self._load(theta, view, joint)
        elif parameter.name in self._laws:
            out[:, joint] = gain[joint] * self._law(theta, view, joint, parameter.name)
        else:
            assert self.first is not None
            column = self.first.grouped.column(parameter.name, joint)
            out[:] = gain * self._rigid_regressor(theta, record)[:, :, column]

    def _torque_at(self, theta: FloatArray, coordinates: Mapping[str, FloatArray], joint: int) -> FloatArray:
        q, qd = coordinates[f"actual_q_{joint}"], coordinates[f"actual_qd_{joint}"]
        load, s = coordinates[f"load_{joint}"], directions(q, qd, 0.0)
        warmer = coordinates[f"joint_temperatures_{joint}"] - self._temperature[joint]
        torque = load + self._of_joints(theta, LOAD_FRICTION)[joint] * np.abs(load) * s
        for name, law in self._laws.items():
            level = self._of_joints(theta, name)[joint]
            if level:
                shape = self._shape(theta, joint, name)
                at = JointMotion(q, qd, coordinates[f"acceleration_{joint}"], warmer, s, shape)
                torque = torque + level * law.column(at)
        return torque
