"""Settings of the twin: its plant, its home position, and faults."""

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
UNUSED_PARAMETERS = ("stamp_jitter",)
"""Parameters of the plant without effect here, since the controller has its own clock."""


@dataclass(frozen=True, slots=True)
class FaultSettings:
    """Times of faults after the start of the first client's stream, s; 0 is never."""

    drop_at: float = 0.0
    """All connections of the RTDE port are closed; the port stays open."""
    stall_at: float = 0.0
    """The controller does nothing for ``stall_for`` s."""
    stall_for: float = 1.0
    truncate_at: float = 0.0
    """A data package is truncated, then the connection is closed."""
    protective_stop_at: float = 0.0
    emergency_stop_at: float = 0.0
    end_program_at: float = 0.0
    """The program ends, as if somebody had pressed stop on the panel."""


@dataclass(frozen=True, slots=True)
class RobotSettings:
    """Serial number and safety settings of the robot."""

    serial_number: float = 20181234567.0
    unlock_after: float = 5.0
    """Time after which a protective stop can be unlocked, s."""


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
        """Check options and return the settings.

        Raises:
            UsageError: An option is wrong (also as UnknownNameError).
        """
        series = options.series or DEFAULT_SERIES
        if series not in SERIES:
            raise UnknownNameError("series", series, SERIES)
        if options.speed != 1.0:
            raise UsageError(f"the twin of a ur5 runs in real time only, found speed {options.speed:g}")
        parameters = dict(options.parameters)
        faults = FaultSettings(**_pop_settings(parameters, _FAULTS, "fault."))
        robot = RobotSettings(**_pop_settings(parameters, _ROBOT, ""))
        home = tuple(_pop_settings(parameters, _HOME, "").values())
        if not all(abs(angle) <= JOINT_LIMIT for angle in home):
            raise UsageError(f"home must lie within ±{JOINT_LIMIT:.3f} rad, found {home}")
        known = twin_parameters()
        for name in parameters:
            if name not in known and name.partition("[")[0] not in {key.partition("[")[0] for key in known}:
                raise UnknownNameError("parameter", name, known)
        terms = DEFAULT_TERMS if options.terms is None else options.terms
        resolve(terms, parameters)
        return cls(
            options.host or DEFAULT_HOST, SERIES[series], options.seed, terms, parameters, home, robot, faults
        )

    def write_answer(self, path: Path, parameters: Mapping[str, float]) -> None:
        """Write terms, parameters and seed of the twin as JSON.

        Raises:
            UsageError: The file cannot be written.
        """
        answer = {"terms": list(self.terms), "parameters": dict(parameters), "seed": self.seed}
        try:
            path.write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise UsageError(f"{path}: the twin's answer cannot be written: {error}") from error


def twin_parameters() -> dict[str, float]:
    """Return every name that ``--set`` takes with its default (SI): ``name[2]`` is joint 2's.

    ``name`` alone then stands for all six joints.
    """
    plant = {name: value for name, value in BARE_ARM.items() if name not in UNUSED_PARAMETERS}
    for effect in EFFECTS:
        plant |= parameters_of(effect)
    flat: dict[str, float] = {}
    for name, value in plant.items():
        if isinstance(value, tuple):
            flat |= {f"{name}[{joint}]": number for joint, number in enumerate(value)}
        else:
            flat[name] = value
    return flat | dict(_HOME) | dict(_ROBOT) | dict(_FAULTS)


def _pop_settings(
    parameters: dict[str, float], defaults: Mapping[str, float], prefix: str
) -> dict[str, float]:
    """Remove settings from ``parameters`` and return them; UsageError for a wrong value."""
    settings = {}
    for name, default in defaults.items():
        value = float(parameters.pop(name, default))
        if not (value >= 0.0 or name.startswith("home")) or value == float("inf"):
            raise UsageError(f"{name} must be finite and not negative, found {value:g}")
        settings[name.removeprefix(prefix)] = value
    return settings
