"""What can be set about the twin: its plant, where it stands at the start, and faults to order."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from labhil.driver import TwinOptions
from labhil.errors import UnknownNameError, UsageError
from labhil.plants.arm.effects import BARE_ARM, EFFECTS, parameters_of, resolve
from labhil_sim_ur5.kinematics import JOINT_LIMIT
from labhil_sim_ur5.variables import SERIES, Version

DEFAULT_TERMS = ("viscous_friction", "coulomb_friction", "stribeck_friction")
DEFAULT_HOST = "127.0.0.1"
DEFAULT_SERIES = "e"
HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
NOT_OURS = ("stamp_jitter",)
"""Parameters of the plant that mean nothing to a controller with a clock of its own."""


@dataclass(frozen=True, slots=True)
class FaultSettings:
    """Faults that happen once, s after the first client's stream began; 0 is never."""

    drop_at: float = 0.0
    """All connections of the RTDE port are closed; the port stays open."""
    stall_at: float = 0.0
    """The controller does nothing at all for ``stall_for`` s."""
    stall_for: float = 1.0
    truncate_at: float = 0.0
    """A data package that ends in its middle, then the end of the connection."""
    protective_stop_at: float = 0.0
    emergency_stop_at: float = 0.0
    end_program_at: float = 0.0
    """The program ends, as if somebody had pressed stop on the panel."""


@dataclass(frozen=True, slots=True)
class RobotSettings:
    """The robot's papers and what its operators have chosen."""

    serial_number: float = 20181234567.0
    unlock_after: float = 5.0
    """How long (s) a protective stop must have held before it can be unlocked."""


_FAULTS: Mapping[str, float] = {f"fault.{name}": value for name, value in asdict(FaultSettings()).items()}
_ROBOT: Mapping[str, float] = asdict(RobotSettings())
_HOME: Mapping[str, float] = {f"home[{joint}]": angle for joint, angle in enumerate(HOME)}


@dataclass(frozen=True, slots=True)
class TwinSettings:
    """A checked :class:`TwinOptions`."""

    host: str
    version: Version
    seed: int
    terms: tuple[str, ...]
    plant: Mapping[str, float]
    home: tuple[float, ...]
    robot: RobotSettings
    faults: FaultSettings

    @classmethod
    def of(cls, options: TwinOptions) -> TwinSettings:
        """Check the options; UsageError or UnknownNameError names what is wrong."""
        series = options.series or DEFAULT_SERIES
        if series not in SERIES:
            raise UnknownNameError("series", series, SERIES)
        if options.speed != 1.0:
            raise UsageError(f"the twin of a ur5 runs in real time only, found speed {options.speed:g}")
        given = dict(options.parameters)
        faults = FaultSettings(**_take_settings(given, _FAULTS, "fault."))
        robot = RobotSettings(**_take_settings(given, _ROBOT, ""))
        home = tuple(_take_settings(given, _HOME, "").values())
        if not all(abs(angle) <= JOINT_LIMIT for angle in home):
            raise UsageError(f"home must lie within ±{JOINT_LIMIT:.3f} rad, found {home}")
        known = twin_parameters()
        for name in given:
            if name not in known and name.partition("[")[0] not in {key.partition("[")[0] for key in known}:
                raise UnknownNameError("parameter", name, known)
        terms = DEFAULT_TERMS if options.terms is None else options.terms
        resolve(terms, given)
        return cls(
            options.host or DEFAULT_HOST, SERIES[series], options.seed, terms, given, home, robot, faults
        )

    def write_answer(self, path: Path, parameters: Mapping[str, float]) -> None:
        """Write what the twin is made of as JSON; UsageError when the file cannot be written."""
        answer = {"terms": list(self.terms), "parameters": dict(parameters), "seed": self.seed}
        try:
            path.write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise UsageError(f"{path}: the twin's answer cannot be written: {error}") from error


def twin_parameters() -> dict[str, float]:
    """Return every name that ``--set`` takes with its default (SI): ``name[2]`` is joint 2's.

    ``name`` alone then stands for all six joints.
    """
    plant = {name: value for name, value in BARE_ARM.items() if name not in NOT_OURS}
    for effect in EFFECTS:
        plant |= parameters_of(effect)
    flat: dict[str, float] = {}
    for name, value in plant.items():
        if isinstance(value, tuple):
            flat |= {f"{name}[{joint}]": number for joint, number in enumerate(value)}
        else:
            flat[name] = value
    return flat | dict(_HOME) | dict(_ROBOT) | dict(_FAULTS)


def _take_settings(given: dict[str, float], defaults: Mapping[str, float], prefix: str) -> dict[str, float]:
    """Take the settings with these names out of ``given``; UsageError for one that cannot be."""
    settings = {}
    for name, default in defaults.items():
        value = float(given.pop(name, default))
        if not (value >= 0.0 or name.startswith("home")) or value == float("inf"):
            raise UsageError(f"{name} must be finite and not negative, found {value:g}")
        settings[name.removeprefix(prefix)] = value
    return settings
