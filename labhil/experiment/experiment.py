"""The experiment file (TOML): its devices, the steps that drive them, and its recording.

Each section is a pydantic model; the docstrings of the models are the text of the reference page
(``reference.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from labhil.documents import DocumentError, read_document
from labhil.errors import ExperimentFileError, UnknownNameError, suggestion
from labhil.experiment.checks import CheckSection, no_such_device
from labhil.experiment.condition import StatedCondition
from labhil.experiment.device_sections import (
    Finite,
    Natural,
    Positive,
    Section,
    WithDevices,
    parse_devices,
)
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
from labhil.toml_text import to_toml
from labhil.unreadable import EXPERIMENT, reason_unreadable
from labhil.validation_errors import unknown_key

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Numbers = tuple[Finite, ...]

Tag = Annotated[str, Field(min_length=1, max_length=100)]
Hook = Annotated[str, Field(pattern=r"^[^:]+:[^\W\d]\w*$")]

TWIN = "twin"
"""The address of a simulated device that the run starts and stops."""


class ExperimentSection(Section):
    """``[experiment]``: the name of the experiment, and the seed of its random values.

    Each step has a random sequence of its own, seeded with this number and its place in the file.
    ``operator``, ``sample``, ``notes`` and ``tags`` are free text in the recording, by which ``labhil list``
    finds it. ``repeat`` is the number of recordings of each run. ``hook`` names a Python function,
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
        """Return the free text of the recording."""
        return {
            "operator": self.operator,
            "sample": self.sample,
            "notes": self.notes,
            "tags": self.tags,
        }


class Stabilise(Section):
    """``stabilise = { … }``: PD feedback that keeps the signal ``on`` near ``setpoint`` during the step.

    requested = excitation − ``kp``·(on − ``setpoint``) − ``kd``·d(on)/dt, the derivative through a
    first-order lag of ``filter`` s. Gains in units of the command per unit of ``on`` (and second).
    """

    on: str
    kp: Finite
    kd: Finite = 0.0
    setpoint: Finite = 0.0
    filter: NotNegative = 0.03


KEYS_OF_EXCITATIONS = frozenset(field.name for field in fields(ExcitationKeys))


class Step(Section):
    """One of ``[[steps]]``: the excitation of one signal of one device for ``duration`` s of its clock.

    ``at`` is its start, s after the start of the run; by default the end of all earlier steps.
    ``until`` ends the step early, with the first sample for which the condition holds, such as
    ``"winding_temperature < 30 and abs(speed) < 0.1"``; the following steps then begin earlier.
    ``when`` delays its start to the first sample for which a condition holds; until then the clock of the
    steps stands still, the signal has its safe value, and ``stabilise`` is active. A run whose condition
    does not hold within ``wait`` s ends as failed.
    ``fade`` is the time, s, in which the excitation grows from ``offset`` (default 0) at the start and
    returns to it at the end.
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
        """Answer an unknown key with the keys of this excitation, not with those of all excitations."""
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
            # a table is read later, when the directory of the experiment file is known
            if self.path is None:
                self.make()
        except UnknownNameError as error:
            raise ValueError(str(error)) from error
        return self

    def make(self, seed: Seed = 0, directory: Path = Path()) -> Excitation | Excitations:
        """Make the excitation, a function of the time since the step began.

        Args:
            seed: Seed of random values, unless the step has its own.
            directory: Where relative paths begin.

        Raises:
            ValueError: A table cannot be read.
        """
        excitation = make_excitation(self.excitation, self._keys(), self.duration, seed, directory)
        if self.fade is None:
            return excitation
        return apply_fade(excitation, self.duration, self.fade, self.offset or 0.0)

    def _keys(self) -> ExcitationKeys:
        return ExcitationKeys(**{field.name: getattr(self, field.name) for field in fields(ExcitationKeys)})


class RecordSection(Section):
    """``[record]``: the file name of the recording; ``{name}`` and ``{start}`` (local time) are filled in."""

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
    """A step with its time in the run: from ``start`` to ``end``, s of the device's clock.

    Attributes:
        index: Place of the step in the file, from 0.
        step: The step.
        start: When it starts, s.
        seed: Seed of random values of the excitation.
        directory: Where relative paths of the excitation begin.
    """

    index: int
    step: Step
    start: float
    seed: Seed = 0
    directory: Path = Path()

    def make(self) -> Excitation | Excitations:
        """Make the excitation; ValueError where its table cannot be read."""
        return self.step.make(self.seed, self.directory)

    @property
    def end(self) -> float:
        """When the step ends, s."""
        return self.start + self.step.duration


class Experiment(WithDevices):
    """The contents of an experiment file."""

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
        """Return the steps with their starting times, in the order of the file."""
        timed: list[TimedStep] = []
        latest_end = 0.0
        for index, step in enumerate(self.steps):
            start = latest_end if step.at is None else step.at
            timed.append(TimedStep(index, step, start, (self.experiment.seed, index), self.path.parent))
            latest_end = max(latest_end, timed[-1].end)
        return tuple(timed)

    @property
    def duration(self) -> float:
        """Duration of all steps together, s of the devices' clocks."""
        return max(timed.end for timed in self.schedule())

    def public_text(self) -> str:
        """Return the experiment as TOML for a recording: without the models of simulated devices."""
        data = self.model_dump(mode="json", exclude_none=True)
        for device in data["devices"].values():
            del device["twin"]
        return to_toml(data)


def load_experiment(path: Path) -> Experiment:
    """Read an experiment file.

    Raises:
        ExperimentFileError: The message gives the file, the field and what was expected.
    """
    try:
        text = read_document(path)
    except (OSError, DocumentError) as error:
        reason = reason_unreadable(path, error, EXPERIMENT)
        raise ExperimentFileError(f"{path}: cannot be read as an experiment file (TOML): {reason}") from error
    return parse_experiment(text, path)


def parse_experiment(text: str, path: Path) -> Experiment:
    """Read the text of an experiment file.

    Args:
        text: The text, TOML.
        path: The file, for messages and relative paths.

    Raises:
        ExperimentFileError: The message gives the file, the field and what was expected.
    """
    return parse_devices(text, path, Experiment)
