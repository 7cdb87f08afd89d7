"""Named arrays of a file as the columns of one table; what cannot be one of its columns is named, with why.

Structs, struct arrays and cells are followed by path, as MATLAB writes it: ``log.x``, ``log(2).x``, ``c{1}``.
A Simulink scope ("structure with time") is a struct with ``time`` and a struct array ``signals``: its signals
bear their labels too.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from labhil.errors import TableError
from labhil.recording.formats.columns import NumberColumns
from labhil.recording.formats.time_text import Stamps
from labhil.signals import FloatArray, Hold

MOST_PARTS = 64
"""Elements of a struct array or a cell that are looked into; more are data of another kind."""

ROUNDING = 1e-6
"""Of a mean step; times that differ by less are the same."""

TIME = ("time", "t", "Time")
"""What a struct calls the time of its signals."""

_INDEX = re.compile(r"\((\d+)\)|\[(\d+)\]|\{(\d+)\}|\.(\d+)(?=\.|$|_)")


@dataclass(frozen=True, slots=True)
class Part:
    """Something inside a file: a struct's ``fields``, ``elements`` of an array or cell, numbers, or neither.

    ``array`` holds numbers with MATLAB's axes. ``text`` is that of a label. Where there are no numbers
    ``reason`` says what there is. ``braces`` are those of elements.
    """

    fields: Mapping[str, Part] = field(default_factory=dict)
    elements: Sequence[Part] = ()
    array: FloatArray | None = None
    text: str = ""
    reason: str = ""
    braces: str = "()"


@dataclass(frozen=True, slots=True)
class Variable:
    """Numbers of a file by ``name``, a path; ``labels`` name them too; ``owner`` is the path of the struct
    whose time they have. Without numbers ``reason`` says why.
    """

    name: str
    array: FloatArray | None
    reason: str = ""
    labels: tuple[str, ...] = ()
    owner: str = ""

    @property
    def shape(self) -> str:
        """Its size in words."""
        return "" if self.array is None else "×".join(map(str, self.array.shape))


@dataclass(frozen=True)
class VariableColumns(NumberColumns):
    """Columns of one table out of many variables, with their ``labels``; ``unused`` ones with the reason."""

    labels: tuple[tuple[str, ...], ...] = ()
    unused: tuple[tuple[str, str], ...] = ()
    used: set[int] = field(default_factory=set)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was not used, and why."""
        names = self.names or ()
        idle = [name for place, name in enumerate(names) if place not in self.used]
        by_reason: dict[str, list[str]] = defaultdict(list)
        for name, reason in self.unused:
            by_reason[reason].append(name)
        if idle:
            by_reason["no channel asks for it"] = idle
        return tuple(f"not used: {', '.join(skipped)} ({reason})" for reason, skipped in by_reason.items())

    @property
    def left_out(self) -> str:
        """What is in the file and is no column, for messages."""
        return "; ".join(f"{name} is no column: {reason}" for name, reason in self.unused)

    def find(self, source: str) -> tuple[int, ...]:
        """The numbers of the columns of that path or, where there is none, of that label or last part."""
        names = self.names or ()
        wanted = _plain(source)
        exact = tuple(place for place, name in enumerate(names) if _plain(name) == wanted)
        return exact or tuple(place for place, labels in enumerate(self.labels) if source in labels)

    def times(self, column: int) -> Stamps:
        """The values of a column that holds the time, shape (rows,); dates and times of day in s."""
        self.used.add(column)
        return super().times(column)

    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """The values of a column, shape (rows,); NaN where there is no number."""
        self.used.add(column)
        return self.values[column]


def variables_of(parts: Mapping[str, Part]) -> list[Variable]:
    """Return everything that has a name and no parts, in the order of the file."""
    return [variable for name, part in parts.items() for variable in _walk(name, part, (), "")]


def _walk(name: str, part: Part, labels: tuple[str, ...], owner: str) -> Iterator[Variable]:
    if part.fields:
        inner_owner = name if any(time in part.fields for time in TIME) else owner
        label = part.fields["label"].text.strip() if "label" in part.fields else part.text
        for key, inner in part.fields.items():
            # a scope's label names its values, every other field bears its own name too
            named = (label, f"{inner_owner}.{label}") if label and key in ("values", "Data") else (key,)
            named = ("Time", "time") if key == "Time" else named
            named = (*named, name) if label and key == "Data" else named
            yield from _walk(f"{name}.{key}", inner, named, inner_owner)
    elif part.elements:
        if len(part.elements) > MOST_PARTS:
            yield Variable(name, None, f"{len(part.elements)} elements, at most {MOST_PARTS} are looked into")
            return
        for number, inner in enumerate(part.elements, 1):
            yield from _walk(f"{name}{part.braces[0]}{number}{part.braces[1]}", inner, labels, owner)
    elif part.array is None or part.array.size == 0:
        yield Variable(name, None, part.reason or "empty")
    else:
        yield Variable(name, part.array, labels=labels, owner=owner)


