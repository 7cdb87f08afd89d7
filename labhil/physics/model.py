"""What identification needs of a model: its parameters, its terms, and simulated windows of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from labhil.errors import UnknownNameError, UsageError
from labhil.physics.terms import CharacteristicScale, Parameter, Term
from labhil.recording.clock_faults import ClockFault
from labhil.signals import FloatArray, Hold, IntArray

if TYPE_CHECKING:
    from labhil.physics.smoothing import Smoothing

BORDER = 20.0
"""Usual steps of time between two recordings that stand in one record."""

TWO_AND_A_LEAD = 0.4
"""Of a recording, for a horizon that follows another and half of one before them."""

UNREAD = 2
"""Mark of a reading that was wrong: what stands in its place was not measured."""

WHITE = (1.0, 0.0, 0.0, 0.0)
"""Correlation of white noise in rows 0 to 3 apart."""


@dataclass(frozen=True, slots=True)
class Begin:
    """Where one of the recordings of a record begins.

    Its first sample is ``row``; its ``number`` counts from 1; its own time is the record's less ``shift`` s.
    ``noise_scale`` (channels,) is the noise of its outputs over that of the record, where it was looked at;
    ``clock_faults`` are what is wrong with the stamps of its samples. ``input_smoothing`` is how noise was
    taken off the first input, where that is a sensor's reading.
    """

    row: int = 0
    number: int = 1
    shift: float = 0.0
    noise_scale: tuple[float, ...] = ()
    clock_faults: tuple[ClockFault, ...] = ()
    input_smoothing: Smoothing | None = None


@dataclass(frozen=True, slots=True)
class Record:
    """One recording as a model sees it, or several, one after another (see ``physics.joining``).

    ``t`` (n,) s, increasing; ``inputs`` (n, inputs) and ``outputs`` (n, channels) in SI units;
    ``input_holds`` (inputs,) what each input does between samples; ``auxiliary`` holds other channels of
    the rig, each (n,), by column name; ``output_joints`` (channels,) the joint of each output, where it
    has one. ``begins`` marks where each recording begins: nothing may be followed from one to the next.
    ``least_noise`` (channels,) is the least standard deviation of the noise that the whole recording shows: a
    part of it that rests shows none; empty where nothing is known. ``censored`` (n, channels) is +1 where a
    reading stands at the upper end of its range and says only "at least this", −1 at the lower end,
    ``UNREAD`` where what stands there was not measured, else 0; None where all are readings.
    """

    t: FloatArray
    inputs: FloatArray
    outputs: FloatArray
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    input_holds: tuple[Hold, ...] = (Hold.LINEAR,)
    auxiliary: Mapping[str, FloatArray] = field(default_factory=dict)
    output_joints: tuple[int | None, ...] = ()
    begins: tuple[Begin, ...] = (Begin(),)
    least_noise: tuple[float, ...] = ()
    censored: IntArray | None = None

    def __len__(self) -> int:
        return len(self.t)

    @property
    def spans(self) -> list[tuple[int, int]]:
        """First sample, and the one after the last, of each recording."""
        rows = [begin.row for begin in self.begins]
        return list(zip(rows, [*rows[1:], len(self)], strict=True))

    def recordings(self) -> tuple[Record, ...]:
        """Each recording by itself, with its number and its own time; of one the record itself."""
        if len(self.begins) == 1 and not self.begins[0].shift:
            return (self,)
        return tuple(
            replace(part, t=part.t - begin.shift, begins=(replace(begin, row=0, shift=0.0),))
            for begin, (first, last) in zip(self.begins, self.spans, strict=True)
            for part in [self.part(first, last)]
        )

    def own_time(self, row: int) -> tuple[int, float]:
        """Number of the recording that a sample belongs to, and its time there, s."""
        begin = next(b for b in reversed(self.begins) if b.row <= row)
        return begin.number, float(self.t[row] - begin.shift)

    @property
    def durations(self) -> list[float]:
        """Time from the first to the last sample of each recording, s."""
        return [float(self.t[last - 1] - self.t[first]) for first, last in self.spans]

    @property
    def duration(self) -> float:
        """All of these, s."""
        return sum(self.durations)

    @property
    def countable(self) -> float:
        """The longest horizon of which two and the half of one before them fit into every recording, s."""
        return TWO_AND_A_LEAD * min(self.durations)

    @property
    def longest(self) -> float:
        """The longest of them: no window can be longer, s."""
        return max(self.durations)

    @property
    def period(self) -> float:
        """Median time between samples, s."""
        return float(np.median(np.diff(self.t)))

    @property
    def alike(self) -> tuple[float, ...]:
        """Correlation of the measurement noise in rows 0 to 3 apart, as far as it was filtered."""
        return WHITE

    def with_holds(self, holds: Mapping[str, Hold]) -> Record:
        """The same with what some inputs do between samples, by column name."""
        input_holds = tuple(holds.get(n, h) for n, h in zip(self.input_names, self.input_holds, strict=False))
        return self if input_holds == self.input_holds else replace(self, input_holds=input_holds)

    def channel(self, j: int) -> tuple[str, int | None]:
        """Signal and joint of output column ``j``."""
        joint = self.output_joints[j] if self.output_joints else None
        name = self.output_names[j]
        return (name if joint is None else name.removesuffix(f"_{joint}")), joint

    def part(self, first: int, last: int) -> Record:
        """The samples first … last − 1."""
        begins = [self.begins[k] for k in self.within(first, last)]
        return replace(
            self,
            t=self.t[first:last],
            inputs=self.inputs[first:last],
            outputs=self.outputs[first:last],
            auxiliary={name: values[first:last] for name, values in self.auxiliary.items()},
            begins=tuple(replace(begin, row=max(begin.row - first, 0)) for begin in begins) or (Begin(),),
            censored=None if self.censored is None else self.censored[first:last],
        )

    def within(self, first: int, last: int) -> list[int]:
        """Which of the recordings, counted from 0, have samples among first … last − 1."""
        return [k for k, (a, b) in enumerate(self.spans) if max(a, first) < min(b, last)]

    def followed_by(self, others: Sequence[Record]) -> Record:
        """This recording and others of the same channels as one record, numbered in their order."""
        records = (self, *others)
        begins, row, next_start = list[Begin](), 0, float(self.t[0])
        for number, record in enumerate(records, 1):
            shift = next_start - float(record.t[0]) if row else 0.0
            begins.append(replace(record.begins[0], row=row, number=number, shift=shift, noise_scale=()))
            row, next_start = row + len(record), float(record.t[-1]) + shift + BORDER * self.period
        return replace(
            self,
            t=np.concatenate(
                [r.t + b.shift if b.shift else r.t for r, b in zip(records, begins, strict=True)]
            ),
            inputs=np.concatenate([record.inputs for record in records]),
            outputs=np.concatenate([record.outputs for record in records]),
            auxiliary={
                name: np.concatenate([record.auxiliary[name] for record in records])
                for name in self.auxiliary
            },
            begins=tuple(begins),
            least_noise=_common_floor(records),
            censored=_censored_of(records),
        )


def _common_floor(records: Sequence[Record]) -> tuple[float, ...]:
    """The least noise that every one of them has at least; none where one does not state it."""
    if not all(record.least_noise for record in records):
        return ()
    return tuple(np.min([record.least_noise for record in records], axis=0).tolist())


def _censored_of(records: Sequence[Record]) -> IntArray | None:
    if all(record.censored is None for record in records):
        return None
    return np.concatenate(
        [
            np.zeros(record.outputs.shape, dtype=np.int64) if record.censored is None else record.censored
            for record in records
        ]
    )


@dataclass(frozen=True, slots=True)
class Windows:
    """Stretches of a record that are simulated each from an initial state of its own.

    Window w covers the samples first[w] … last[w] − 1. All results are the rows of all windows, one
    after the other: ``rows`` (N,) are their sample numbers, ``owner`` (N,) the window of each.
    """

    first: IntArray
    last: IntArray
    rows: IntArray
    owner: IntArray

    def __len__(self) -> int:
        return len(self.first)

    @classmethod
    def of(cls, spans: Sequence[tuple[int, int]]) -> Windows:
        """Build from (first, last) pairs."""
        first = np.array([a for a, _ in spans], dtype=np.int64)
        last = np.array([b for _, b in spans], dtype=np.int64)
        if not len(first):
            return cls(first, last, first.copy(), first.copy())
        rows = np.concatenate([np.arange(a, b, dtype=np.int64) for a, b in spans])
        return cls(first, last, rows, np.repeat(np.arange(len(first), dtype=np.int64), last - first))


class Metric(StrEnum):
    """By which error a model is judged; pinned per rig."""

    WINDOWED_SIMULATION = "windowed_simulation"
    INVERSE_DYNAMICS = "inverse_dynamics"


class Model(Protocol):
    """A rig's white-box model: one simulation that knows every term, neutral at zero.

    A vector ``theta`` holds a value for each of ``parameters``, in their order.
    """

    @property
    def kind(self) -> str:
        """Name of the rig kind."""
        ...

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states; those that end in ``_velocity`` are zero at rest."""
        ...

    @property
    def state_scale(self) -> FloatArray:
        """Typical error of a guessed state, (states,)."""
        ...

    @property
    def terms(self) -> Mapping[str, Term]:
        """All terms that it may have, by name."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What may be estimated: the rig's own parameters first, then those of all terms."""
        ...

    @property
    def fixed(self) -> Mapping[str, float]:
        """Parameters that the rig file knows."""
        ...

    @property
    def unobservable_terms(self) -> Mapping[str, str]:
        """Terms that no recording of this rig can show, with the reason."""
        ...

    @property
    def metric(self) -> Metric:
        """The error by which it is judged."""
        ...

    @property
    def fading_memory(self) -> bool:
        """Whether its state forgets how it began: windows may then be as long as the recording."""
        ...

    @property
    def horizon(self) -> float:
        """Scored horizon of the windowed simulation (s) before anything is fitted, to cut windows by."""
        ...

    def horizon_at(self, theta: FloatArray) -> float:
        """Scored horizon of the windowed simulation, s; the rig file's own where it states one."""
        ...

    def prepare(self, record: Record) -> Record:
        """What is fitted and scored: the record itself, or filtered where accelerations are needed."""
        ...

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Guess the state at the first sample of each window from the measurement alone, (w, states)."""
        ...

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulated outputs of all windows, (N, channels)."""
        ...

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Physical coordinates (positions, velocities, inputs) along the simulation, each (N,)."""
        ...

    @property
    def coordinate_units(self) -> Mapping[str, str]:
        """Units of those coordinates by which a person would locate a mismatch; a vector's by its name
        alone."""
        ...

    def driven(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Those of the coordinates that describe how ``theta`` drives the motion ``along``, each (N,).

        What effects on the way in, of the winding or of a load change, with the motion as it is.
        """
        ...

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Generalised force (or acceleration) that the model exerts there, (N,) or (N, joints)."""
        ...

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """What the starts of parameters are fractions of, in this record."""
        ...


@runtime_checkable
class PartlyLinear(Model, Protocol):
    """A model without states that knows its exact slopes by those parameters that it is linear in."""

    def regressor(self, theta: FloatArray, record: Record, free_keys: Sequence[str]) -> FloatArray:
        """Slopes of :meth:`simulate` over a whole record by linear parameters, (N·c, P) per unit."""
        ...


def unit_of(units: Mapping[str, str], name: str) -> str | None:
    """Unit of a coordinate, None where there is none; a joint's goes by its vector's name and a number."""
    return units.get(name, units.get(name.rpartition("_")[0]))


def index_of(parameters: Sequence[Parameter]) -> dict[str, int]:
    """Where each parameter stands in a vector ``theta``, by key."""
    return {parameter.key: i for i, parameter in enumerate(parameters)}


def start_values(parameters: Sequence[Parameter]) -> FloatArray:
    """The vector at which every term vanishes and the rig's own parameters are at their first start."""
    return np.array([p.neutral if "." in p.name else p.starts[0] for p in parameters])


