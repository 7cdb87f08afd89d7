"""Rig kinds: what signals each has, which of them an analysis needs, and what a rig file may know of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from math import isfinite

from labhil.errors import UnknownNameError, UsageError
from labhil.signals import Direction, Hold, Signal

JOINTS = 6
INPUT, OUTPUT, STATUS = Direction.INPUT, Direction.OUTPUT, Direction.STATUS


@dataclass(frozen=True, slots=True)
class Known:
    """What ``[known]`` may say of one name: a number, ``width`` numbers, or the path of a table.

    A number must be above 0; ``zero`` allows 0 too, where a rig may lack what the number measures (a spring)
    and the model is defined without it; ``positive=False`` allows every finite number (a position).
    """

    unit: str
    width: int = 1
    positive: bool = True
    table: bool = False
    zero: bool = False

    def admits(self, number: float) -> bool:
        """Whether the quantity may have this value."""
        return isfinite(number) and (not self.positive or number > 0.0 or (self.zero and number == 0.0))

    def expected(self) -> str:
        """What a rig file must give, for messages."""
        if self.table:
            return "the path of a table"
        if not self.positive:
            return "a finite number" if self.width == 1 else f"{self.width} finite numbers"
        if self.zero:
            return "0 or a positive number" if self.width == 1 else f"{self.width} numbers of 0 or more"
        return "a positive number" if self.width == 1 else f"{self.width} positive numbers"


@dataclass(frozen=True, slots=True)
class RigKind:
    """What every rig of one kind has.

    ``driven_by`` lists the sets of inputs of which one is needed, the preferred first; of ``outputs``
    all are needed, or one at least with ``any_output``. ``optional`` inputs and ``auxiliary`` signals
    are used when they are there.
    """

    name: str
    inputs: tuple[Signal, ...]
    driven_by: tuple[tuple[str, ...], ...]
    outputs: tuple[Signal, ...]
    known: Mapping[str, Known]
    auxiliary: tuple[Signal, ...] = ()
    optional: tuple[Signal, ...] = ()
    any_output: bool = field(default=False)

    def signals(self) -> tuple[Signal, ...]:
        """All signals that a recording of this rig may hold."""
        return self.inputs + self.optional + self.outputs + self.auxiliary


BALL_BEAM = RigKind(
    name="ball_beam",
    inputs=(
        Signal("servo_angle", "rad", INPUT, description="gear-disc angle in effect at the servo"),
        Signal("beam_angle", "rad", INPUT, description="angle of the beam, measured directly"),
    ),
    driven_by=(("servo_angle",), ("beam_angle",)),
    outputs=(Signal("ball_position", "m", OUTPUT, description="from the pivot along the beam"),),
    known={
        "ball_mass": Known("kg"),
        "ball_radius": Known("m"),
        "crank_radius": Known("m"),
        "beam_length": Known("m"),
    },
)

DC_MOTOR = RigKind(
    name="dc_motor",
    inputs=(Signal("voltage", "V", INPUT, hold=Hold.ZERO, description="at the motor's terminals"),),
    driven_by=(("voltage",),),
    outputs=(
        Signal("speed", "rad/s", OUTPUT, description="of the shaft"),
        Signal("current", "A", OUTPUT, description="through the winding"),
    ),
    any_output=True,
    auxiliary=(
        Signal("angle", "rad", STATUS, description="of the shaft"),
        Signal("winding_temperature", "°C", STATUS, description="of the winding"),
    ),
    known={
        "inertia": Known("kg·m²"),
        "torque_constant": Known("N·m/A"),
        "inductance": Known("H", zero=True),
        "resistance": Known("Ω"),
    },
)

SOLENOID = RigKind(
    name="solenoid",
    inputs=(Signal("coil_current", "A", INPUT, description="through the coil, measured"),),
    driven_by=(("coil_current",),),
    outputs=(Signal("plunger_position", "m", OUTPUT, description="from the rest stop"),),
    auxiliary=(
        Signal("coil_current_command", "A", STATUS, hold=Hold.ZERO, description="asked of the current loop"),
        Signal("coil_voltage", "V", STATUS, description="at the coil's terminals"),
        Signal("magnetic_force", "N", STATUS, description="of a load cell"),
    ),
    known={
        "moving_mass": Known("kg"),
        "spring_stiffness": Known("N/m", zero=True),
        "stop_low": Known("m", positive=False),
        "stop_high": Known("m", positive=False),
        "force_map": Known("", table=True),
    },
)

AXIS = RigKind(
    name="axis",
    inputs=(
        Signal("drive_force", "N", INPUT, hold=Hold.ZERO, description="of the drive (N·m when it turns)"),
        Signal("drive_voltage", "V", INPUT, hold=Hold.ZERO, description="asked of the drive"),
    ),
    driven_by=(("drive_force",), ("drive_voltage",)),
    outputs=(Signal("position", "m", OUTPUT, description="of the carriage (rad when it turns)"),),
    auxiliary=(
        Signal("velocity", "m/s", STATUS, description="of the carriage"),
        Signal("drive_current", "A", STATUS, description="of the drive"),
        Signal("temperature", "°C", STATUS, description="of what rubs"),
    ),
    known={"drive_gain": Known("N/V"), "moving_mass": Known("kg")},
)


def _joints(name: str, unit: str, direction: Direction, description: str) -> Signal:
    return Signal(name, unit, direction, width=JOINTS, description=description)


UR5 = RigKind(
    name="ur5",
    inputs=(
        _joints("actual_q", "rad", INPUT, "joint angles"),
        _joints("actual_qd", "rad/s", INPUT, "joint velocities"),
    ),
    driven_by=(("actual_q", "actual_qd"),),
    optional=(_joints("target_qdd", "rad/s²", INPUT, "joint accelerations that the controller plans"),),
    outputs=(_joints("actual_current", "A", OUTPUT, "motor currents"),),
    auxiliary=(
        _joints("joint_temperatures", "°C", STATUS, "of the joints"),
        _joints("target_q", "rad", STATUS, "joint angles that the controller plans"),
        _joints("target_qd", "rad/s", STATUS, "joint velocities that the controller plans"),
        _joints("target_current", "A", STATUS, "currents that the controller expects"),
        _joints("target_moment", "N·m", STATUS, "torques that the controller expects"),
        Signal("actual_main_voltage", "V", STATUS, description="of the supply"),
    ),
    known={
        "torque_constant": Known("N·m/A", width=JOINTS),
        "gear_ratio": Known("1", width=JOINTS),
        "links": Known("", table=True),
    },
)

KINDS: Mapping[str, RigKind] = {kind.name: kind for kind in (BALL_BEAM, DC_MOTOR, SOLENOID, AXIS, UR5)}


PLUGGED = "labhil.rigs"
"""Entry points under which other packages register a :class:`RigKind` by its name."""


_DECLARED: dict[str, RigKind] = {}
"""Kinds of this process only, by name: those of simulators that a user's own file describes."""