def table_of(path: Path, variables: Sequence[Variable], wanted: Sequence[str]) -> VariableColumns:
    """Make one table: its rows are as many as most numbers have, of those ``wanted`` or else of all.

    Args:
        path: The file, for messages.
        variables: All that is in it.
        wanted: Names that the rig file asks for.

    Raises:
        TableError: No variable holds columns, or those wanted belong to different times.
    """
    arrays = [variable for variable in variables if variable.array is not None and variable.array.ndim >= 2]
    if not arrays:
        reasons = "; ".join(f"{variable.name}: {variable.reason}" for variable in variables) or "none"
        raise TableError(f"{path}: expected variables that are columns of numbers, found {reasons}")
    requested = [variable for name in wanted for variable in arrays if _asks_for(name, variable)]
    _refuse_other_times(path, requested, arrays)
    owner = next((variable.owner for variable in requested if variable.owner and not _is_time(variable)), "")
    rows = _rows(requested or arrays)
    names: list[str] = []
    columns: list[FloatArray] = []
    labels: list[tuple[str, ...]] = []
    unused = [(variable.name, variable.reason) for variable in variables if variable not in arrays]
    for variable in arrays:
        upright = _upright(variable, rows)
        if upright is None:
            unused.append((variable.name, f"{variable.shape}, where the table has {rows} rows"))
            continue
        count = upright.shape[1]
        suffixes = [""] if count == 1 else [f"_{column}" for column in range(count)]
        names += [f"{variable.name}{suffix}" for suffix in suffixes]
        # of several times the one that goes with what is wanted is called just that
        known = () if owner and _is_time(variable) and variable.owner != owner else variable.labels
        labels += [tuple(f"{label}{suffix}" for label in known) for suffix in suffixes]
        columns += list(upright.T)
    counts = np.full(rows, len(names))
    return VariableColumns(
        names=tuple(names),
        width=len(names),
        lines=np.arange(1, rows + 1),
        counts=counts,
        values=columns,
        labels=tuple(labels),
        unused=tuple(unused),
    )


def _rows(arrays: Sequence[Variable]) -> int:
    """The length that most numbers stand in."""
    sizes: Counter[int] = Counter()
    for variable in arrays:
        assert variable.array is not None
        sizes[max(variable.array.shape)] += variable.array.size
    return sizes.most_common(1)[0][0]


def _upright(variable: Variable, rows: int) -> FloatArray | None:
    """The variable with one row for each of ``rows`` samples, or None.

    Of more than two axes the last counts the samples, as where Simulink logs matrices; the others are run
    through as MATLAB does, the first axis fastest.
    """
    array = variable.array
    assert array is not None
    if array.ndim > 2:
        return array.reshape(-1, rows, order="F").T if array.shape[-1] == rows else None
    if array.shape[0] == rows:
        return array
    return array.T if array.shape[1] == rows else None


def _is_time(variable: Variable) -> bool:
    """Whether these are the times of the struct that they stand in."""
    return bool(variable.owner) and variable.name.removeprefix(variable.owner)[1:] in TIME


def _refuse_other_times(path: Path, requested: Sequence[Variable], arrays: Sequence[Variable]) -> None:
    """TableError where wanted variables have times that differ."""
    times = {variable.owner: variable for variable in arrays if _is_time(variable)}
    signals = [variable.owner for variable in requested if not _is_time(variable)]
    owners = dict.fromkeys(owner for owner in signals if owner in times)
    first, *others = owners or [""]
    for second in others:
        reference, differing = times[first], times[second]
        if (
            reference.array is None
            or differing.array is None
            or _same_times(reference.array.ravel(), differing.array.ravel())
        ):
            continue
        raise TableError(
            f"{path}: expected signals with one time, found {reference.name} ({reference.shape}) and "
            f"{differing.name} ({differing.shape}), which differ; take the signals of one of them, or "
            "resample in MATLAB (interp1)"
        )


def _same_times(first: FloatArray, second: FloatArray) -> bool:
    """Whether two times are the same but for rounding: one may be stored, one be a start and a step."""
    if np.array_equal(first, second):
        return True
    if first.shape != second.shape or not np.isfinite([first, second]).all():
        return False
    return bool(
        np.allclose(first, second, rtol=1e-12, atol=ROUNDING * float(np.ptp(first)) / max(len(first), 1))
    )


def _asks_for(name: str, variable: Variable) -> bool:
    plain = _plain(name)
    names = (_plain(variable.name), *variable.labels)
    return any(
        candidate in {name, plain} or re.fullmatch(rf"{re.escape(candidate)}_\d+", name)
        for candidate in names
    )


def _plain(name: str) -> str:
    """A path with every index written as ``(2)``: ``{2}`` counts from 1 too, ``[1]`` and ``.1`` from 0."""

    def plain(match: re.Match[str]) -> str:
        one_based = match[1] or match[3]
        return f"({int(one_based)})" if one_based else f"({int(match[2] or match[4]) + 1})"

    return _INDEX.sub(plain, name)
