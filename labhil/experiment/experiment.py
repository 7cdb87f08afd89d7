"""The experiment file (TOML): which devices, what moves them, and where the recording goes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from labhil.complaints import explain, unknown_key
from labhil.documents import DocumentError, parse_toml, read_document
from labhil.errors import ExperimentFileError, UnknownNameError, suggestion
from labhil.experiment.checks import CheckSection, no_such_device
from labhil.experiment.condition import StatedCondition
from labhil.experiment.excitation.fade import apply_fade
from labhil.experiment.excitation.function import Excitation, Excitations, Seed
from labhil.experiment.excitation.make import (
    EXCITATIONS,
    ExcitationKeys,
    check_keys,
    make_excitation,
)
from labhil.experiment.excitation.table import Between
from labhil.experiment.excitation.tones import PhaseRule, Sweep
from labhil.experiment.overlap import refuse_conditions_beside_others, refuse_overlaps
from labhil.experiment.sweep import MAX_RUNS, SweepSection
from labhil.rig import RigFile, default_rig, is_simulator, load_rig
from labhil.toml_text import to_toml

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Numbers = tuple[Finite, ...]
Natural = Annotated[int, Field(ge=0)]
Tag = Annotated[str, Field(min_length=1, max_length=100)]
Hook = Annotated[str, Field(pattern=r"^[^:]+:[^\W\d]\w*$")]

TWIN = "twin"
"""The address that stands for "start the simulated device, and stop it afterwards"."""
DEVICE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*\Z")
RESERVED_NAMES = ("run", "recorder")
"""Device names that the recording uses for itself."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ExperimentSection(_Section):
    """``[experiment]``: what this acquisition is called, and the seed of whatever is drawn at random.

    Each step draws from a sequence of its own, begun with this seed and its place in the file. ``operator``,
    ``sample``, ``notes`` and ``tags`` are free text; they stand in the recording, and ``labhil list`` finds
    recordings by them. ``repeat`` makes so many recordings of each run. ``hook`` names a Python function,
    "lab.py:tell" or "lab.hooks:tell", that is called before and after each run.
    """

    name: Annotated[str, Field(min_length=1)]
    seed: Natural = 0
    operator: str = ""
    sample: str = ""
    notes: str = ""
    tags: tuple[Tag, ...] = ()
    repeat: Annotated[int, Field(ge=1, le=MAX_RUNS)] = 1
    hook: Hook | None = None

    def metadata(self) -> dict[str, str | tuple[str, ...]]:
        """Return the free text of whoever made the recording."""
        return {
            "operator": self.operator,
            "sample": self.sample,
            "notes": self.notes,
            "tags": self.tags,
        }


class TwinSection(_Section):
    """``twin = { … }``: what the simulated device is made of. Never stands in a recording.

    ``terms`` None means the twin's own default; ``set`` overrides single values (SI); ``speed`` is how
    many seconds of its world pass in one second; ``tables`` are files with measured maps. ``host`` is the
    address of this machine for a networked twin, ``series`` the make of its controller.
    """

    speed: Positive = 1.0
    seed: Natural = 0
    terms: tuple[str, ...] | None = None
    set: dict[str, Finite] = {}
    tables: dict[str, str] = {}
    wire: Literal["pty", "tcp"] = "pty"
    host: str | None = None
    series: str | None = None

    @field_validator("set", mode="before")
    @classmethod
    def _flatten_set(cls, value: object) -> object:
        return dict(_flatten(value)) if isinstance(value, Mapping) else value


class DeviceSection(_Section):
    """``[devices.NAME]``: a driver plugin, where its device is, and the rig file that goes with it.

    ``reconnect`` lets a run wait for a device that was lost or booted again, and go on when it is back.
    """

    plugin: str
    address: Annotated[str, Field(min_length=1)]
    rig: str | None = None
    reconnect: bool = False
    twin: TwinSection = TwinSection()


class Stabilise(_Section):
    """``stabilise = { … }``: a PD that keeps the signal ``on`` near ``setpoint`` while the step runs.

    requested = excitation − ``kp``·(on − ``setpoint``) − ``kd``·d(on)/dt, the derivative through a
    first-order lag of ``filter`` s. Gains in units of the command per unit of ``on`` (and second).
    """

    on: str
    kp: Finite
    kd: Finite = 0.0
    setpoint: Finite = 0.0
    filter: NotNegative = 0.03


KEYS_OF_EXCITATIONS = frozenset(field.name for field in fields(ExcitationKeys))


