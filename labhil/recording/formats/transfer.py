"""Serialisation of tables between processes without pickle, so that data cannot execute code.

Arrays are bytes, everything else is JSON, from which only the classes below are constructed.
"""

from __future__ import annotations

import dataclasses
import json
import struct
from collections.abc import Callable, Mapping
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labhil.recording.formats.bag import BagColumns
from labhil.recording.formats.bag_messages import MessageGroup, Named
from labhil.recording.formats.columns import NumberColumns
from labhil.recording.formats.lerobot import LerobotColumns
from labhil.recording.formats.mcap_file import McapColumns
from labhil.recording.formats.notation import Notation
from labhil.recording.formats.npz import SysidColumns
from labhil.recording.formats.variables import VariableColumns
from labhil.recording.formats.workbook import SheetColumns

HEAD = struct.Struct("<QQ")
"""Head of an answer: sizes of its JSON and of the arrays that follow, bytes."""

_CLASSES = {
    kind.__name__: kind
    for kind in (
        NumberColumns,
        VariableColumns,
        SheetColumns,
        Notation,
        BagColumns,
        McapColumns,
        LerobotColumns,
        SysidColumns,
        MessageGroup,
        Named,
    )
}
_DTYPES = ("<f8", "<i8", "|b1")
_CELLS: dict[str, Callable[[Any], Any]] = {
    "datetime": datetime.fromisoformat,
    "time": time.fromisoformat,
    "path": Path,
    "timedelta": lambda seconds: timedelta(seconds=seconds),
}
_COLLECTIONS: dict[str, Callable[[Any], Any]] = {"tuple": tuple, "set": set}


def pack(answer: dict[str, Any]) -> bytes:
    """Serialise an answer, with the table under ``columns`` if it has one."""
    arrays = _Arrays()
    if "columns" in answer:
        answer = {**answer, "columns": _to_json(answer["columns"], arrays)}
    text = json.dumps(answer, default=_cell_to_json).encode()
    return b"".join([HEAD.pack(len(text), arrays.length), text, *arrays.pieces])


def parse_answer(text: bytes) -> dict[str, Any]:
    """Parse the JSON of an answer, with paths and cells of workbooks as Python objects."""
    answer: dict[str, Any] = json.loads(text, object_hook=_cell_from_json)
    return answer


def unpack_columns(data: Any, arrays: bytes) -> Any:
    """Restore the table of an answer from its JSON and the bytes of its arrays."""
    if isinstance(data, list):
        tagged = any(isinstance(item, dict) for item in data)
        return [unpack_columns(item, arrays) for item in data] if tagged else data
    if not isinstance(data, dict):
        return data
    ((tag, value),) = data.items()
    if tag == "array":
        dtype, shape, start = value
        count = int(np.prod(shape, dtype=np.int64))
        return np.frombuffer(arrays, dtype, count, start).reshape(shape).copy()
    if tag in _COLLECTIONS:
        return _COLLECTIONS[tag](unpack_columns(item, arrays) for item in value)
    pairs = {unpack_columns(name, arrays): unpack_columns(item, arrays) for name, item in value}
    return pairs if tag == "map" else _CLASSES[tag](**pairs)


@dataclasses.dataclass(slots=True)
class _Arrays:
    pieces: list[bytes] = dataclasses.field(default_factory=list)
    length: int = 0

    def add(self, array: NDArray[Any]) -> dict[str, Any]:
        """Store the bytes of an array; returns its type, shape and position as JSON."""
        if array.dtype.str not in _DTYPES:
            raise TypeError(f"expected an array of numbers, found one of {array.dtype}")
        start = self.length
        self.pieces.append(np.ascontiguousarray(array).tobytes())
        self.length += len(self.pieces[-1])
        return {"array": [array.dtype.str, array.shape, start]}


def _to_json(value: Any, arrays: _Arrays) -> Any:
    if isinstance(value, np.ndarray):
        return arrays.add(value)
    if dataclasses.is_dataclass(value):
        fields = [(item.name, getattr(value, item.name)) for item in dataclasses.fields(value)]
        return {type(value).__name__: [[name, _to_json(item, arrays)] for name, item in fields]}
    if isinstance(value, Mapping):
        return {"map": [[_to_json(key, arrays), _to_json(item, arrays)] for key, item in value.items()]}
    if isinstance(value, (tuple, set)):
        return {type(value).__name__: [_to_json(item, arrays) for item in value]}
    if isinstance(value, list) and any(isinstance(item, np.ndarray) for item in value):
        return [_to_json(item, arrays) for item in value]
    return value  # text, numbers and lists of cells


def _cell_to_json(value: Any) -> Any:
    """JSON of a cell that is no JSON type."""
    if isinstance(value, (datetime, time)):
        return {"datetime" if isinstance(value, datetime) else "time": value.isoformat()}
    if isinstance(value, Path):
        return {"path": str(value)}
    if isinstance(value, timedelta):
        return {"timedelta": value.total_seconds()}
    return str(value)


def _cell_from_json(data: dict[str, Any]) -> Any:
    if len(data) == 1:
        ((tag, value),) = data.items()
        if tag in _CELLS:
            return _CELLS[tag](value)
    return data
