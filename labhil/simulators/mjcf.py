"""Read a MuJoCo file (MJCF, or URDF as far as MuJoCo loads it) as a simulator.

Files with one joint become a table of accelerations (:mod:`labhil.simulators.mechanism`); files with several
hinges are arms (:mod:`labhil.simulators.arm`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from labhil.errors import UsageError, suggestion
from labhil.extras import load_optional
from labhil.physics.quantity import Quantity
from labhil.simulators.arm import ArmSimulator, arm_simulator
from labhil.simulators.dc_motor_file import read_cogging
from labhil.simulators.mechanism import (
    FRICTION_FIELDS,
    PURPOSE,
    Field,
    Mechanism,
    Value,
    is_dc_motor,
    read_value,
)
from labhil.simulators.mjcf_file import MechanismFile, Names, load_model, names_of
from labhil.simulators.mjcf_unsupported import notes_on, refuse_unsupported, sensor_delay
from labhil.simulators.names import identifier
from labhil.simulators.rollouts import Actuation
from labhil.simulators.simulator import Coordinate, Simulator, declare, stated_section
from labhil.simulators.stepped import NonSmooth

VISCOUS = "viscous_friction"


def mujoco_simulator(
    path: str | Path,
    *,
    inputs: Mapping[str, str] | None = None,
    outputs: Mapping[str, str] | None = None,
    name: str = "",
) -> Simulator | ArmSimulator:
    """Read a MuJoCo file as a simulator, so that all effects of the catalogue can be fitted to it.

    A file with several hinges is an arm: its motion is the input (``actual_q``, ``actual_qd``, a column for
    each joint), and the torques or currents of its drives are the output, by inverse dynamics. Masses, mass
    centres and inertias are estimated as far as the recording determines them.

    A file with one hinge or slide joint is simulated. Its spring, armature, masses and the gains of its
    actuator are parameters where they are not 0, and start at the values of the file. Values that a recording
    cannot distinguish from others stay there. Its damping, dry friction and the cogging of a ``dcmotor`` are
    the effects viscous_friction, coulomb_friction and cogging_torque, with which a diagnosis starts.

    Args:
        path: The file: MJCF, or URDF as far as MuJoCo loads it.
        inputs: Actuator by the name of the recorded signal, or the joint where the recorded torque or force
            belongs to no actuator. The only actuator by its own name when absent. None for an arm.
        outputs: Joint or ``jointpos``/``jointvel`` sensor by the name of the recorded signal. The sensors by
            their own names when absent, the joint by its own where there are none. For an arm: the quantity
            of the one measured signal, ``"current"`` or ``"torque"``;
            ``{"actual_current": "current"}`` when absent.
        name: Name of the rig; the file's model name when absent.

    Returns:
        The simulator, to be given as a rig to :func:`labhil.fit`, :func:`labhil.diagnose` and others.

    Raises:
        UsageError: The file or a name is not as expected; the message states what the file has.
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
    return read_mechanism(Path(path), inputs, outputs, name).simulator


def read_mechanism(
    file: Path,
    inputs: Mapping[str, str] | None = None,
    outputs: Mapping[str, str] | None = None,
    name: str = "",
) -> MechanismFile:
    """Read a file with one joint and make a simulator of it; arguments as for :func:`mujoco_simulator`."""
    model = load_model(file)
    names = names_of(model)
    joint = _only_joint(model, file, names)
    refuse_unsupported(model, file)
    hinge = model.jnt_type[joint] == int(load_optional("mujoco", PURPOSE).mjtJoint.mjJNT_HINGE)
    length, force = ("rad", "N·m") if hinge else ("m", "N")
    signal, actuation = _input(model, file, names, joint, inputs)
    position, velocity, measured, sensors = _outputs(model, file, names, joint, outputs)
    sensor_delay_s = sensor_delay(model, file, sensors)
    values = tuple(_values(model, joint, actuation, hinge))
    states = {position: length, velocity: f"{length}/s"}
    rig_name = identifier(name or _model_name(model, file))
    effects = {name: _friction(model, field, joint) for field, name in FRICTION_FIELDS.items()}
    effects |= read_cogging(model, actuation.actuator)
    terms = [name.partition(".")[0] for name, strength in effects.items() if strength]
    initial_terms = tuple(dict.fromkeys((VISCOUS, *terms)))
    mechanism = Mechanism(
        model, actuation, values, _non_smooth(model, joint, actuation, file), sensor_delay_s
    )
    _check_moves(file, mechanism, [value.start for value in values], signal)
    simulator = Simulator(
        _not_compiled,
        rig_name,
        states,
        {signal: _input_unit(model, actuation, force)},
        {n: u for n, u in states.items() if n in measured},
        {value.name: Quantity(value.start, value.unit) for value in values},
        position,
        Coordinate(velocity, force=force),
        None,
        mechanism,
        {value.name: value.start for value in values}
        | {name: strength for name, strength in effects.items() if name.partition(".")[0] in initial_terms},
        notes_on(model, names, actuation.actuator, sensors),
        stated_section("mujoco", file, inputs, outputs),
    )
    declare(simulator, initial_terms)
    return MechanismFile(file, model, simulator, mechanism, actuation.actuator)


