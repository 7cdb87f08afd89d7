"""Named arrays of a file as columns of a table, with a reason for each array that cannot be a column.

Names are paths in MATLAB's notation through structs, struct arrays and cells: ``log.x``, ``log(2).x``,
``c{1}``. A Simulink scope ("structure with time") is a struct with ``time`` and a struct array ``signals``,
whose elements also have their labels as names.
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
from labhil.recording.formats.time_text import TimeValues
from labhil.signals import FloatArray, Hold

MAX_ELEMENTS = 64
"""Largest number of elements of a struct array or cell that are read; larger ones are other data."""

TIME_FIELDS = ("time", "t", "Time")
"""Fields of a struct that are the time of its signals."""

_INDEX = re.compile(r"\((\d+)\)|\[(\d+)\]|\{(\d+)\}|\.(\d+)(?=\.|$|_)")


@dataclass(frozen=True, slots=True)
class Node:
    """Node of the tree in a file: a struct, an array of structs, a cell, numbers, or something else.

    Attributes:
        fields: fields of a struct.
        elements: elements of a struct array or cell.
        array: numbers, with MATLAB's axes.
        text: text of a label.
        reason: why there are no numbers.
        braces: brackets around an element's index.
    """

    fields: Mapping[str, Node] = field(default_factory=dict)
    elements: Sequence[Node] = ()
    array: FloatArray | None = None
    text: str = ""
    reason: str = ""
    braces: str = "()"


@dataclass(frozen=True, slots=True)
class Variable:
    """An array in a file.

    Attributes:
        name: its path.
        array: its numbers, if there are any.
        reason: why there are none.
        labels: other names.
        owner: path of the struct whose time is its time.
    """

    name: str
    array: FloatArray | None
    reason: str = ""
    labels: tuple[str, ...] = ()
    owner: str = ""

    @property
    def shape(self) -> str:
        """Shape for messages, like 1000×3."""
        return "" if self.array is None else "×".join(map(str, self.array.shape))


@dataclass(frozen=True)
class VariableColumns(NumberColumns):
    """A table of variables of equal length.

    Attributes:
        labels: other names of each column.
        unused: names and reasons of variables that are no columns.
        used: columns that were read.
    """

    labels: tuple[tuple[str, ...], ...] = ()
    unused: tuple[tuple[str, str], ...] = ()
    used: set[int] = field(default_factory=set)

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about variables that were not used, and why."""
        names = self.names or ()
        not_requested = [name for index, name in enumerate(names) if index not in self.used]
        by_reason: dict[str, list[str]] = defaultdict(list)
        for name, reason in self.unused:
            by_reason[reason].append(name)
        if not_requested:
            by_reason["no channel asks for it"] = not_requested
        return tuple(f"not used: {', '.join(unused)} ({reason})" for reason, unused in by_reason.items())

    @property
    def skipped(self) -> str:
        """Content of the file that is no column, and why, for messages."""
        return "; ".join(f"{name} is no column: {reason}" for name, reason in self.unused)

    def find(self, name: str) -> tuple[int, ...]:
        """Find columns by path or, without such a path, by label or last part of the path."""
        names = self.names or ()
        wanted = _normalise(name)
        exact = tuple(index for index, known in enumerate(names) if _normalise(known) == wanted)
        return exact or tuple(index for index, labels in enumerate(self.labels) if name in labels)

    def times(self, column: int) -> TimeValues:
        """Times (rows,) in a column; dates and times of day in s."""
        self.used.add(column)
        return super().times(column)

    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """Values (rows,) of a column."""
        self.used.add(column)
        return self.values[column]


def list_variables(nodes: Mapping[str, Node]) -> list[Variable]:
    """List the leaves of trees of nodes, by the names of these, in the order of the file."""
    return [variable for name, node in nodes.items() for variable in _iterate(name, node, (), "")]


def _iterate(name: str, node: Node, labels: tuple[str, ...], owner: str) -> Iterator[Variable]:
    if node.fields:
        inner_owner = name if any(time in node.fields for time in TIME_FIELDS) else owner
        label = node.fields["label"].text.strip() if "label" in node.fields else node.text
        for key, inner in node.fields.items():
            # a scope's label is the name of its values; all other fields have their own names
            inner_labels: tuple[str, ...] = (key,)
            if label and key in ("values", "Data"):
                inner_labels = (label, f"{inner_owner}.{label}")
            if key == "Time":
                inner_labels = ("Time", "time")
            elif label and key == "Data":
                inner_labels = (*inner_labels, name)
            yield from _iterate(f"{name}.{key}", inner, inner_labels, inner_owner)
    elif node.elements:
        if len(node.elements) > MAX_ELEMENTS:
            yield Variable(
                name, None, f"{len(node.elements)} elements, at most {MAX_ELEMENTS} are looked into"
            )
            return
        for number, inner in enumerate(node.elements, 1):
            yield from _iterate(f"{name}{node.braces[0]}{number}{node.braces[1]}", inner, labels, owner)
    elif node.array is None or node.array.size == 0:
        yield Variable(name, None, node.reason or "empty")
    else:
        yield Variable(name, node.array, labels=labels, owner=owner)