def declare_kind(kind: RigKind) -> None:
    """Make the kind of a user's own simulator known in this process; a later one of the name replaces it.

    Raises UsageError where the name belongs to a rig of ours or of an installed package.
    """
    if kind.name in kind_names() and kind.name not in _DECLARED:
        raise UsageError(f"simulator {kind.name!r}: expected a name of its own, found that of a rig kind")
    _DECLARED[kind.name] = kind


def declared_kinds() -> tuple[RigKind, ...]:
    """The kinds of users' own simulators that are known in this process."""
    return tuple(_DECLARED.values())


def kind_names() -> tuple[str, ...]:
    """Names of all rig kinds, ours first; nothing is imported."""
    plugged = {point.name for point in entry_points(group=PLUGGED)} - set(KINDS)
    return (*KINDS, *sorted(plugged), *sorted(_DECLARED))


def kind_named(name: str) -> RigKind:
    """Return the rig kind ``name``; UnknownNameError lists those that exist.

    UsageError when another package's kind cannot be imported or is none.
    """
    if name in KINDS:
        return KINDS[name]
    if name in _DECLARED:
        return _DECLARED[name]
    for point in entry_points(group=PLUGGED):
        if point.name == name:
            return _load_plugged(point)
    raise UnknownNameError("rig kind", name, kind_names())


def _load_plugged(point: EntryPoint) -> RigKind:
    try:
        kind = point.load()
    except (ImportError, AttributeError) as error:
        raise UsageError(f"rig kind {point.name!r} ({point.value}) cannot be imported: {error}") from error
    if not isinstance(kind, RigKind):
        raise UsageError(f"rig kind {point.name!r} ({point.value}): expected a RigKind, found {kind!r}")
    return kind
