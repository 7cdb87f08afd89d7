"""The tables of a rig file, one class each: what they may hold, and what fits together."""

from __future__ import annotations

from math import inf
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from labhil.errors import suggestion
from labhil.kinds import kind_names
from labhil.signals import Hold

Threshold = Annotated[float, Field(allow_inf_nan=False)] | None


class Section(BaseModel):
    """What holds for every table: no unknown keys, nothing is changed later."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class RigSection(Section):
    """``[rig]``: which kind of rig this is."""

    kind: str

    @field_validator("kind")
    @classmethod
    def _check_kind(cls, value: str) -> str:
        names = kind_names()
        if value not in names:
            raise ValueError(f"no such rig{suggestion(value, names)}; known: {', '.join(sorted(names))}")
        return value


class ModelSection(Section):
    """``[model]``: the simulator of a user's own, in place of ``[rig]``.

    Either ``python``, a Python file and a name in it, or ``mujoco``, an MJCF or URDF file, or ``fmu``, an
    FMU. Of the last two, ``inputs`` and ``outputs`` give actuators, joints and sensors, or variables of the
    FMU, by the names of the recorded signals. Where the simulation cannot be called, ``simulated`` gives
    measured signals with their units, of which the channels ``simulated_…`` hold what was simulated, and
    ``beside`` the units of other recorded signals.
    """

    python: str | None = None
    mujoco: str | None = None
    fmu: str | None = None
    inputs: dict[str, str] | None = None
    outputs: dict[str, str] | None = None
    simulated: Annotated[dict[str, str], Field(min_length=1)] | None = None
    beside: dict[str, str] = {}

    @model_validator(mode="after")
    def _check_choice(self) -> ModelSection:
        if sum(value is not None for value in (self.python, self.mujoco, self.fmu, self.simulated)) != 1:
            raise ValueError(
                'give either python = "FILE.py:NAME", mujoco = "FILE.xml", fmu = "FILE.fmu" or '
                'simulated = { SIGNAL = "UNIT", … }, and no other'
            )
        if (self.mujoco, self.fmu) == (None, None) and (self.inputs or self.outputs):
            raise ValueError("inputs and outputs are for mujoco and fmu; others state their own")
        if self.simulated is None and self.beside:
            raise ValueError("beside is for simulated: signals over which a difference is located")
        return self

    @property
    def stated(self) -> tuple[str, str]:
        """The key that names the simulator, and what it says."""
        given = {"python": self.python, "mujoco": self.mujoco, "fmu": self.fmu}
        given["simulated"] = next(iter(self.simulated or {}), None)
        return next((key, value) for key, value in given.items() if value is not None)


class OwnModel(Section):
    """That section by itself."""

    model: ModelSection


class Limit(Section):
    """What a signal may be: ``min`` and ``max`` in its unit, ``rate`` in its unit per second."""

    min: float = float("-inf")
    max: float = float("inf")
    rate: Annotated[float, Field(gt=0)] = float("inf")

    @model_validator(mode="after")
    def _check_order(self) -> Limit:
        if not self.min < self.max:
            raise ValueError(f"min ({self.min:g}) must be smaller than max ({self.max:g})")
        return self


class Interlock(Section):
    """One of ``[interlocks]``: beyond a trip threshold the device goes to its safe state.

    It stays there until the signal is back inside the resume thresholds (by default those of the trip),
    and somebody takes the command anew: nothing moves again by itself. ``then`` says what a run does:
    ``abort`` ends it, ``pause`` lets it wait for somebody to resume it. Thresholds in the signal's unit.
    """

    trip_above: Threshold = None
    resume_below: Threshold = None
    trip_below: Threshold = None
    resume_above: Threshold = None
    then: Literal["abort", "pause"] = "abort"

    @model_validator(mode="after")
    def _check_thresholds(self) -> Interlock:
        if self.trip_above is None and self.trip_below is None:
            raise ValueError("give trip_above, trip_below or both: nothing would trip")
        if self.resume_below is not None and (self.trip_above is None or self.resume_below > self.trip_above):
            raise ValueError("resume_below needs a trip_above that is not smaller")
        if self.resume_above is not None and (self.trip_below is None or self.resume_above < self.trip_below):
            raise ValueError("resume_above needs a trip_below that is not larger")
        if self.resume_low >= self.resume_high:
            raise ValueError(
                f"between {self.resume_low:g} and {self.resume_high:g} there is nothing to resume at"
            )
        return self

    @property
    def resume_high(self) -> float:
        """The upper end of where the interlock is lifted."""
        above = inf if self.trip_above is None else self.trip_above
        return above if self.resume_below is None else self.resume_below

    @property
    def resume_low(self) -> float:
        """The lower end of where the interlock is lifted."""
        below = -inf if self.trip_below is None else self.trip_below
        return below if self.resume_above is None else self.resume_above


class Metric(Section):
    """``[metric]``: horizon of the windowed simulation, s; cut-off of inverse dynamics, Hz."""

    horizon: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    cut_off: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


class Table(Section):
    """``[table]``: how to read a file that is not already in our names and units.

    ``thousands`` is the mark that groups digits; ``part`` (from 1) the stretch to take of a table whose clock
    begins anew; ``episode`` (from 0) the one to take of a LeRobot dataset; ``blanks = "fill"`` also fills
    empty cells of a slower output; ``bad_rows`` drops or refuses what cannot be read: without it a few rows
    are dropped, and many refused.
    """

    header: bool | None = None
    delimiter: Literal["comma", "tab", "whitespace", "semicolon"] | None = None
    rate: Annotated[float, Field(gt=0)] | None = None
    decimal: Literal[".", ","] = "."
    thousands: Literal[".", ",", "'", " "] | None = None
    skip_rows: Annotated[int, Field(ge=0)] = 0
    comment: str | None = None
    sheet: str | None = None
    part: Annotated[int, Field(ge=1)] | None = None
    episode: Annotated[int, Field(ge=0)] | None = None
    blanks: Literal["fill"] | None = None
    bad_rows: Literal["drop", "fail"] | None = None

    @model_validator(mode="after")
    def _check_marks(self) -> Table:
        if self.thousands == self.decimal:
            raise ValueError(f"decimal and thousands are both {self.decimal!r}; they must differ")
        return self


Column = Annotated[int, Field(ge=0)] | str
Factor = float | list[float]


class Channel(Section):
    """One entry of ``[channels]``: value = raw · ``scale`` + ``offset``; columns by name or number.

    ``hold`` says how an input runs between samples: "zero" keeps the earlier value, "linear" is straight.
    ``unwrap`` is the period (in the signal's unit) after which a position begins anew, to be undone.
    ``shift`` (s) is added to the channel's own stamps: −0.01 for stamps that are 10 ms late.
    """

    column: Column | None = None
    columns: list[Column] | None = None
    scale: Factor = 1.0
    offset: Factor = 0.0
    hold: Hold | None = None
    unwrap: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    shift: Annotated[float, Field(allow_inf_nan=False)] = 0.0

    @model_validator(mode="after")
    def _check_columns(self) -> Channel:
        if (self.column is None) == (self.columns is None):
            raise ValueError("give either `column` (one) or `columns` (a list)")
        for name, factor in (("scale", self.scale), ("offset", self.offset)):
            if isinstance(factor, list) and len(factor) != len(self.sources()):
                counts = f"{len(factor)} values for {len(self.sources())} columns"
                raise ValueError(f"`{name}` has {counts}; give one, or one each")
        return self

    def sources(self) -> tuple[Column, ...]:
        """The columns of the file that this channel is made of, in order."""
        if self.columns is not None:
            return tuple(self.columns)
        return () if self.column is None else (self.column,)
