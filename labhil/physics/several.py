"""Model of several recordings of one rig, with shared parameters and some that differ between recordings.

All recordings have the same model. Its parameter vector for one recording consists of the shared parameters
and those of that recording. Windows are simulated recording by recording and put back in order.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from labhil.errors import RecordingError, UnknownNameError, UsageError
from labhil.physics.extra_force import AcceptsExtraForce, ExtraForce
from labhil.physics.joining import join_records
from labhil.physics.model import Metric, Model
from labhil.physics.record import Record, Windows
from labhil.physics.terms import CharacteristicScale, Parameter, Term, keyed, unkeyed
from labhil.signals import FloatArray, IntArray

CACHE_SIZE = 8
"""Records whose split is kept: models cache by record, so the parts must stay the same objects."""

RECORDING = "recording"
"""Coordinate: number of the recording to which a sample belongs."""


@dataclass(frozen=True, slots=True)
class RecordingWindows:
    """The windows that lie in one recording.

    Attributes:
        number: Number of the recording, from 1.
        span: Its samples in the record.
        record: The recording by itself.
        windows: The windows in it, counted from its start.
        indices: Indices of these windows among all.
        rows: Indices of their rows among those of all windows.
    """

    number: int
    span: slice
    record: Record
    windows: Windows
    indices: slice
    rows: slice


class SeveralModel:
    """Model of several recordings (implements ``physics.model.Model``).

    Args:
        inner: The model of each recording.
        names: Terms or parameters (with a joint in brackets for that joint alone) with a value of their own
            in each recording.
        count: Number of recordings; without ``names``, records may have any number.

    Raises:
        UnknownNameError: A name does not exist.
        UsageError: The rig file fixes a name, or the recordings cannot identify it.
    """

    def __init__(self, inner: Model, names: Sequence[str], count: int) -> None:
        self.inner = inner
        self.names = tuple(names)
        self.count = count
        self.kind = inner.kind
        self.state_names = inner.state_names
        self.state_scale = inner.state_scale
        self.fixed = inner.fixed
        self.unobservable_terms = inner.unobservable_terms
        self.metric: Metric = inner.metric
        self.fading_memory = inner.fading_memory
        self.horizon = inner.horizon
        self.coordinate_units = inner.coordinate_units
        individual = {p.key for name in names for p in _parameters_named(inner, name)}
        copies = [_copies(p, count) if p.key in individual else (p,) for p in inner.parameters]
        self.parameters = tuple(p for group in copies for p in group)
        by_key = {p.key: group for p, group in zip(inner.parameters, copies, strict=True)}
        self.terms: Mapping[str, Term] = {
            key: replace(term, parameters=tuple(p for shared in term.parameters for p in by_key[shared.key]))
            for key, term in inner.terms.items()
        }
        self._places = _places(copies, count if individual else 1)
        self._split: dict[int, tuple[Record, tuple[Record, ...]]] = {}
        self._forces: tuple[ExtraForce, ...] = ()

    def of_recording(self, theta: FloatArray, number: int) -> FloatArray:
        """Extract the inner model's parameter vector for recording ``number``, from 1.

        Raises:
            RecordingError: The model has no parameters for a recording of that number.
        """
        if len(self._places) == 1:
            return theta[self._places[0]]
        if not 1 <= number <= self.count:
            raise RecordingError(
                f"recording {number}: expected one of {self.count}, each of which has its own "
                f"{', '.join(self.names)}"
            )
        return theta[self._places[number - 1]]

    def horizon_at(self, theta: FloatArray) -> float:
        """Longest scored horizon of the recordings, s."""
        return max(self.inner.horizon_at(theta[places]) for places in self._places)

    def prepare(self, record: Record) -> Record:
        """Prepare each recording by the inner model and join them."""
        return join_records([self.inner.prepare(recording) for recording in record.recordings()])

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """Initial states by the inner model, (w, states)."""
        return np.concatenate(
            [self.inner.initial_states(part.record, part.windows) for part in self._of(record, windows)]
        )

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulate all windows; gives outputs (N, channels)."""
        outputs = []
        for part in self._of(record, windows):
            vector, model = self.of_recording(theta, part.number), self._under(part)
            outputs.append(model.simulate(vector, part.record, part.windows, states[part.indices]))
        return np.concatenate(outputs)

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """Coordinates of the inner model along the simulation, and the number of the recording, each (N,)."""
        parts = []
        for part in self._of(record, windows):
            vector, model = self.of_recording(theta, part.number), self._under(part)
            along = model.coordinates(vector, part.record, part.windows, states[part.indices])
            parts.append({**along, RECORDING: np.full(len(part.windows.rows), float(part.number))})
        return _concatenate(parts)

    def drive_coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """Drive coordinates of the inner model, each (N,)."""
        parts = []
        for part in self._of(record, windows):
            vector, motion = self.of_recording(theta, part.number), _rows_of(along, part.rows)
            parts.append(self.inner.drive_coordinates(vector, part.record, part.windows, motion))
        return _concatenate(parts)

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """Force of the inner model in the recording of each sample, (N,) or (N, joints)."""
        numbers = np.rint(coordinates[RECORDING]).astype(np.int64)
        edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
        forces = []
        for rows in (slice(a, b) for a, b in pairwise(edges)):
            vector = self.of_recording(theta, int(numbers[rows.start]))
            forces.append(self.inner.generalised_force(vector, _rows_of(coordinates, rows)))
        return np.concatenate(forces)

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Largest of each characteristic scale among the recordings."""
        parts = [self.inner.characteristic_scales(recording) for recording in self._recordings(record)]
        return {name: max(part[name] for part in parts) for name in parts[0]}

    def _under(self, part: RecordingWindows) -> Model:
        """Inner model of one recording with its part of the additional forces."""
        model = self.inner
        for force in self._forces:
            assert isinstance(model, AcceptsExtraForce)
            course = None if force.course is None else force.course[part.span]
            model = model.with_force(replace(force, course=course))
        return model

    def _of(self, record: Record, windows: Windows) -> Iterator[RecordingWindows]:
        """Split windows by recording; recordings without windows are left out."""
        for begin, span, recording in zip(record.begins, record.spans, self._recordings(record), strict=True):
            a, b = np.searchsorted(windows.first, span).tolist()
            if a == b:
                continue
            rows = slice(*np.searchsorted(windows.owner, (a, b)).tolist())
            inner_windows = Windows(
                windows.first[a:b] - begin.row,
                windows.last[a:b] - begin.row,
                windows.rows[rows] - begin.row,
                windows.owner[rows] - a,
            )
            yield RecordingWindows(begin.number, slice(*span), recording, inner_windows, slice(a, b), rows)

    def _recordings(self, record: Record) -> tuple[Record, ...]:
        """Recordings of a record, cached."""
        entry = self._split.get(id(record))
        if entry is None or entry[0] is not record:
            entry = (record, record.recordings())
            if len(self._split) >= CACHE_SIZE:
                self._split.clear()
            self._split[id(record)] = entry
        return entry[1]


class SeveralModelWithExtraForce(SeveralModel):
    """Model of several recordings whose inner model accepts an additional force."""

    def __init__(self, inner: AcceptsExtraForce, names: Sequence[str], count: int) -> None:
        super().__init__(inner, names, count)
        self.force_unit = inner.force_unit
        self.moved = inner.moved

    def with_force(self, force: ExtraForce) -> SeveralModelWithExtraForce:
        """Copy with an additional force; its course, if any, is along the whole record."""
        other = copy.copy(self)
        other._forces = (*self._forces, force)
        return other


def several(inner: Model, names: Sequence[str], count: int) -> SeveralModel:
    """Make the model of ``count`` recordings, each with its own values of ``names``."""
    if isinstance(inner, AcceptsExtraForce):
        return SeveralModelWithExtraForce(inner, names, count)
    return SeveralModel(inner, names, count)


def model_of_one(model: Model) -> Model:
    """The model of a single recording, of one of several; another model itself."""
    return model.inner if isinstance(model, SeveralModel) else model


def names_per_recording(model: Model) -> tuple[str, ...]:
    """Names of what has a value of its own in each recording of a model."""
    return model.names if isinstance(model, SeveralModel) else ()


def for_every_recording(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Expand values by key: one without a recording is set for every recording."""
    keys_of: dict[str, list[str]] = {}
    for p in model.parameters:
        if p.recording is not None:
            keys_of.setdefault(keyed(p.name, p.joint), []).append(p.key)
    spread = {key: value for name, value in values.items() for key in keys_of.get(name, ())}
    return spread | {name: value for name, value in values.items() if name not in keys_of}


