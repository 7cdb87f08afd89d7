"""Read the links and joints of an arm from a MuJoCo file, and check its inverse dynamics against MuJoCo's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labhil.errors import UsageError
from labhil.extras import load_optional
from labhil.physics.arm.links import inertial_of
from labhil.physics.arm.rigid_body import GRAVITY, PER_LINK, gravity_in_base
from labhil.physics.arm.tree import Tree
from labhil.physics.terms import keyed
from labhil.signals import FloatArray
from labhil.simulators.mechanism import FRICTION_FIELDS, PURPOSE, Field, read_value
from labhil.simulators.mjcf_file import Names


@dataclass(frozen=True, slots=True, eq=False)
class ArmFile:
    """An arm's file, as it was read.

    Attributes:
        path: The file.
        model: The ``mujoco.MjModel``.
        tree: Links and joints.
        joints: Names of the joints.
        bodies: Names of the bodies with a joint.
        groups: Bodies that are fixed to each other behind each joint, the one with the joint first.
        nominal: Friction and armature by key.
    """

    path: Path
    model: Any
    tree: Tree
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    groups: tuple[tuple[int, ...], ...]
    nominal: dict[str, float]

    def rigid_body_model(self) -> Any:
        """Copy the model with inertia and gravity alone."""
        mujoco = load_optional("mujoco", PURPOSE)
        model = without_contacts(self.model)
        for array in ("dof_damping", "dof_dampingpoly", "dof_frictionloss", "dof_armature"):
            if hasattr(model, array):
                getattr(model, array)[:] = 0.0
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
        return model


def without_contacts(model: Any) -> Any:
    """Copy a model without contacts and joint limits: a recorded arm has reached neither."""
    from copy import deepcopy

    bits = load_optional("mujoco", PURPOSE).mjtDisableBit
    contactless = deepcopy(model)
    contactless.opt.disableflags |= int(bits.mjDSBL_CONTACT) | int(bits.mjDSBL_LIMIT)
    return contactless


def read_arm(file: Path, model: Any, names: Names) -> ArmFile:
    """Read the arm of a loaded file.

    Args:
        file: The file, for messages.
        model: MuJoCo's model.
        names: Its names.

    Returns:
        The arm.

    Raises:
        UsageError: A joint or a force is not as expected; the message states what was found.
    """
    mujoco = load_optional("mujoco", PURPOSE)
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    not_hinges = [name for name, kind in zip(names.joints, model.jnt_type, strict=True) if int(kind) != hinge]
    if not_hinges:
        raise UsageError(
            f"{file}: expected one hinge or slide joint, or several hinges, found {len(names.joints)} joints "
            f"of which {', '.join(not_hinges[:6])} are no hinges ({names.listing()}); weld what is not "
            "measured"
        )
    joint_bodies = [int(body) for body in model.jnt_bodyid]
    if len(set(joint_bodies)) < len(joint_bodies):
        raise UsageError(f"{file}: expected one joint for each body, found bodies with several")
    groups = tuple(tuple(_fixed_to(model, body)) for body in joint_bodies)
    level = _level_rotation(model, file)
    arm = ArmFile(
        file,
        model,
        _tree(model, joint_bodies, groups, level),
        names.joints,
        tuple(_body_name(model, body) for body in joint_bodies),
        groups,
        dict(_nominal(model)),
    )
    _check_dynamics(arm)
    return arm


def _fixed_to(model: Any, body: int) -> Iterator[int]:
    yield body
    for candidate in range(body + 1, model.nbody):
        if int(model.body_weldid[candidate]) == body:
            yield candidate


def _nominal(model: Any) -> Iterator[tuple[str, float]]:
    """Yield friction and armature of each joint by key, 0 included."""
    for joint in range(model.njnt):
        dof = int(model.jnt_dofadr[joint])
        for field, name in (*FRICTION_FIELDS.items(), (Field.ARMATURE, "added_inertia.inertia")):
            yield keyed(name, joint), read_value(model, field, dof)


def _level_rotation(model: Any, file: Path, *, tolerance: float = 0.01) -> FloatArray:
    """Return the rotation (3, 3) from the world to a frame in which gravity points along −z.

    ``tolerance`` is the relative deviation of its magnitude from 9.81 m/s².
    """
    gravity = np.array(model.opt.gravity, dtype=np.float64)
    magnitude = float(np.linalg.norm(gravity))
    if abs(magnitude / GRAVITY - 1.0) > tolerance:
        raise UsageError(
            f"{file}: expected gravity of {GRAVITY:g} m/s², found {magnitude:g}: correct <option>"
        )
    if np.any(model.body_gravcomp):
        raise UsageError(f"{file}: expected no gravcomp, found bodies with: the real arm's drives lift them")
    up = -gravity / magnitude
    helper = np.eye(3)[int(np.argmin(np.abs(up)))]
    if up[2] > 1.0 - 1e-12:
        return np.eye(3)
    x = np.cross(helper, up)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up])


def _tree(
    model: Any, joint_bodies: list[int], groups: tuple[tuple[int, ...], ...], level: FloatArray
) -> Tree:
    n = len(joint_bodies)
    carrier, turn, offset = np.full(n, -1, dtype=np.int64), np.empty((n, 3, 3)), np.empty((n, 3))
    anchors, axes = np.array(model.jnt_pos), np.array(model.jnt_axis)
    for j, body in enumerate(joint_bodies):
        parent, rotation, place = _pose(model, body, joint_bodies)
        if parent >= 0:
            carrier[j] = parent
            place = place - anchors[parent]
        else:
            rotation, place = level @ rotation, level @ place
        offset[j] = place + rotation @ anchors[j]
        at = int(model.jnt_qposadr[j])
        turn[j] = rotation @ rotation_about(axes[j], -float(model.qpos0[at]))
    begin = np.concatenate(
        [
            sum((_inertial(model, k, body, anchors[j]) for k in groups[j]), np.zeros(PER_LINK))
            for j, body in enumerate(joint_bodies)
        ]
    )
    return Tree(carrier, turn, offset, axes, begin)


def _pose(model: Any, body: int, joint_bodies: list[int]) -> tuple[int, FloatArray, FloatArray]:
    """Return the joint that carries a body (−1: none), and the pose in the frame of that joint's body."""
    rotation, place = np.eye(3), np.zeros(3)
    while True:
        turn_of_body = matrix_of(model.body_quat[body])
        place = np.array(model.body_pos[body]) + turn_of_body @ place
        rotation = turn_of_body @ rotation
        body = int(model.body_parentid[body])
        if body == 0:
            return -1, rotation, place
        if body in joint_bodies:
            return joint_bodies.index(body), rotation, place