class Step(_Section):
    """One of ``[[steps]]``: what one signal of one device does for ``duration`` s of the device's clock.

    ``at`` is when it starts, s after the run did; without it, when everything before it has ended.
    ``until`` ends it before that, with the first sample for which the condition holds, such as
    ``"winding_temperature < 30 and abs(speed) < 0.1"``; what follows then begins earlier.
    ``when`` lets it begin with the first sample for which a condition holds; until then the clock of the
    steps stands still, the signal has its safe value, and ``stabilise`` is at work. A run whose condition
    does not hold within ``wait`` s ends as failed.
    ``fade`` lets it grow from ``offset`` (0 without) and die away there again, in so many s at either end.
    """

    device: str
    signal: str
    excitation: str
    duration: Positive
    at: NotNegative | None = None
    when: StatedCondition | None = None
    wait: Positive | None = None
    until: StatedCondition | None = None
    stabilise: Stabilise | None = None
    frequencies: Numbers | None = None
    amplitude: Finite | Numbers | None = None
    phases: Numbers | PhaseRule | None = None
    offset: Finite | None = None
    level: Finite | None = None
    levels: Numbers | None = None
    dwell: Positive | None = None
    low: Finite | Numbers | None = None
    high: Finite | Numbers | None = None
    count: int | None = None
    stages: int | None = None
    sweep: Sweep | None = None
    there_and_back: bool | None = None
    base_frequency: Positive | None = None
    harmonics: int | None = None
    centre: Finite | Numbers | None = None
    speed: Finite | Numbers | None = None
    acceleration: Finite | Numbers | None = None
    sine: tuple[Numbers, ...] | None = None
    cosine: tuple[Numbers, ...] | None = None
    path: str | None = None
    between: Between | None = None
    fade: Positive | None = None
    seed: Natural | None = None

    @model_validator(mode="before")
    @classmethod
    def _refuse_unknown_keys(cls, data: object) -> object:
        """Answer a wrong key with those that this excitation takes, not with those of all of them."""
        name = data.get("excitation") if isinstance(data, Mapping) else None
        if not isinstance(data, Mapping) or not isinstance(name, str) or name not in EXCITATIONS:
            return data
        own_keys = EXCITATIONS[name].known_keys()
        common_keys = [key for key in cls.model_fields if key not in KEYS_OF_EXCITATIONS]
        for key in data:
            if key not in cls.model_fields:
                near = suggestion(str(key), [*own_keys, *common_keys])
                raise unknown_key(
                    str(key),
                    f"unknown key{near}; excitation {name!r} takes: {', '.join(own_keys)}; "
                    f"every step takes: {', '.join(common_keys)}",
                )
        return data

    @model_validator(mode="after")
    def _check_excitation(self) -> Step:
        if (self.when is None) != (self.wait is None):
            raise ValueError("expected `when` and `wait` (s, at most) together, found one of them")
        try:
            check_keys(self.excitation, self._keys())
            # a table is read when it is known where the experiment file lies
            if self.path is None:
                self.make()
        except UnknownNameError as error:
            raise ValueError(str(error)) from error
        return self

    def make(self, seed: Seed = 0, directory: Path = Path()) -> Excitation | Excitations:
        """Return the excitation, a function of the step's own time.

        ``seed`` begins what is drawn unless the step has its own; ``directory`` is where relative paths
        begin. Raises ValueError where a table cannot be read.
        """
        made = make_excitation(self.excitation, self._keys(), self.duration, seed, directory)
        return made if self.fade is None else apply_fade(made, self.duration, self.fade, self.offset or 0.0)

    def _keys(self) -> ExcitationKeys:
        return ExcitationKeys(**{field.name: getattr(self, field.name) for field in fields(ExcitationKeys)})


class RecordSection(_Section):
    """``[record]``: the recording's file name; ``{name}`` and ``{start}`` (local time) are filled in."""

    path: str = "{name}-{start}.mcap"

    @field_validator("path")
    @classmethod
    def _check_path(cls, value: str) -> str:
        try:
            value.format(name="name", start="start")
        except (KeyError, IndexError, ValueError) as error:
            raise ValueError(f"only {{name}} and {{start}} are filled in, found {value!r}") from error
        if not value.endswith(".mcap"):
            raise ValueError(f"a recording's name ends in .mcap, found {value!r}")
        return value


@dataclass(frozen=True, slots=True)
class TimedStep:
    """A step with its place in the run: from ``start`` to ``end``, s of the device's clock.

    ``seed`` and ``directory`` are what the experiment gives it to make its excitation.
    """

    index: int
    step: Step
    start: float
    seed: Seed = 0
    directory: Path = Path()

    def make(self) -> Excitation | Excitations:
        """Return the excitation; ValueError where its table cannot be read."""
        return self.step.make(self.seed, self.directory)

    @property
    def end(self) -> float:
        """When the step is over."""
        return self.start + self.step.duration


