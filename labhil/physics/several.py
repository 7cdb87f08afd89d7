"""Several recordings of one rig: the same physics in all of them, but for what is named.

Every recording has the same model. Its vector for one recording is made of the parameters that all share
and of those that this recording has for itself; windows are simulated recording by recording, and their
rows put together again in order.
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
from labhil.physics.model import Metric, Model, Record, Windows
from labhil.physics.terms import CharacteristicScale, Parameter, Term, keyed, unkeyed
from labhil.signals import FloatArray, IntArray

REMEMBERED = 8
"""Records of which the recordings are kept: models remember what they know of a record."""

RECORDING = "recording"
"""The coordinate that is the number of the recording to which a sample belongs."""


@dataclass(frozen=True, slots=True)
class Share:
    """What windows have of one recording.

    ``number`` is the recording's, ``span`` its samples in the record, ``record`` itself alone and ``windows``
    those that lie in it. ``whose`` are their places among all windows, ``rows`` those of their rows.
    """

    number: int
    span: slice
    record: Record
    windows: Windows
    whose: slice
    rows: slice


class SeveralModel:
    """The model of several recordings (satisfies ``physics.model.Model``).

    ``inner`` is the model of each. What ``names`` call (terms, parameters, the rig's own sizes; with a joint
    in brackets for that joint alone) has a value in each of ``count`` recordings. Records have recordings of
    these numbers; where no names are given, of any.

    Raises UnknownNameError for a name that does not exist, UsageError for one that the rig file fixes or that
    recordings cannot show.
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
        apart = {p.key for name in names for p in _parameters_named(inner, name)}
        copies = [_copies(p, count) if p.key in apart else (p,) for p in inner.parameters]
        self.parameters = tuple(p for group in copies for p in group)
        by_key = {p.key: group for p, group in zip(inner.parameters, copies, strict=True)}
        self.terms: Mapping[str, Term] = {
            key: replace(term, parameters=tuple(p for shared in term.parameters for p in by_key[shared.key]))
            for key, term in inner.terms.items()
        }
        self._places = _places(copies, count if apart else 1)
        self._apart: dict[int, tuple[Record, tuple[Record, ...]]] = {}
        self._forces: tuple[ExtraForce, ...] = ()

    def of_recording(self, theta: FloatArray, number: int) -> FloatArray:
        """The inner model's vector for the recording of a number (from 1).

        Raises RecordingError for a number beyond those that the model was made for.
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
        """The longest of the recordings', s."""
        return max(self.inner.horizon_at(theta[places]) for places in self._places)

    def prepare(self, record: Record) -> Record:
        """Each recording as the inner model prepares it."""
        return join_records([self.inner.prepare(recording) for recording in record.recordings()])

    def initial_states(self, record: Record, windows: Windows) -> FloatArray:
        """The inner model's, (w, states)."""
        return np.concatenate(
            [self.inner.initial_states(share.record, share.windows) for share in self._of(record, windows)]
        )

    def simulate(self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray) -> FloatArray:
        """Simulated outputs of all windows, (N, channels)."""
        outputs = []
        for share in self._of(record, windows):
            vector, model = self.of_recording(theta, share.number), self._under(share)
            outputs.append(model.simulate(vector, share.record, share.windows, states[share.whose]))
        return np.concatenate(outputs)

    def coordinates(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> Mapping[str, FloatArray]:
        """The inner model's along the simulation, and the number of the recording, each (N,)."""
        parts = []
        for share in self._of(record, windows):
            vector, model = self.of_recording(theta, share.number), self._under(share)
            along = model.coordinates(vector, share.record, share.windows, states[share.whose])
            parts.append({**along, RECORDING: np.full(len(share.windows.rows), float(share.number))})
        return _concatenate(parts)

    def driven(
        self, theta: FloatArray, record: Record, windows: Windows, along: Mapping[str, FloatArray]
    ) -> Mapping[str, FloatArray]:
        """The inner model's, each (N,)."""
        parts = []
        for share in self._of(record, windows):
            vector, motion = self.of_recording(theta, share.number), _rows_of(along, share.rows)
            parts.append(self.inner.driven(vector, share.record, share.windows, motion))
        return _concatenate(parts)

    def generalised_force(self, theta: FloatArray, coordinates: Mapping[str, FloatArray]) -> FloatArray:
        """The inner model's in the recording of each sample, (N,) or (N, joints)."""
        numbers = np.rint(coordinates[RECORDING]).astype(np.int64)
        edges = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
        forces = []
        for rows in (slice(a, b) for a, b in pairwise(edges)):
            vector = self.of_recording(theta, int(numbers[rows.start]))
            forces.append(self.inner.generalised_force(vector, _rows_of(coordinates, rows)))
        return np.concatenate(forces)

    def characteristic_scales(self, record: Record) -> Mapping[CharacteristicScale, float]:
        """Of each the largest that a recording has."""
        parts = [self.inner.characteristic_scales(recording) for recording in self._recordings(record)]
        return {name: max(part[name] for part in parts) for name in parts[0]}

    def _under(self, share: Share) -> Model:
        """The model of a recording, under its share of the forces beside the model's own."""
        model = self.inner
        for force in self._forces:
            assert isinstance(model, AcceptsExtraForce)
            course = None if force.course is None else force.course[share.span]
            model = model.with_force(replace(force, course=course))
        return model

    def _of(self, record: Record, windows: Windows) -> Iterator[Share]:
        """What windows have of each recording in which some of them lie."""
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
            yield Share(begin.number, slice(*span), recording, inner_windows, slice(a, b), rows)

    def _recordings(self, record: Record) -> tuple[Record, ...]:
        """The recordings of a record, the same ones every time."""
        entry = self._apart.get(id(record))
        if entry is None or entry[0] is not record:
            entry = (record, record.recordings())
            if len(self._apart) >= REMEMBERED:
                self._apart.clear()
            self._apart[id(record)] = entry
        return entry[1]


class SeveralYieldingModel(SeveralModel):
    """The same of a model that takes one more force (satisfies ``physics.extra_force.AcceptsExtraForce``)."""

    def __init__(self, inner: AcceptsExtraForce, names: Sequence[str], count: int) -> None:
        super().__init__(inner, names, count)
        self.force_unit = inner.force_unit
        self.moved = inner.moved

    def with_force(self, force: ExtraForce) -> SeveralYieldingModel:
        """The same recordings under one more force; its course, if any, is along the whole record."""
        other = copy.copy(self)
        other._forces = (*self._forces, force)
        return other


def several(inner: Model, names: Sequence[str], count: int) -> SeveralModel:
    """The model of ``count`` recordings of which each has its own of what ``names`` call."""
    if isinstance(inner, AcceptsExtraForce):
        return SeveralYieldingModel(inner, names, count)
    return SeveralModel(inner, names, count)


def names_per_recording(model: Model) -> tuple[str, ...]:
    """What has a value of its own in each recording of a model, as it was named."""
    return model.names if isinstance(model, SeveralModel) else ()


def for_every_recording(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Values by key; one without a recording holds for every recording that has a value of its own."""
    keys_of: dict[str, list[str]] = {}
    for p in model.parameters:
        if p.recording is not None:
            keys_of.setdefault(keyed(p.name, p.joint), []).append(p.key)
    spread = {key: value for name, value in values.items() for key in keys_of.get(name, ())}
    return spread | {name: value for name, value in values.items() if name not in keys_of}


def _parameters_named(model: Model, name: str) -> list[Parameter]:
    """The parameters that a name stands for: those of a term, of all joints or of one, or a single one."""
    parameters = [p for p in model.parameters if name in _names_of(p)]
    if parameters:
        return parameters
    fixed = {unkeyed(key)[0] for key in model.fixed} | set(model.fixed)
    if name in fixed:
        raise UsageError(
            f"{name} per recording: the rig file's [known] gives it, and so it is the same in all of them; "
            "leave it out there to have it estimated"
        )
    unseen = {unkeyed(key)[0]: why for key, why in model.unobservable_terms.items()} | dict(
        model.unobservable_terms
    )
    if name in unseen:
        raise UsageError(f"{name} per recording: these recordings cannot show it: {unseen[name]}")
    known = {p.name.partition(".")[0] for p in model.parameters} | {p.name for p in model.parameters}
    raise UnknownNameError(f"term or parameter of {model.kind}", name, known)


def _names_of(parameter: Parameter) -> set[str | None]:
    """Every name that means a parameter."""
    term, dot, _ = parameter.name.partition(".")
    return {parameter.name, parameter.key} | ({term, parameter.term} if dot else set())


def _copies(parameter: Parameter, count: int) -> tuple[Parameter, ...]:
    return tuple(replace(parameter, recording=number) for number in range(1, count + 1))


def _places(copies: Sequence[tuple[Parameter, ...]], count: int) -> tuple[IntArray, ...]:
    """For each recording, where the inner model's parameters stand in the vector of all."""
    first = np.cumsum([0, *(len(group) for group in copies)])[:-1]
    varies = np.array([len(group) > 1 for group in copies], dtype=bool)
    return tuple(np.where(varies, first + k, first).astype(np.int64) for k in range(count))


def _rows_of(along: Mapping[str, FloatArray], rows: slice) -> dict[str, FloatArray]:
    """Some rows of the inner model's coordinates."""
    return {name: values[rows] for name, values in along.items() if name != RECORDING}


def _concatenate(parts: Sequence[Mapping[str, FloatArray]]) -> dict[str, FloatArray]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
