"""ROS 2 bags, by rosbags: a folder with ``metadata.yaml``, or one ``.mcap`` or ``.db3`` file of it.

A column is ``topic.field[.sub][index]``, like ``/joint_states.position[0]``; a stamp (``header.stamp``) is a
column in s of Unix time. The rows are the messages of one topic. Columns of other topics are taken at the
times of these messages.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from labhil.errors import TableError
from labhil.recording.formats.columns import Columns, the_package
from labhil.signals import FloatArray, Hold

RECEIVED = "received"
"""The column of the times at which the bag's recorder received the messages of the rows' topic, s."""

LONGEST_ARRAY = 64
"""Longer arrays (images, point clouds) are no columns."""

LONGEST_GAP = 100.0
"""Median steps of another topic; nothing is taken between messages that are further apart."""

_STEP = re.compile(r"\[(\d+)\]|\.?([^.\[\]]+)")

Way = tuple[str | int, ...]
"""How to get from a message to a number: names of fields and places in arrays."""


@dataclass(frozen=True)
class _Topic:
    """The messages of one topic: ``stamps`` (n,) of their headers, ``received`` (n,), s of Unix time."""

    received: FloatArray
    stamps: FloatArray | None
    values: Mapping[Way, FloatArray]


@dataclass(frozen=True)
class BagColumns(Columns):
    """Columns of a bag, at the times of the messages of the topic ``base``."""

    places: tuple[tuple[str, Way], ...]
    base: str
    topics: Mapping[str, _Topic]
    used: set[str] = field(default_factory=set)

    row_word = "message"

    @property
    def notes(self) -> tuple[str, ...]:
        """Which topic gives the rows and which clock the time, and what was taken from other topics."""
        clock = "the stamps in their headers" if self._stamped else "the times at which the bag received them"
        others = tuple(
            f"{name} is another topic: its values are taken at the times of {self.base}"
            for name in sorted(self.used)
        )
        return (f"rows are the messages of {self.base}; without a channel t the time is {clock}", *others)

    def find(self, source: str) -> tuple[int, ...]:
        """The numbers of the columns that bear this name; the first slash and ``.0`` for ``[0]`` are free."""
        wanted = _plain(source)
        return tuple(place for place, name in enumerate(self.names or ()) if _plain(name) == wanted)

    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """The values of a column, shape (rows,); NaN where there is none.

        Between two messages of another topic the value goes along the straight line or is held.
        """
        base = self.topics[self.base]
        name, way = self.places[column]
        if not name:
            return base.received if way == (RECEIVED,) else self._times(base)
        topic = self.topics[name]
        if name == self.base:
            return topic.values[way]
        self.used.add(name)
        return _taken_at(self._times(base), self._times(topic), topic.values[way], hold)

    def text(self, column: int, row: int) -> str:
        """What stands there, for messages."""
        return f"{self.numbers(column)[row]}"

    @property
    def _stamped(self) -> bool:
        return self.topics[self.base].stamps is not None

    def _times(self, topic: _Topic) -> FloatArray:
        return topic.stamps if self._stamped and topic.stamps is not None else topic.received


def read_bag(path: Path, wanted: Sequence[str]) -> BagColumns:
    """Read the topics that ``wanted`` columns stand in; the first of them gives the rows.

    TableError when the bag cannot be read or is empty.
    """
    purpose = f"{path}: a ROS 2 bag"
    highlevel = the_package("rosbags.highlevel", "rosbags", purpose)
    typesys = the_package("rosbags.typesys", "rosbags", purpose)
    store = typesys.get_typestore(typesys.Stores.LATEST)
    try:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            return _read(path, reader, wanted)
    except TableError:
        raise
    except Exception as error:  # rosbags, its YAML, SQLite and decompression each raise their own
        hint = "; `labhil recover` may save what is whole" if path.suffix == ".mcap" else ""
        raise TableError(
            f"{path}: expected a ROS 2 bag, found one that cannot be read: {error}{hint}"
        ) from error


def _read(path: Path, reader: Any, wanted: Sequence[str]) -> BagColumns:
    ways = {
        connection.topic: tuple(_walk(_first(reader, connection), ()))
        for connection in reader.connections
        if connection.msgcount
    }
    places = [(topic, way) for topic, inner in ways.items() for way in inner]
    names = [_name(topic, way) for topic, way in places]
    if not places:
        raise TableError(f"{path}: expected a bag with messages that hold numbers, found none")
    plain = {_plain(name): topic for name, (topic, _) in zip(names, places, strict=True)}
    needed = [plain[_plain(name)] for name in wanted if _plain(name) in plain] or [places[0][0]]
    topics = {topic: _read_topic(reader, topic, ways[topic]) for topic in dict.fromkeys(needed)}
    rows = len(topics[needed[0]].received)
    own: list[tuple[str, Way]] = [("", ("t",)), ("", (RECEIVED,))]
    return BagColumns(
        names=("t", RECEIVED, *names),
        width=len(names) + 2,
        lines=np.arange(1, rows + 1),
        counts=np.full(rows, len(names) + 2),
        places=tuple(own + places),
        base=needed[0],
        topics=topics,
    )


def _first(reader: Any, connection: Any) -> Any:
    _, _, raw = next(iter(reader.messages([connection])))
    return reader.deserialize(raw, connection.msgtype)


def _read_topic(reader: Any, topic: str, ways: Sequence[Way]) -> _Topic:
    connections = [connection for connection in reader.connections if connection.topic == topic]
    received, rows = [], []
    for connection, time_ns, raw in reader.messages(connections):
        message = reader.deserialize(raw, connection.msgtype)
        received.append(time_ns)
        rows.append([_number_at(message, way) for way in ways])
    table = np.array(rows, dtype=np.float64)
    values: dict[Way, FloatArray] = dict(zip(ways, table.T, strict=True))
    stamps = values.get(("header", "stamp"))
    if stamps is not None and not (stamps > 0).all():
        stamps = None  # nobody filled them in
    return _Topic(np.array(received, dtype=np.float64) * 1e-9, stamps, values)


def _walk(value: Any, way: Way) -> Iterator[Way]:
    """All ways to numbers in a message."""
    if isinstance(value, (bool, int, float, np.number, np.bool_)) or _is_stamp(value):
        yield way
    elif isinstance(value, (list, np.ndarray)):
        for place in range(len(value) if len(value) <= LONGEST_ARRAY else 0):
            yield from _walk(value[place], (*way, place))
    elif dataclasses.is_dataclass(value):
        for part in dataclasses.fields(value):
            yield from _walk(getattr(value, part.name), (*way, part.name))


def _is_stamp(value: Any) -> bool:
    return hasattr(value, "sec") and hasattr(value, "nanosec")


def _number_at(message: Any, way: Way) -> float:
    value = message
    try:
        for step in way:
            value = value[step] if isinstance(step, int) else getattr(value, step)
        return value.sec + 1e-9 * value.nanosec if _is_stamp(value) else float(value)
    except (IndexError, AttributeError, TypeError):
        return float("nan")  # an array may be shorter in one message than in another


def _name(topic: str, way: Way) -> str:
    return topic + "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in way)


def _plain(name: str) -> str:
    """A column's name without what may be written in two ways."""
    topic, dot, rest = name.partition(".")
    steps = [index or part for index, part in _STEP.findall(rest)]
    return ".".join((topic.lstrip("/"), *steps)) if dot else name


def _taken_at(at: FloatArray, times: FloatArray, values: FloatArray, hold: Hold) -> FloatArray:
    """The values of another topic at the times ``at``; NaN outside of it and in its gaps."""
    order = np.argsort(times, kind="stable")
    times, values = times[order], values[order]
    taken = np.full(len(at), np.nan)
    if len(times) < 2:
        return taken
    before = np.searchsorted(times, at, side="right") - 1
    inside = (before >= 0) & (at <= times[-1])
    left = np.clip(before, 0, len(times) - 2)
    step = times[left + 1] - times[left]
    rising = np.diff(times)
    inside &= step <= LONGEST_GAP * np.median(rising[rising > 0]) if (rising > 0).any() else False
    held = values[np.clip(before, 0, len(times) - 1)]
    share = np.divide(at - times[left], step, out=np.zeros_like(at), where=step > 0)
    line = values[left] + share * (values[left + 1] - values[left])
    taken[inside] = (held if hold is Hold.ZERO else line)[inside]
    return taken