class WithDevices(_Section):
    """A file that names devices; relative paths in it are relative to the directory of ``path``."""

    devices: dict[str, DeviceSection]
    path: Path = Field(default=Path("experiment.toml"), exclude=True)

    @field_validator("devices")
    @classmethod
    def _check_device_names(cls, value: dict[str, DeviceSection]) -> dict[str, DeviceSection]:
        for name in value:
            if not DEVICE_NAME.match(name) or name in RESERVED_NAMES:
                raise ValueError(
                    f"device name {name!r}: letters, digits, - and _, starting with a letter, "
                    f"and none of {', '.join(RESERVED_NAMES)}"
                )
        return value

    def rig_of(self, device: str, kind: str) -> RigFile:
        """Return the rig file of ``device``, or one that says no more than its ``kind``.

        Raises RigFileError, and ExperimentFileError where the file is of another kind.
        """
        name = self.devices[device].rig
        if name is None:
            return default_rig(kind)
        file = self.path.parent / name
        if not is_simulator(str(file)) and not file.is_file():
            actual = "something else" if file.exists() else "none"
            raise ExperimentFileError(
                f"{self.path}: devices.{device}.rig: expected the rig file {file}, found {actual}"
            )
        rig = load_rig(file)
        if rig.kind.name != kind:
            raise ExperimentFileError(
                f"{self.path}: devices.{device}.rig: {name} is of kind {rig.kind.name!r}, "
                f"but plugin {self.devices[device].plugin!r} drives {kind!r}"
            )
        return rig


Form = TypeVar("Form", bound=WithDevices)


class Experiment(WithDevices):
    """A whole experiment file."""

    experiment: ExperimentSection
    steps: tuple[Step, ...]
    checks: tuple[CheckSection, ...] | None = None
    record: RecordSection = RecordSection()
    sweep: SweepSection | None = None

    @model_validator(mode="after")
    def _check_steps(self) -> Experiment:
        if not self.steps:
            raise ValueError("steps: there are none; give at least one [[steps]]")
        for index, step in enumerate(self.steps):
            if step.device not in self.devices:
                raise ValueError(f"steps.{index}.device: {no_such_device(step.device, self.devices)}")
        refuse_overlaps(self.schedule())
        refuse_conditions_beside_others(self.schedule(), len(self.devices))
        for number, check in enumerate(self.checks or ()):
            check.refuse_unknown_device(f"checks.{number}", self.devices)
        return self

    def schedule(self) -> tuple[TimedStep, ...]:
        """Return the steps with their starts, in the order of the file."""
        timed: list[TimedStep] = []
        latest_end = 0.0
        for index, step in enumerate(self.steps):
            start = latest_end if step.at is None else step.at
            timed.append(TimedStep(index, step, start, (self.experiment.seed, index), self.path.parent))
            latest_end = max(latest_end, timed[-1].end)
        return tuple(timed)

    @property
    def duration(self) -> float:
        """How long the steps take altogether, s of the devices' clocks."""
        return max(timed.end for timed in self.schedule())

    def public_text(self) -> str:
        """Return the experiment as TOML without what a twin is made of: this is what a recording holds."""
        data = self.model_dump(mode="json", exclude_none=True)
        for device in data["devices"].values():
            del device["twin"]
        return to_toml(data)


def load_experiment(path: Path) -> Experiment:
    """Read an experiment file; ExperimentFileError names the file, the field and what was expected."""
    try:
        text = read_document(path)
    except (OSError, DocumentError) as error:
        raise ExperimentFileError(f"{path}: cannot be read as an experiment file (TOML): {error}") from error
    return parse_experiment(text, path)


def parse_experiment(text: str, path: Path) -> Experiment:
    """Read the text of an experiment file; ``path`` serves messages and relative paths."""
    return parse_devices(text, path, Experiment)


def parse_devices(text: str, path: Path, form: type[Form]) -> Form:
    """Read the text of a file that names devices; ExperimentFileError names the field."""
    try:
        data = parse_toml(text)
    except DocumentError as error:
        raise ExperimentFileError(f"{path}: not TOML: {error}") from error
    if "path" in data:
        raise ExperimentFileError(f"{path}: path: unknown key; did you mean record.path?")
    try:
        return form.model_validate({**data, "path": path})
    except ValidationError as error:
        raise ExperimentFileError(explain(error, path, form)) from error


def _flatten(value: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, inner in value.items():
        if isinstance(inner, Mapping):
            yield from _flatten(inner, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", inner
