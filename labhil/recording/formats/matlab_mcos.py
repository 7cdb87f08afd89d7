"""Reader of MATLAB objects in MAT files (MCOS), as structs.

A file with objects has a "subsystem" with one cell array for all of them. Its first cell contains metadata:
the class of each object, and the cell of each property. Timetables, tables and timeseries become structs of
columns; a Simulink Dataset becomes a struct of its signals by name. Times are in s. Objects of other classes
become structs of their properties.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from labhil.recording.formats.matlab_objects import REFERENCE
from labhil.recording.formats.variables import MAX_ELEMENTS, Node
from labhil.signals import FloatArray

VALUE_IN_CELL = 1
"""Kind of a property whose value is in a cell."""

FIRST_CELL = 2
"""Cell of the property with the number 0; metadata and an empty cell precede it."""

MAX_DEPTH = 16
"""Largest depth of objects in objects."""

MAX_OBJECTS = 10_000
"""Largest number of objects of a file that are read."""

MAX_ROWS = 1 << 26
"""Largest number of rows of a timetable whose times are not stored."""


class UnknownObjectError(ValueError):
    """A reference to an object is invalid."""


@dataclass
class Objects:
    """Objects of a file.

    Attributes:
        metadata: content of the first cell.
        cell: function that reads a cell by its number.
        order: byte order, as for ``struct``.
    """

    metadata: bytes
    cell: Callable[[int], Node]
    order: str = "<"
    _depth: int = field(default=0, init=False)
    _objects_left: int = field(default=MAX_OBJECTS, init=False)

    def __post_init__(self) -> None:
        try:
            self._read()
        except (struct.error, IndexError, ValueError, RecursionError) as error:
            raise UnknownObjectError(f"its description of objects cannot be read: {error}") from error

    def _read(self) -> None:
        data = self.metadata
        _, count, *offsets = struct.unpack_from(f"{self.order}10I", data)
        self.names = [
            "",
            *(name.decode("utf-8", "replace") for name in data[40 : offsets[0]].split(b"\0")[:count]),
        ]
        words = np.frombuffer(data[: len(data) // 4 * 4], f"{self.order}u4")
        self.classes = words[offsets[0] // 4 : offsets[1] // 4].reshape(-1, 4)[:, 1]
        self.objects = words[offsets[2] // 4 : offsets[3] // 4].reshape(-1, 6)
        self.typed_properties = list(_iterate_properties(words[offsets[1] // 4 : offsets[2] // 4]))
        self.properties = list(_iterate_properties(words[offsets[3] // 4 : offsets[4] // 4]))

    def node(self, reference: Any) -> Node:
        """Read the objects of a reference.

        Args:
            reference: its integers.

        Returns:
            The object, or an array of objects.

        Raises:
            UnknownObjectError: The reference is invalid.
        """
        numbers = [int(number) for number in np.ravel(reference)[: MAX_ELEMENTS + 20]]
        if len(numbers) < 4 or numbers[0] != REFERENCE or not 0 < numbers[1] <= 8:
            raise UnknownObjectError("expected a reference to an object")
        start = 2 + numbers[1]
        ids = numbers[start:-1]
        if len(ids) == 1:
            return self._object_node(ids[0])
        return Node(elements=[self._object_node(number) for number in ids]) if ids else Node(reason="empty")

    def resolve(self, node: Node) -> Node:
        """Replace the references in a node by their objects."""
        if node.array is not None and node.array.size >= 4 and node.array.flat[0] == REFERENCE:
            return self.node(node.array.ravel(order="F"))
        if node.fields:
            return replace(node, fields={name: self.resolve(inner) for name, inner in node.fields.items()})
        return (
            replace(node, elements=[self.resolve(inner) for inner in node.elements])
            if node.elements
            else node
        )

    def _object_node(self, number: int) -> Node:
        self._objects_left -= 1
        if self._depth >= MAX_DEPTH or self._objects_left < 0:
            return Node(reason="objects within objects without an end")
        self._depth += 1
        try:
            row = self.objects[number]
            kind = self.names[int(self.classes[int(row[0])])]
            properties = self.typed_properties[int(row[3])] if row[3] else self.properties[int(row[4])]
            values = {
                self.names[name]: self.cell(value + FIRST_CELL)
                for name, what, value in properties
                if what == VALUE_IN_CELL
            }
        except IndexError as error:
            raise UnknownObjectError(f"the object {number} is not described") from error
        finally:
            self._depth -= 1
        return _make_node(kind, values)


def _iterate_properties(words: Any) -> Iterator[list[tuple[int, int, int]]]:
    """Properties of one object after another: their number, three integers for each, padding to 8 bytes."""
    position = 0
    while position < len(words):
        count = int(words[position])
        end = position + 1 + 3 * count
        if end > len(words):
            raise ValueError("properties are cut")
        yield [tuple(map(int, row)) for row in words[position + 1 : end].reshape(-1, 3)]  # type: ignore[misc]
        position = end + end % 2


def _make_node(kind: str, values: Mapping[str, Node]) -> Node:
    """Node of an object by its class: a struct, or numbers."""
    makers = {"timetable": _timetable, "table": _table, "timeseries": _timeseries}
    numbers = {"duration": "millis", "datetime": "data"}
    if kind in numbers:
        array = _array(values.get(numbers[kind]))
        return Node(reason="empty") if array is None else Node(array=array / 1000.0)
    if kind in makers:
        return makers[kind](values)
    if kind.rpartition(".")[2] == "string" or kind == "string":
        return Node(reason="text")
    if "Values" in values and "Name" in values and values["Values"].fields:  # a signal of a Simulink Dataset
        return replace(values["Values"], text=values["Name"].text)
    if kind.rpartition(".")[2] == "Dataset":
        return _dataset(values)
    return (
        Node(fields=dict(values))
        if values
        else Node(reason=f"an object of the class {kind} without properties")
    )


def _array(node: Node | None) -> FloatArray | None:
    return None if node is None or node.array is None or not node.array.size else node.array


def _timetable(values: Mapping[str, Node]) -> Node:
    kept = values.get("any", Node()).fields or values
    rows = _array(kept.get("numRows"))
    time = _row_times(kept.get("rowTimes", Node()), 0 if rows is None else int(np.nan_to_num(rows.flat[0])))
    return Node(fields={"Time": time, **_columns(kept, "varNames")})


def _table(values: Mapping[str, Node]) -> Node:
    return Node(fields=_columns(values, "varnames"))


def _columns(values: Mapping[str, Node], names: str) -> dict[str, Node]:
    columns = values.get("data", Node()).elements
    titles = [node.text for node in values.get(names, Node()).elements]
    if len(titles) != len(columns):
        titles = [f"Var{number}" for number in range(1, len(columns) + 1)]
    return dict(zip(titles, columns, strict=True))


def _row_times(times: Node, rows: int) -> Node:
    """Times of the rows: stored, or computed from start and step."""
    if not times.fields:
        return times
    rate, step, origin = (_array(times.fields.get(key)) for key in ("sampleRate", "stepSize", "origin"))
    by_rate = _array(times.fields.get("specifiedAsRate"))
    if by_rate is not None and by_rate.flat[0] and rate is not None and rate.flat[0] > 0:
        seconds = 1.0 / float(rate.flat[0])
    elif step is not None:
        seconds = float(step.flat[0])
    else:
        return Node(reason="times by the calendar; in MATLAB: TT.Time = seconds(TT.Time - TT.Time(1))")
    start = 0.0 if origin is None else float(origin.flat[0])
    return _even_times(start, seconds, rows)


def _even_times(start: float, step: float, rows: int) -> Node:
    if not 0 < rows <= MAX_ROWS or not np.isfinite([start, step]).all():
        return Node(reason="times without a start, a step or rows")
    return Node(array=np.asarray(start + step * np.arange(rows), dtype=np.float64)[:, None])


def _timeseries(values: Mapping[str, Node]) -> Node:
    """Struct of time and data, whose names depend on the version; the time may be a start and a step."""
    info = values.get("TimeInfo", values.get("TimeInfo_", Node())).fields
    stored = [values.get("Time"), values.get("Time_"), info.get("Time"), info.get("Time_")]
    time = next((node for node in stored if node is not None and _array(node) is not None), None)
    if time is None:
        start, step, length = (
            _array(info.get(f"{key}_", info.get(key))) for key in ("Start", "Increment", "Length")
        )
        if step is not None and length is not None:
            first = 0.0 if start is None else float(start.flat[0])
            time = _even_times(first, float(step.flat[0]), int(np.nan_to_num(length.flat[0])))
    data = next(
        (node for key in ("Data", "Data_") if (node := values.get(key)) and _array(node) is not None), None
    )
    if time is None or data is None:
        return Node(fields=dict(values))
    name = values.get("Name", values.get("Name_", Node())).text
    return Node(fields={"Time": time, "Data": data}, text=name)


def _dataset(values: Mapping[str, Node]) -> Node:
    """Struct of the signals of a Dataset; a cell if their names are not unique."""
    signals = [node for value in values.values() for node in _signals_in(value)]
    names = [node.text if node.text.isidentifier() else "" for node in signals]
    unique = all(names) and len(set(names)) == len(names)
    return (
        Node(fields=dict(zip(names, signals, strict=True))) if unique else Node(elements=signals, braces="{}")
    )


def _signals_in(node: Node) -> Iterator[Node]:
    if "Time" in node.fields and len(node.fields) > 1:
        yield node
    else:
        for inner in (*node.fields.values(), *node.elements):
            yield from _signals_in(inner)
