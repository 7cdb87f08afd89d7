"""Parts of results in JSON: recordings, parameters, errors, faults, curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Self, SupportsIndex, overload

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from labhil.errors import UnknownNameError
from labhil.physics.terms import keyed

Number = float | None

LONGEST_TEXT = 4096
"""Longest text in a result, in characters: that of a path."""

MOST_PARAMETERS = 5000
"""Largest number of parameters in a result: more than those of an arm in a hundred recordings."""
Interval = tuple[Number, Number]


class Part(BaseModel):
    """A part of a result; its numbers are finite."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, str_max_length=LONGEST_TEXT)


class Source(Part):
    """A recording that a result comes from."""

    path: str
    sha256: str = ""
    rig: str = ""
    samples: int
    duration: Number = None
    role: str = ""
    start: Number = 0.0
    recording: int | None = None
    rig_file: str | None = None


class Parameter(Part):
    """A parameter of a fitted model.

    Attributes:
        name: Its name: ``term.parameter``, or one of the rig's own, such as ``inertia``.
        term: The term that it belongs to; None for the rig's own.
        joint: The joint of an arm, from 0; None where there are none.
        value: The estimate, in ``unit``.
        unit: Its SI unit.
        std_error: Standard error that allows for correlated residuals; None where the value was held or the
            data do not determine it.
        std_error_reference: By the formula of the reference text, for comparison only: far too small.
        ci99: Both ends of the 99 % interval.
        z: ``value`` over ``std_error``.
        p_value: Of the test that the true value is zero.
        significant: Whether it differs from zero at 1 %.
        identifiable: Whether the data determine it.
        at_bound: Whether the estimate is at a bound.
        held: Whether it was held at its value, not estimated.
        recording: The recording that it belongs to, from 1, where each has its own value.

    Example:
        >>> import labhil as lh
        >>> level = lh.load("examples/fit.json").parameters["coulomb_friction.level"]
        >>> print(level)
        coulomb_friction.level = 0.089918 ± 0.00025 N
        >>> level.significant, [round(end, 4) for end in level.ci99]
        (True, [0.0893, 0.0906])
    """

    name: str
    term: str | None = None
    joint: int | None = None
    value: Number
    unit: str = ""
    std_error: Number = None
    std_error_reference: Number = None
    ci99: Interval | None = None
    z: Number = None
    p_value: Number = None
    significant: bool | None = None
    identifiable: bool = True
    at_bound: bool = False
    held: bool = False
    recording: int | None = None

    @property
    def key(self) -> str:
        """Its name with joint and recording, where it has them."""
        return keyed(self.name, self.joint, self.recording)

    def __str__(self) -> str:
        value = "–" if self.value is None else f"{self.value:.5g}"
        error = "" if self.std_error is None else f" ± {self.std_error:.2g}"
        return f"{self.key} = {value}{error} {self.unit}".rstrip()

    def __repr__(self) -> str:
        return f"<Parameter {self}>"


class Parameters(tuple[Parameter, ...]):
    """Parameters in the order of the report: indexed by position like a tuple, by name like a mapping."""

    __slots__ = ()

    @overload
    def __getitem__(self, key: SupportsIndex) -> Parameter: ...

    @overload
    def __getitem__(self, key: slice) -> tuple[Parameter, ...]: ...

    @overload
    def __getitem__(self, key: str) -> Parameter: ...

    def __getitem__(self, key: SupportsIndex | slice | str) -> Parameter | tuple[Parameter, ...]:
        if not isinstance(key, str):
            return super().__getitem__(key)
        for row in self:
            if row.key == key:
                return row
        raise UnknownNameError("parameter", key, self.keys())

    def keys(self) -> list[str]:
        """Return the names, with joint and recording where they have them: ``coulomb_friction.level[2]``."""
        return [row.key for row in self]

    def __repr__(self) -> str:
        return "\n".join(str(row) for row in self) or "no parameters"

    @classmethod
    def of(cls, rows: Sequence[Parameter]) -> Self:
        """Build from rows."""
        return cls(rows)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        rows = handler.generate_schema(Annotated[tuple[Parameter, ...], Field(max_length=MOST_PARAMETERS)])
        return core_schema.no_info_after_validator_function(cls, rows)


class ChannelErrors(Part):
    """Errors of one channel."""

    channel: str
    joint: int | None = None
    unit: str = ""
    mse: Number = None
    rmse: Number
    max_abs_error: Number = None
    r2: Number = None
    noise_floor: Number = None
    metric: str | None = None
    relative_error: Number = None


class RecordingErrors(Part):
    """Errors on one of several recordings."""

    recording: int
    per_channel: tuple[ChannelErrors, ...]


class Score(Part):
    """Errors on one set of data.

    Attributes:
        metric: ``windowed_simulation`` or ``inverse_dynamics``.
        horizon: Length of the simulated windows, s; None for inverse dynamics.
        rmse: The headline: in the output's unit, or, with several outputs, the mean over their noise floors.
        r2: Mean R² of the outputs, a fraction.
        noise_floor: The RMSE of a perfect model.
        per_channel: The same of each output, with ``mse``, ``max_abs_error`` and ``relative_error``.
        per_recording: The same of each of several recordings.

    Example:
        >>> import labhil as lh
        >>> score = lh.load("examples/fit.json").scores["test"]
        >>> print(f"{score.rmse:.2g} {score.unit}, at best {score.noise_floor:.2g} {score.unit}")
        0.00043 m, at best 0.00044 m
    """

    metric: str = "windowed_simulation"
    horizon: Number = None
    rmse: Number
    r2: Number = None
    noise_floor: Number = None
    per_channel: tuple[ChannelErrors, ...]
    per_recording: tuple[RecordingErrors, ...] = ()

    @property
    def scored(self) -> tuple[ChannelErrors, ...]:
        """The channels of the headline, without those of another metric."""
        return tuple(row for row in self.per_channel if row.metric in (None, self.metric))

    @property
    def unit(self) -> str:
        """Unit of the headline; empty where it is in noise floors, of several channels."""
        return self.scored[0].unit if len(self.scored) == 1 else ""


class Fault(Part):
    """A fault of the data; a ``mended`` one has no effect on the result."""

    kind: str
    statement: str
    mended: bool = False


class StudyPart(Part):
    """Fields of fits and diagnoses; ``held_out`` is the part (s) of each recording that was held out."""

    complete: bool = True
    held_out: tuple[tuple[float, float], ...] = ()
    seconds: Number = None


class EstimatedCurve(Part):
    """An estimated force curve with its band, of an effect without a law."""

    depends_on: tuple[str, ...]
    x: tuple[tuple[Number, ...], ...]
    value: tuple[Number, ...]
    ci99: tuple[tuple[Number, ...], ...] = ()
    unit: str = ""
    joint: int | None = None