def _inertial(model: Any, body: int, carrier: int, anchor: FloatArray) -> FloatArray:
    """Return the ten inertial parameters of a body in the frame of the joint that carries it."""
    rotation, place = np.eye(3), np.zeros(3)
    k = body
    while k != carrier:
        turn_of_body = matrix_of(model.body_quat[k])
        place = np.array(model.body_pos[k]) + turn_of_body @ place
        rotation = turn_of_body @ rotation
        k = int(model.body_parentid[k])
    centre = rotation @ np.array(model.body_ipos[body]) + place - anchor
    axes = rotation @ matrix_of(model.body_iquat[body])
    i = axes @ np.diag(model.body_inertia[body]) @ axes.T
    moments = (i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
    return inertial_of(float(model.body_mass[body]), tuple(centre), moments)


def matrix_of(quaternion: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) of a quaternion (w, x, y, z)."""
    w, x, y, z = np.asarray(quaternion, dtype=np.float64) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation_about(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation (3, 3) by an angle (rad) about a unit vector."""
    half = 0.5 * angle
    return matrix_of(np.array([np.cos(half), *(np.sin(half) * np.asarray(axis))]))


def _check_dynamics(arm: ArmFile, *, samples: int = 6, tolerance: float = 1e-6) -> None:
    """Raise UsageError where MuJoCo's inverse dynamics has forces that the links do not explain.

    The largest deviation at random ``samples`` is compared with ``tolerance`` times the largest torque.
    """
    mujoco = load_optional("mujoco", PURPOSE)
    model = arm.rigid_body_model()
    model.opt.gravity *= GRAVITY / float(np.linalg.norm(model.opt.gravity))
    random = np.random.default_rng(0)
    angles, velocities, accelerations = random.uniform(-1.0, 1.0, (3, samples, arm.tree.joints))
    by_links = arm.tree.regressor(angles, velocities, accelerations, gravity_in_base()) @ arm.tree.begin
    data, by_mujoco = mujoco.MjData(model), np.empty_like(by_links)
    for row, (q, qd, qdd) in enumerate(zip(angles, velocities, accelerations, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        by_mujoco[row] = data.qfrc_inverse
    deviation = np.max(np.abs(by_links - by_mujoco), axis=0) / max(float(np.max(np.abs(by_mujoco))), 1e-12)
    wrong = [name for name, share in zip(arm.joints, deviation, strict=True) if share > tolerance]
    if wrong:
        raise UsageError(
            f"{arm.path}: expected joints on which only their links, friction and armature act, found other "
            f"forces on {', '.join(wrong)}: springs, tendons, equality constraints or fluid. Take them out, "
            "or give the joint a file of its own"
        )
    massless = [name for name, link in zip(arm.bodies, _link_masses(arm), strict=True) if not link > 0.0]
    if len(massless) == len(arm.bodies):
        raise UsageError(f"{arm.path}: expected links with masses, found none with any")


def _link_masses(arm: ArmFile) -> FloatArray:
    return arm.tree.begin[::PER_LINK]


def _body_name(model: Any, body: int) -> str:
    mujoco = load_optional("mujoco", PURPOSE)
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or f"body_{body}"