def _parameters_named(model: Model, name: str) -> list[Parameter]:
    """Parameters that a name stands for: of a term, of all joints or of one, or a single one."""
    parameters = [p for p in model.parameters if name in _names_of(p)]
    if parameters:
        return parameters
    fixed = {unkeyed(key)[0] for key in model.fixed} | set(model.fixed)
    if name in fixed:
        raise UsageError(
            f"{name} per recording: the rig file's [known] gives it, and so it is the same in all of them; "
            "leave it out there to have it estimated"
        )
    unobservable = {unkeyed(key)[0]: why for key, why in model.unobservable_terms.items()} | dict(
        model.unobservable_terms
    )
    if name in unobservable:
        raise UsageError(f"{name} per recording: these recordings cannot show it: {unobservable[name]}")
    known = {p.name.partition(".")[0] for p in model.parameters} | {p.name for p in model.parameters}
    raise UnknownNameError(f"term or parameter of {model.kind}", name, known)


def _names_of(parameter: Parameter) -> set[str | None]:
    """All names that stand for a parameter."""
    term, dot, _ = parameter.name.partition(".")
    return {parameter.name, parameter.key} | ({term, parameter.term} if dot else set())


def _copies(parameter: Parameter, count: int) -> tuple[Parameter, ...]:
    """One parameter for each recording."""
    return tuple(replace(parameter, recording=number) for number in range(1, count + 1))


def _places(copies: Sequence[tuple[Parameter, ...]], count: int) -> tuple[IntArray, ...]:
    """Indices of the inner model's parameters in the vector of all, for each recording."""
    first = np.cumsum([0, *(len(group) for group in copies)])[:-1]
    varies = np.array([len(group) > 1 for group in copies], dtype=bool)
    return tuple(np.where(varies, first + k, first).astype(np.int64) for k in range(count))


def _rows_of(along: Mapping[str, FloatArray], rows: slice) -> dict[str, FloatArray]:
    """Coordinates of the inner model at ``rows``."""
    return {name: values[rows] for name, values in along.items() if name != RECORDING}


def _concatenate(parts: Sequence[Mapping[str, FloatArray]]) -> dict[str, FloatArray]:
    """Join coordinates by name."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
