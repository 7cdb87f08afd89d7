"""A MuJoCo file (MJCF, or URDF as far as MuJoCo loads it) with one joint as a simulator."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from labhil.errors import UsageError, suggestion
from labhil.extras import load_optional
from labhil.physics.quantity import Quantity
from labhil.simulators.arm import ArmSimulator, arm_simulator
from labhil.simulators.mechanism import PURPOSE, RUBS, Field, Mechanism, Value, read_value
from labhil.simulators.mjcf_file import Described, Names, load_model, names_of
from labhil.simulators.mjcf_unheld import notes_on, refuse_unheld, sensor_delay
from labhil.simulators.names import identifier
from labhil.simulators.rollouts import Driven
from labhil.simulators.simulator import Coordinate, Simulator, declare
from labhil.simulators.stepped import Held

VISCOUS = "viscous_friction"


def mujoco_simulator(
    path: str | Path,
    *,
    inputs: Mapping[str, str] | None = None,
    outputs: Mapping[str, str] | None = None,
    name: str = "",
) -> Simulator | ArmSimulator:
    """Take a MuJoCo file for a simulator; the whole catalogue of effects is then there for it.

    A file with several hinges is an arm: its motion is the input (``actual_q``, ``actual_qd``, a column for
    each joint), and the torques or currents of its drives are the output, by inverse dynamics. Masses, mass
    centres and inertias that a recording can tell from the file's are estimated.

    A file with one hinge or slide joint is simulated. Its spring, armature, masses and the gains of its
    actuator are parameters where they are not 0, and start at what the file says. Those that a recording
    cannot tell from others stay at that. Its damping and dry friction are the effects viscous_friction and
    coulomb_friction, with which a diagnosis begins.

    Args:
        path: The file: MJCF, or URDF as far as MuJoCo loads it.
        inputs: Actuator by the name of the recorded signal, or the joint where a torque or force is recorded
            that no actuator stands for. The only actuator by its own name when absent. Of an arm: nothing.
        outputs: Joint or ``jointpos``/``jointvel`` sensor by the name of the recorded signal. The sensors by
            their own names when absent, the joint by its own where there are none. Of an arm: what the one
            measured signal is, ``"current"`` or ``"torque"``; ``{"actual_current": "current"}`` when absent.
        name: What the rig is called; the file's model name when absent.

    Returns:
        The simulator: :func:`labhil.fit`, :func:`labhil.diagnose` and others take it for a rig.

    Raises:
        UsageError: What was expected of the file or of the names, and what the file has.
        MissingExtraError: The package ``mujoco`` is not installed.

    Example:
        >>> import labhil as lh
        >>> arm = lh.mujoco_simulator("examples/pendulum.xml")
        >>> arm.inputs, arm.outputs
        ({'motor': 'N·m'}, {'angle': 'rad'})
        >>> sorted(arm.parameters)
        ['gear', 'rod_mass']
    """
    if load_model(Path(path)).njnt > 1:
        return arm_simulator(Path(path), inputs, outputs, name)
    return describe(Path(path), inputs, outputs, name).simulator


def describe(
    file: Path,
    inputs: Mapping[str, str] | None = None,
    outputs: Mapping[str, str] | None = None,
    name: str = "",
) -> Described:
    """Read a file and make a simulator of it; as :func:`mujoco_simulator`."""
    model = load_model(file)
    has = names_of(model)
    joint = _only_joint(model, file, has)
    refuse_unheld(model, file)
    hinge = model.jnt_type[joint] == int(load_optional("mujoco", PURPOSE).mjtJoint.mjJNT_HINGE)
    length, force = ("rad", "N·m") if hinge else ("m", "N")
    signal, driven = _input(model, file, has, joint, inputs)
    position, velocity, measured, sensors = _outputs(model, file, has, joint, outputs)
    late = sensor_delay(model, file, sensors)
    values = tuple(_values(model, joint, driven, hinge))
    states = {position: length, velocity: f"{length}/s"}
    called = identifier(name or _model_name(model, file))
    frictions = {name: _friction(model, field, joint) for field, name in RUBS.items()}
    terms = [name.partition(".")[0] for name, strength in frictions.items() if strength]
    begins = tuple(dict.fromkeys((VISCOUS, *terms)))
    mechanism = Mechanism(model, driven, values, _held(model, joint, driven, file), late)
    _check_moves(file, mechanism, [value.start for value in values], signal)
    made = Simulator(
        _not_compiled,
        called,
        states,
        {signal: force if _pushes_directly(model, driven) else "1"},
        {n: u for n, u in states.items() if n in measured},
        {value.name: Quantity(value.start, value.unit) for value in values},
        position,
        Coordinate(velocity, force=force),
        None,
        mechanism,
        {value.name: value.start for value in values}
        | {name: strength for name, strength in frictions.items() if name.partition(".")[0] in begins},
        notes_on(model, has, driven.actuator, sensors),
    )
    declare(made, begins)
    return Described(file, model, made, mechanism, driven.actuator)


def _not_compiled(t: float, x: Any, u: Any, p: Any) -> tuple[float, float]:
    raise UsageError("a MuJoCo file has no right-hand side of its own")


def _only_joint(model: Any, file: Path, has: Names) -> int:
    mujoco = load_optional("mujoco", PURPOSE)
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    if model.nv != 1 or model.njnt != 1 or model.jnt_type[0] not in kinds:
        raise UsageError(
            f"{file}: expected one hinge or slide joint and no other degree of freedom, found "
            f"{model.nv} degrees of freedom ({has.listing()}); weld what is not measured, or take the "
            "joint's part into a file of its own"
        )
    if model.na:
        raise UsageError(
            f"{file}: expected actuators without a state of their own, found {model.na} activation(s); let a "
            "motor act and leave its lag to the effect actuator_lag"
        )
    return 0


def _input(
    model: Any, file: Path, has: Names, joint: int, stated: Mapping[str, str] | None
) -> tuple[str, Driven]:
    """Name of the recorded input, and what it drives."""
    if stated is None:
        if len(has.actuators) != 1:
            raise UsageError(
                f"{file}: expected one actuator, found {len(has.actuators)} ({has.listing()}); say which "
                'one the recorded input drives: inputs = { torque = "NAME" }, a joint\'s name for a torque '
                "or force at the joint"
            )
        stated = {has.actuators[0]: has.actuators[0]}
    if len(stated) != 1:
        raise UsageError(f"{file}: inputs: expected one signal, found {', '.join(stated) or 'none'}")
    ((signal, of),) = stated.items()
    if of in has.actuators:
        return identifier(signal), _driven(model, file, of, has.actuators.index(of), joint)
    if of in has.joints:
        return identifier(signal), Driven(-1, 0)
    known = (*has.actuators, *has.joints)
    raise UsageError(
        f"{file}: inputs: {signal}: no actuator or joint {of!r}{suggestion(of, known)}; {has.listing()}"
    )


def _driven(model: Any, file: Path, name: str, actuator: int, joint: int) -> Driven:
    mujoco = load_optional("mujoco", PURPOSE)
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    if model.actuator_trntype[actuator] not in kinds or model.actuator_trnid[actuator][0] != joint:
        raise UsageError(f"{file}: actuator {name}: expected one that acts on the joint, found another")
    places = getattr(model, "actuator_ctrladr", np.arange(model.nu))
    return Driven(actuator, int(places[actuator]))


def _outputs(
    model: Any, file: Path, has: Names, joint: int, stated: Mapping[str, str] | None
) -> tuple[str, str, tuple[str, ...], tuple[int, ...]]:
    """Names of position and velocity, which of the two are measured, and the sensors' numbers."""
    velocities = int(load_optional("mujoco", PURPOSE).mjtSensor.mjSENS_JOINTVEL)
    sensors = [s for s in has.sensors if s]
    given = (
        stated if stated is not None else {s: s for s in sensors} or {has.joints[joint]: has.joints[joint]}
    )
    signals: dict[bool, str] = {}
    for signal, of in given.items():
        if of not in sensors and of != has.joints[joint]:
            known = (*sensors, has.joints[joint])
            raise UsageError(
                f"{file}: outputs: {signal}: no joint or sensor of position or velocity "
                f"{of!r}{suggestion(of, known)}; {has.listing()}"
            )
        is_rate = of in sensors and int(model.sensor_type[has.sensors.index(of)]) == velocities
        signals.setdefault(is_rate, identifier(signal))
    if not signals:
        raise UsageError(f"{file}: outputs: expected one signal at least, found none; {has.listing()}")
    position = signals.get(False, identifier(has.joints[joint]))
    velocity = signals.get(True, f"{position}_velocity")
    used = tuple(has.sensors.index(of) for of in given.values() if of in sensors)
    return position, velocity, tuple(signals.values()), used