def starts_of(model: Model, terms: Sequence[Term], record: Record) -> list[dict[str, float]]:
    """Sets of values from which a fit of these terms may begin, the first with every level at zero."""
    measure = model.characteristic_scales(record)
    parameters = [p for term in terms for p in term.parameters]
    starts = {p.key: tuple(s * measure[p.of] ** p.power for s in p.starts) for p in parameters}
    neutral = {p.key: starts[p.key][0] if p.shape and starts[p.key] else p.neutral for p in parameters}
    count = max((len(values) for values in starts.values()), default=0)
    return [neutral] + [
        {name: values[min(i, len(values) - 1)] if values else 0.0 for name, values in starts.items()}
        for i in range(count)
    ]


def terms_named(model: Model, names: Sequence[str]) -> tuple[Term, ...]:
    """The terms of a model by name or key, duplicates removed; a name alone means all joints.

    UnknownNameError lists the terms that exist; UsageError says why this recording cannot show one.
    """
    by_name: dict[str, list[str]] = {}
    for key, term in model.terms.items():
        by_name.setdefault(term.name, []).append(key)
    keys: list[str] = []
    for name in names:
        if name not in model.terms and name not in by_name:
            if name in model.unobservable_terms:
                raise UsageError(f"{name}: this recording cannot show it: {model.unobservable_terms[name]}")
            raise UnknownNameError(f"term of {model.kind}", name, by_name)
        keys += [name] if name in model.terms else by_name[name]
    return tuple(model.terms[key] for key in dict.fromkeys(keys))