def _not_compiled(t: float, x: Any, u: Any, p: Any) -> tuple[float, float]:
    raise UsageError("a MuJoCo file has no right-hand side of its own")


def _only_joint(model: Any, file: Path, names: Names) -> int:
    mujoco = load_optional("mujoco", PURPOSE)
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    if model.nv != 1 or model.njnt != 1 or model.jnt_type[0] not in kinds:
        raise UsageError(
            f"{file}: expected one hinge or slide joint and no other degree of freedom, found "
            f"{model.nv} degrees of freedom ({names.listing()}); weld what is not measured, or take the "
            "joint's part into a file of its own"
        )
    if model.na:
        raise UsageError(
            f"{file}: expected actuators without a state of their own, found {model.na} activation(s); let a "
            "motor act and leave its lag to the effect actuator_lag; leave inductance, thermal and lugre out "
            "of a dcmotor, and its dry friction to coulomb_friction and stribeck_friction"
        )
    return 0


def _input(
    model: Any, file: Path, names: Names, joint: int, stated: Mapping[str, str] | None
) -> tuple[str, Actuation]:
    """Return the name of the recorded input, and what it drives."""
    if stated is None:
        if len(names.actuators) != 1:
            raise UsageError(
                f"{file}: expected one actuator, found {len(names.actuators)} ({names.listing()}); say which "
                'one the recorded input drives: inputs = { torque = "NAME" }, a joint\'s name for a torque '
                "or force at the joint"
            )
        stated = {names.actuators[0]: names.actuators[0]}
    if len(stated) != 1:
        raise UsageError(f"{file}: inputs: expected one signal, found {', '.join(stated) or 'none'}")
    ((signal, element),) = stated.items()
    if element in names.actuators:
        return identifier(signal), _actuation(model, file, element, names.actuators.index(element), joint)
    if element in names.joints:
        return identifier(signal), Actuation(-1, 0)
    known = (*names.actuators, *names.joints)
    raise UsageError(
        f"{file}: inputs: {signal}: no actuator or joint {element!r}{suggestion(element, known)}; "
        f"{names.listing()}"
    )


def _actuation(model: Any, file: Path, name: str, actuator: int, joint: int) -> Actuation:
    mujoco = load_optional("mujoco", PURPOSE)
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    if model.actuator_trntype[actuator] not in kinds or model.actuator_trnid[actuator][0] != joint:
        raise UsageError(f"{file}: actuator {name}: expected one that acts on the joint, found another")
    places = getattr(model, "actuator_ctrladr", np.arange(model.nu))
    return Actuation(actuator, int(places[actuator]))


def _outputs(
    model: Any, file: Path, names: Names, joint: int, stated: Mapping[str, str] | None
) -> tuple[str, str, tuple[str, ...], tuple[int, ...]]:
    """Return the names of position and velocity, the measured ones, and the numbers of their sensors."""
    velocities = int(load_optional("mujoco", PURPOSE).mjtSensor.mjSENS_JOINTVEL)
    sensors = [s for s in names.sensors if s]
    stated = (
        stated
        if stated is not None
        else {s: s for s in sensors} or {names.joints[joint]: names.joints[joint]}
    )
    signals: dict[bool, str] = {}
    for signal, element in stated.items():
        if element not in sensors and element != names.joints[joint]:
            known = (*sensors, names.joints[joint])
            raise UsageError(
                f"{file}: outputs: {signal}: no joint or sensor of position or velocity "
                f"{element!r}{suggestion(element, known)}; {names.listing()}"
            )
        is_rate = element in sensors and int(model.sensor_type[names.sensors.index(element)]) == velocities
        signals.setdefault(is_rate, identifier(signal))
    if not signals:
        raise UsageError(f"{file}: outputs: expected one signal at least, found none; {names.listing()}")
    position = signals.get(False, identifier(names.joints[joint]))
    velocity = signals.get(True, f"{position}_velocity")
    used = tuple(names.sensors.index(element) for element in stated.values() if element in sensors)
    return position, velocity, tuple(signals.values()), used


