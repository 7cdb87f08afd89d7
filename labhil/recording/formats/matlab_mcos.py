"""Objects of MATLAB's own classes in MAT files: what MATLAB keeps of them, as structs.

A file with objects has a part of its own ("subsystem") with one cell array for all of them. Its first cell
says in whole numbers which class each object has, and which cell holds each property. A timetable and a table
become what a struct of columns is; so do timeseries, and the signals of a Simulink Dataset by their names.
Times become s. Of all other classes the properties are followed by their names.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from labhil.recording.formats.matlab_objects import REFERENCE
from labhil.recording.formats.variables import MOST_PARTS, Part
from labhil.signals import FloatArray

SAVED = 1
"""The kind of a property whose value stands in a cell."""

FIRST_CELL = 2
"""The cell of the property with the number 0: metadata and an empty cell stand before."""

DEEPEST = 16
MOST_OBJECTS = 10_000
MOST_ROWS = 1 << 26
"""Rows of a timetable whose times are not stored."""


class UnknownObjectError(ValueError):
    """What stands for an object leads nowhere."""


@dataclass
class Objects:
    """The objects of a file: ``metadata``, and ``cell`` that gives the content of a cell by its number."""

    metadata: bytes
    cell: Callable[[int], Part]
    order: str = "<"
    _depth: int = field(default=0, init=False)
    _left: int = field(default=MOST_OBJECTS, init=False)

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
        self.saved_otherwise = list(_blocks(words[offsets[1] // 4 : offsets[2] // 4]))
        self.saved = list(_blocks(words[offsets[3] // 4 : offsets[4] // 4]))

    def part(self, reference: Any) -> Part:
        """What the objects are that whole numbers stand for.

        Raises:
            UnknownObjectError: They stand for none.
        """
        numbers = [int(number) for number in np.ravel(reference)[: MOST_PARTS + 20]]
        if len(numbers) < 4 or numbers[0] != REFERENCE or not 0 < numbers[1] <= 8:
            raise UnknownObjectError("expected a reference to an object")
        start = 2 + numbers[1]
        ids = numbers[start:-1]
        if len(ids) == 1:
            return self._object(ids[0])
        return Part(elements=[self._object(number) for number in ids]) if ids else Part(reason="empty")

    def resolved(self, part: Part) -> Part:
        """A part in which references to objects are these objects."""
        if part.array is not None and part.array.size >= 4 and part.array.flat[0] == REFERENCE:
            return self.part(part.array.ravel(order="F"))
        if part.fields:
            return replace(part, fields={name: self.resolved(inner) for name, inner in part.fields.items()})
        return (
            replace(part, elements=[self.resolved(inner) for inner in part.elements])
            if part.elements
            else part
        )

    def _object(self, number: int) -> Part:
        self._left -= 1
        if self._depth >= DEEPEST or self._left < 0:
            return Part(reason="objects within objects without an end")
        self._depth += 1
        try:
            row = self.objects[number]
            kind = self.names[int(self.classes[int(row[0])])]
            properties = self.saved_otherwise[int(row[3])] if row[3] else self.saved[int(row[4])]
            values = {
                self.names[name]: self.cell(value + FIRST_CELL)
                for name, what, value in properties
                if what == SAVED
            }
        except IndexError as error:
            raise UnknownObjectError(f"the object {number} is not described") from error
        finally:
            self._depth -= 1
        return _as_struct(kind, values)


def _blocks(words: Any) -> Iterator[list[tuple[int, int, int]]]:
    """Properties of one object after another: how many, three numbers for each, then on to eight bytes."""
    position = 0
    while position < len(words):
        count = int(words[position])
        end = position + 1 + 3 * count
        if end > len(words):
            raise ValueError("properties are cut")
        yield [tuple(map(int, row)) for row in words[position + 1 : end].reshape(-1, 3)]  # type: ignore[misc]
        position = end + end % 2


def _as_struct(kind: str, values: Mapping[str, Part]) -> Part:
    """An object as a struct, or as the numbers that it is."""
    makers = {"timetable": _timetable, "table": _table, "timeseries": _timeseries}
    numbers = {"duration": "millis", "datetime": "data"}
    if kind in numbers:
        array = _array(values.get(numbers[kind]))
        return Part(reason="empty") if array is None else Part(array=array / 1000.0)
    if kind in makers:
        return makers[kind](values)
    if kind.rpartition(".")[2] == "string" or kind == "string":
        return Part(reason="text")
    if "Values" in values and "Name" in values and values["Values"].fields:  # a signal of a Simulink Dataset
        return replace(values["Values"], text=values["Name"].text)
    if kind.rpartition(".")[2] == "Dataset":
        return _dataset(values)
    return (
        Part(fields=dict(values))
        if values
        else Part(reason=f"an object of the class {kind} without properties")
    )


def _array(part: Part | None) -> FloatArray | None:
    return None if part is None or part.array is None or not part.array.size else part.array


def _timetable(values: Mapping[str, Part]) -> Part:
    kept = values.get("any", Part()).fields or values
    rows = _array(kept.get("numRows"))
    time = _row_times(kept.get("rowTimes", Part()), 0 if rows is None else int(np.nan_to_num(rows.flat[0])))
    return Part(fields={"Time": time, **_columns(kept, "varNames")})


def _table(values: Mapping[str, Part]) -> Part:
    return Part(fields=_columns(values, "varnames"))


def _columns(values: Mapping[str, Part], names: str) -> dict[str, Part]:
    columns = values.get("data", Part()).elements
    titles = [part.text for part in values.get(names, Part()).elements]
    if len(titles) != len(columns):
        titles = [f"Var{number}" for number in range(1, len(columns) + 1)]
    return dict(zip(titles, columns, strict=True))


def _row_times(times: Part, rows: int) -> Part:
    """Stored times, or those that start and step give."""
    if not times.fields:
        return times
    rate, step, origin = (_array(times.fields.get(key)) for key in ("sampleRate", "stepSize", "origin"))
    by_rate = _array(times.fields.get("specifiedAsRate"))
    if by_rate is not None and by_rate.flat[0] and rate is not None and rate.flat[0] > 0:
        seconds = 1.0 / float(rate.flat[0])
    elif step is not None:
        seconds = float(step.flat[0])
    else:
        return Part(reason="times by the calendar; in MATLAB: TT.Time = seconds(TT.Time - TT.Time(1))")
    start = 0.0 if origin is None else float(origin.flat[0])
    return _even(start, seconds, rows)


def _even(start: float, step: float, rows: int) -> Part:
    if not 0 < rows <= MOST_ROWS or not np.isfinite([start, step]).all():
        return Part(reason="times without a start, a step or rows")
    return Part(array=np.asarray(start + step * np.arange(rows), dtype=np.float64)[:, None])


def _timeseries(values: Mapping[str, Part]) -> Part:
    """Time and data, whatever the version called them; the time may be a start and a step."""
    told = values.get("TimeInfo", values.get("TimeInfo_", Part())).fields
    stored = [values.get("Time"), values.get("Time_"), told.get("Time"), told.get("Time_")]
    time = next((part for part in stored if part is not None and _array(part) is not None), None)
    if time is None:
        start, step, length = (
            _array(told.get(f"{key}_", told.get(key))) for key in ("Start", "Increment", "Length")
        )
        if step is not None and length is not None:
            first = 0.0 if start is None else float(start.flat[0])
            time = _even(first, float(step.flat[0]), int(np.nan_to_num(length.flat[0])))
    data = next(
        (part for key in ("Data", "Data_") if (part := values.get(key)) and _array(part) is not None), None
    )
    if time is None or data is None:
        return Part(fields=dict(values))
    name = values.get("Name", values.get("Name_", Part())).text
    return Part(fields={"Time": time, "Data": data}, text=name)


def _dataset(values: Mapping[str, Part]) -> Part:
    """The signals of a Dataset by their names, or by their places where they have none of their own."""
    signals = [part for value in values.values() for part in _signals_in(value)]
    names = [part.text if part.text.isidentifier() else "" for part in signals]
    unique = all(names) and len(set(names)) == len(names)
    return (
        Part(fields=dict(zip(names, signals, strict=True))) if unique else Part(elements=signals, braces="{}")
    )


def _signals_in(part: Part) -> Iterator[Part]:
    if "Time" in part.fields and len(part.fields) > 1:
        yield part
    else:
        for inner in (*part.fields.values(), *part.elements):
            yield from _signals_in(inner)