def _values(model: Any, joint: int, driven: Driven, hinge: bool) -> Iterable[Value]:
    """What of a file is a parameter: values that are not 0, and the rest of a spring."""
    length, force = ("rad", "N·m") if hinge else ("m", "N")
    units = {
        Field.STIFFNESS: f"{force}/{length}",
        Field.SPRINGREF: length,
        Field.ARMATURE: "kg·m²" if hinge else "kg",
        Field.GEAR: "1",
        Field.KP: "1",
        Field.KV: "1",
    }

    def value(field: Field, of: int, name: str = "") -> Iterable[Value]:
        start = read_value(model, field, of)
        sprung = field is Field.SPRINGREF and read_value(model, Field.STIFFNESS, of) != 0.0
        if start != 0.0 or sprung:
            yield Value(name or field.value, field, of, units.get(field, "kg"), start)

    # in the order in which one is estimated before others that the outputs cannot tell from it
    for field in (Field.STIFFNESS, Field.SPRINGREF):
        yield from value(field, joint)
    first = int(model.jnt_bodyid[joint])
    for body in range(first, model.nbody):
        if model.body_dofnum[body] or model.body_weldid[body] == first:
            yield from value(Field.MASS, body, f"{identifier(_body(model, body))}_mass")
    yield from value(Field.ARMATURE, joint)
    if driven.actuator >= 0:
        yield from value(Field.GEAR, driven.actuator)
        if _is_servo(model, driven.actuator):
            yield from value(Field.KP, driven.actuator)
            yield from value(Field.KV, driven.actuator)