def _values(model: Any, joint: int, actuation: Actuation, hinge: bool) -> Iterable[Value]:
    """Yield the parameters of a file: values that are not 0, and the reference of a spring.

    Of values that the outputs cannot distinguish, the earlier one is estimated.
    """
    length, force = ("rad", "N·m") if hinge else ("m", "N")
    units = {
        Field.STIFFNESS: f"{force}/{length}",
        Field.SPRINGREF: length,
        Field.ARMATURE: "kg·m²" if hinge else "kg",
        Field.GEAR: "1",
        Field.KP: "1",
        Field.KV: "1",
        Field.MOTORCONST: f"{force}/A",
        Field.RESISTANCE: "Ω",
    }

    def value(field: Field, element: int, name: str = "") -> Iterable[Value]:
        start = read_value(model, field, element)
        sprung = field is Field.SPRINGREF and read_value(model, Field.STIFFNESS, element) != 0.0
        if start != 0.0 or sprung:
            yield Value(name or field.value, field, element, units.get(field, "kg"), start)

    for field in (Field.STIFFNESS, Field.SPRINGREF):
        yield from value(field, joint)
    first = int(model.jnt_bodyid[joint])
    for body in range(first, model.nbody):
        if model.body_dofnum[body] or model.body_weldid[body] == first:
            yield from value(Field.MASS, body, f"{identifier(_body_name(model, body))}_mass")
    yield from value(Field.ARMATURE, joint)
    if is_dc_motor(model, actuation.actuator):
        yield from value(Field.MOTORCONST, actuation.actuator)
        yield from value(Field.RESISTANCE, actuation.actuator)
    if actuation.actuator >= 0:
        yield from value(Field.GEAR, actuation.actuator)
        if _is_servo(model, actuation.actuator):
            yield from value(Field.KP, actuation.actuator)
            yield from value(Field.KV, actuation.actuator)


def _non_smooth(model: Any, joint: int, actuation: Actuation, file: Path) -> NonSmooth:
    """Read the stops, the limits of the input and its delay."""
    ended = model.jnt_limited[joint] and not _is_disabled(model, "LIMIT")
    stops = tuple(model.jnt_range[joint].tolist()) if ended else (-np.inf, np.inf)
    k = actuation.actuator
    if k < 0:
        return NonSmooth(stops)
    clipped = model.actuator_ctrllimited[k] and not _is_disabled(model, "CLAMPCTRL")
    low, high = model.actuator_ctrlrange[k].tolist() if clipped else (-np.inf, np.inf)
    for least, most in _force_limits(model, joint, k, file):
        low, high = max(low, least), min(high, most)
    delay = float(model.actuator_delay[k]) if hasattr(model, "actuator_delay") else 0.0
    return NonSmooth(stops, (low, high), delay)


def _force_limits(model: Any, joint: int, k: int, file: Path) -> Iterable[tuple[float, float]]:
    """Yield the limits of the actuator's and the joint's force, as limits of the input."""
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


def _is_disabled(model: Any, what: str) -> bool:
    """Whether a flag of the file disables something."""
    bits = load_optional("mujoco", PURPOSE).mjtDisableBit
    bits_off = int(getattr(bits, f"mjDSBL_{what}", 0))
    if what in ("LIMIT", "FRICTIONLOSS"):
        bits_off |= int(bits.mjDSBL_CONSTRAINT)
    return bool(model.opt.disableflags & bits_off)


def _friction(model: Any, field: Field, joint: int) -> float:
    """Read a friction of the file; 0 where a flag disables it."""
    off = "FRICTIONLOSS" if field is Field.FRICTIONLOSS else "DAMPER"
    return 0.0 if _is_disabled(model, off) else read_value(model, field, joint)


def _is_servo(model: Any, k: int) -> bool:
    """Whether an actuator is a position or velocity servo, whose kp and kv are parameters."""
    affine = int(load_optional("mujoco", PURPOSE).mjtBias.mjBIAS_AFFINE)
    gain, (_, stiff, damp) = float(model.actuator_gainprm[k][0]), model.actuator_biasprm[k][:3].tolist()
    fixed = int(model.actuator_biastype[k]) == affine and not model.actuator_gaintype[k]
    return fixed and (stiff == -gain or (stiff == 0.0 and damp == -gain))


def _check_moves(file: Path, mechanism: Mechanism, starts: list[float], signal: str) -> None:
    """Raise UsageError unless the joint has inertia and the input acts on it."""
    inertia = mechanism.inertia(starts)
    if not inertia > 0.0:
        raise UsageError(f"{file}: expected a joint with an inertia above 0, found {inertia:g}")
    origin, acceleration = np.zeros(2), mechanism.acceleration_at(starts)
    rest, pushed = acceleration(origin, origin, np.array([0.0, 1.0])).tolist()
    if rest == pushed:
        raise UsageError(
            f"{file}: inputs: expected {signal} to push the joint, found that it changes nothing: a gain or "
            "gear of 0, or actuation that a flag of the file switches off"
        )


def _input_unit(model: Any, actuation: Actuation, force: str) -> str:
    """Unit of the input: of the force itself, volts at a DC motor, else none that the file states."""
    if is_dc_motor(model, actuation.actuator):
        return "V"
    return force if _pushes_directly(model, actuation) else "1"


def _pushes_directly(model: Any, actuation: Actuation) -> bool:
    """Whether the input is the force itself."""
    if actuation.actuator < 0:
        return True
    gain = float(model.actuator_gainprm[actuation.actuator][0] * model.actuator_gear[actuation.actuator][0])
    return gain == 1.0 and not model.actuator_biastype[actuation.actuator]


def _body_name(model: Any, body: int) -> str:
    mujoco = load_optional("mujoco", PURPOSE)
    return mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or f"body_{body}"


def _model_name(model: Any, file: Path) -> str:
    named = bytes(model.names).split(b"\0", 1)[0].decode("utf-8", "replace")
    return file.stem if named in ("", "MuJoCo Model") else named