def make_table(path: Path, variables: Sequence[Variable], wanted: Sequence[str]) -> VariableColumns:
    """Make a table of the variables whose length is the most frequent one.

    Args:
        path: the file, for messages.
        variables: all variables of the file.
        wanted: names of columns; if any exist, only their lengths count.

    Returns:
        The table.

    Raises:
        TableError: No variable holds columns, or those wanted belong to different times.
    """
    arrays = [variable for variable in variables if variable.array is not None and variable.array.ndim >= 2]
    if not arrays:
        reasons = "; ".join(f"{variable.name}: {variable.reason}" for variable in variables) or "none"
        raise TableError(f"{path}: expected variables that are columns of numbers, found {reasons}")
    requested = [variable for name in wanted for variable in arrays if _matches(name, variable)]
    _refuse_other_times(path, requested, arrays)
    owner = next((variable.owner for variable in requested if variable.owner and not _is_time(variable)), "")
    rows = _common_length(requested or arrays)
    names: list[str] = []
    columns: list[FloatArray] = []
    labels: list[tuple[str, ...]] = []
    unused = [(variable.name, variable.reason) for variable in variables if variable not in arrays]
    for variable in arrays:
        upright = _rows_first(variable, rows)
        if upright is None:
            unused.append((variable.name, f"{variable.shape}, where the table has {rows} rows"))
            continue
        count = upright.shape[1]
        suffixes = [""] if count == 1 else [f"_{column}" for column in range(count)]
        names += [f"{variable.name}{suffix}" for suffix in suffixes]
        # of several times only that of the wanted signals is called "time"
        is_other_time = owner and _is_time(variable) and variable.owner != owner
        names_too = () if is_other_time else variable.labels
        labels += [tuple(f"{label}{suffix}" for label in names_too) for suffix in suffixes]
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


def _common_length(arrays: Sequence[Variable]) -> int:
    """Length of the variables with the most numbers."""
    sizes: Counter[int] = Counter()
    for variable in arrays:
        assert variable.array is not None
        sizes[max(variable.array.shape)] += variable.array.size
    return sizes.most_common(1)[0][0]


def _rows_first(variable: Variable, rows: int) -> FloatArray | None:
    """The variable as (rows, columns); None if no axis has ``rows`` items.

    With more than two axes the last one is the samples, as Simulink logs matrices. The others become columns
    in MATLAB's order, the first axis fastest.
    """
    array = variable.array
    assert array is not None
    if array.ndim > 2:
        return array.reshape(-1, rows, order="F").T if array.shape[-1] == rows else None
    if array.shape[0] == rows:
        return array
    return array.T if array.shape[1] == rows else None


def _is_time(variable: Variable) -> bool:
    """Whether the variable is the time of its struct."""
    return bool(variable.owner) and variable.name.removeprefix(variable.owner)[1:] in TIME_FIELDS


def _refuse_other_times(path: Path, requested: Sequence[Variable], arrays: Sequence[Variable]) -> None:
    """Raise TableError if wanted variables have different times."""
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


def _same_times(first: FloatArray, second: FloatArray, rounding: float = 1e-6) -> bool:
    """Whether two times are equal but for rounding, ``rounding`` of a mean step.

    One of them may be stored, the other computed from a start and a step.
    """
    if np.array_equal(first, second):
        return True
    if first.shape != second.shape or not np.isfinite([first, second]).all():
        return False
    return bool(
        np.allclose(first, second, rtol=1e-12, atol=rounding * float(np.ptp(first)) / max(len(first), 1))
    )


def _matches(name: str, variable: Variable) -> bool:
    plain = _normalise(name)
    names = (_normalise(variable.name), *variable.labels)
    return any(
        candidate in {name, plain} or re.fullmatch(rf"{re.escape(candidate)}_\d+", name)
        for candidate in names
    )


def _normalise(name: str) -> str:
    """A path with indices as ``(2)``: ``(2)`` and ``{2}`` count from 1, ``[1]`` and ``.1`` from 0."""

    def index_from_1(match: re.Match[str]) -> str:
        one_based = match[1] or match[3]
        return f"({int(one_based)})" if one_based else f"({int(match[2] or match[4]) + 1})"

    return _INDEX.sub(index_from_1, name)