def _held(model: Any, joint: int, driven: Driven, file: Path) -> Held:
    """What is solved apart: ends of the way, limits of the input and its delay."""
    ended = model.jnt_limited[joint] and not _is_off(model, "LIMIT")
    way = tuple(model.jnt_range[joint].tolist()) if ended else (-np.inf, np.inf)
    k = driven.actuator
    if k < 0:
        return Held(way)
    clipped = model.actuator_ctrllimited[k] and not _is_off(model, "CLAMPCTRL")
    low, high = model.actuator_ctrlrange[k].tolist() if clipped else (-np.inf, np.inf)
    for least, most in _limits_of_force(model, joint, k, file):
        low, high = max(low, least), min(high, most)
    delay = float(model.actuator_delay[k]) if hasattr(model, "actuator_delay") else 0.0
    return Held(way, (low, high), delay)


def _limits_of_force(model: Any, joint: int, k: int, file: Path) -> Iterable[tuple[float, float]]:
    """Limits of the actuator's and of the joint's force, as limits of the input."""
    gain, gear = float(model.actuator_gainprm[k][0]), float(model.actuator_gear[k][0])
    limits = [("forcerange", model.actuator_forcerange[k], gain)] * bool(model.actuator_forcelimited[k])
    if hasattr(model, "jnt_actfrclimited") and model.jnt_actfrclimited[joint]:
        limits.append(("actuatorfrcrange", model.jnt_actfrcrange[joint], gain * gear))
    for name, ends, per_input in limits:
        if model.actuator_biastype[k] or model.actuator_gaintype[k] or not per_input:
            raise UsageError(
                f"{file}: expected {name} at an actuator whose force is in proportion to its input (motor), "
                "found it at another, where it is no limit of the input. Leave it out, and keep the "
                "recording below it"
            )
        least, most = sorted((ends / per_input).tolist())
        yield float(least), float(most)


def _is_off(model: Any, what: str) -> bool:
    """Whether a flag of the file switches something off."""
    bits = load_optional("mujoco", PURPOSE).mjtDisableBit
    mine = int(getattr(bits, f"mjDSBL_{what}", 0))
    if what in ("LIMIT", "FRICTIONLOSS"):
        mine |= int(bits.mjDSBL_CONSTRAINT)
    return bool(model.opt.disableflags & mine)


def _friction(model: Any, field: Field, joint: int) -> float:
    """A friction of the file; 0 where its flags switch that off."""
    off = "FRICTIONLOSS" if field is Field.FRICTIONLOSS else "DAMPER"
    return 0.0 if _is_off(model, off) else read_value(model, field, joint)


def _is_servo(model: Any, k: int) -> bool:
    """Whether an actuator is a servo of position or velocity, whose kp and kv are its values."""
    affine = int(load_optional("mujoco", PURPOSE).mjtBias.mjBIAS_AFFINE)
    gain, (_, stiff, damp) = float(model.actuator_gainprm[k][0]), model.actuator_biasprm[k][:3].tolist()
    fixed = int(model.actuator_biastype[k]) == affine and not model.actuator_gaintype[k]
    return fixed and (stiff == -gain or (stiff == 0.0 and damp == -gain))


def _check_moves(file: Path, mechanism: Mechanism, starts: list[float], signal: str) -> None:
    """UsageError unless the joint has inertia, and the input pushes it."""
    inertia = mechanism.inertia(starts)
    if not inertia > 0.0:
        raise UsageError(f"{file}: expected a joint with an inertia above 0, found {inertia:g}")
    origin, ask = np.zeros(2), mechanism.ask(starts)
    rest, pushed = ask(origin, origin, np.array([0.0, 1.0])).tolist()
    if rest == pushed:
        raise UsageError(
            f"{file}: inputs: expected {signal} to push the joint, found that it changes nothing: a gain or "
            "gear of 0, or actuation that a flag of the file switches off"
        )


def _pushes_directly(model: Any, driven: Driven) -> bool:
    """Whether the input is the force itself."""
    if driven.actuator < 0:
        return True
    gain = float(model.actuator_gainprm[driven.actuator][0] * model.actuator_gear[driven.actuator][0])
    return gain == 1.0 and not model.actuator_biastype[driven.actuator]


def _body(model: Any, body: int) -> str:
    mujoco = load_optional("mujoco", PURPOSE)
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or f"body_{body}"


def _model_name(model: Any, file: Path) -> str:
    named = bytes(model.names).split(b"\0", 1)[0].decode("utf-8", "replace")
    return file.stem if named in ("", "MuJoCo Model") else named
