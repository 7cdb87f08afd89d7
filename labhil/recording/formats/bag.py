"""ROS 2 bags, by rosbags: a folder with ``metadata.yaml``, or one ``.mcap`` or ``.db3`` file of it.

A column is ``topic.field[.sub][index]``, like ``/wheels.speed[0]``, or ``topic.field.name`` where a message
names the elements of its arrays, like ``/joint_states.position.elbow_joint``; a stamp (``header.stamp``) is a
column in s of Unix time. The rows are the messages of one topic, or of one of its publishers where they name
other joints. Columns of others are taken at the times of these messages.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from labhil.errors import TableError
from labhil.extras import load_optional
from labhil.recording.formats.bag_messages import STAMP, Named, Source, Way, numbers_in, sources_of
from labhil.recording.formats.columns import Columns
from labhil.signals import FloatArray, Hold

RECEIVED = "received"
"""The column of the times at which the bag's recorder received the messages of the rows' topic, s."""

TIMES = ("t", "time", "timestamp")
"""Names that stand for the time of the rows, whatever the fields of a message are called."""

LONGEST_GAP = 100.0
"""Median steps of another topic; nothing is taken between messages that are further apart."""

MOST_NAMES = 12
"""Names of joints that a message lists."""

_STEP = re.compile(r"\[([^\[\]]+)\]|\.?([^.\[\]]+)")


@dataclass(frozen=True)
class BagColumns(Columns):
    """Columns of a bag, at the times of the messages of ``base``, the first of its ``sources``.

    ``places`` says of each column in which of the sources it stands (None: not read) and the way there;
    ``numbered`` which column a place in an array of named elements is, by its plain name; ``refused`` why
    one is none.
    """

    path: Path
    places: tuple[tuple[int | None, Way], ...]
    sources: tuple[Source, ...]
    numbered: Mapping[str, int]
    refused: Mapping[str, str]
    used: set[str] = field(default_factory=set)

    row_word = "message"
    receiver = "the bag"
    """What stamped the messages, for messages."""
    bare_paths = False
    """Whether a column that only one topic has is found without the topic."""

    @property
    def base(self) -> Source:
        """The messages that give the rows."""
        return self.sources[0]

    @property
    def notes(self) -> tuple[str, ...]:
        """Which messages give the rows and which clock the time, and what was taken from others."""
        in_messages = "the stamps in their headers"
        if self.base.clock != STAMP:
            in_messages = f"their {'.'.join(map(str, self.base.clock))}"
        received = f"the times at which {self.receiver} received them"
        clock = in_messages if self._has_stamps else received
        other_sources = tuple(
            f"{len(source.rows)} messages of {source.topic} are no rows: "
            f"they name {_list_names(source.names)}"
            for source in self.sources[1:]
            if source.topic == self.base.topic
        )
        resampled = tuple(
            f"{name} is another topic: its values are taken at the times of {self.base.topic}"
            for name in sorted(self.used)
        )
        rows = f"rows are the messages of {self.base.topic}{_with_names(self.base) if other_sources else ''}"
        return (f"{rows}; without a channel t the time is {clock}", *other_sources, *resampled)

    def find(self, source: str) -> tuple[int, ...]:
        """The numbers of the columns that bear this name; the first slash and ``.0`` for ``[0]`` are free.

        TableError for a place in an array whose elements change places.
        """
        plain = _plain(source)
        places = tuple(place for place, name in enumerate(self.names or ()) if _plain(name) == plain)
        if places:
            return places
        if plain in self.refused:
            raise TableError(f"{self.path}: {source}: {self.refused[plain]}")
        if plain in self.numbered or not self.bare_paths:
            return (self.numbered[plain],) if plain in self.numbered else ()
        ways = [way for _, way in self.places]
        return tuple(place for place, way in enumerate(ways) if way and _is_bare(source, way))

    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """The values of a column, shape (rows,); NaN where there is none.

        Between two messages of another topic the value goes along the straight line or is held.
        """
        place, way = self.places[column]
        if not way:
            return self._times(self.base)
        if way == (RECEIVED,):
            return self.base.received
        if place is None:
            name = (self.names or ())[column]
            raise TableError(f"{self.path}: column {column}: expected a name in [channels], such as {name!r}")
        source = self.sources[place]
        if place == 0:
            return source.values[way]
        names = _with_names(source) if source.topic == self.base.topic else ""
        self.used.add(f"{source.topic}{names}")
        return _resample(self._times(self.base), self._times(source), source.values[way], hold)

    def text(self, column: int, row: int) -> str:
        """What stands there, for messages."""
        return f"{self.numbers(column)[row]}"

    @property
    def _has_stamps(self) -> bool:
        return self.base.stamps is not None

    def _times(self, source: Source) -> FloatArray:
        stamps = source.stamps if self._has_stamps else None
        return source.received if stamps is None else stamps


def read_bag(path: Path, wanted: Sequence[str]) -> BagColumns:
    """Read the topics that ``wanted`` columns stand in; the first of them gives the rows.

    TableError when the bag cannot be read or is empty.
    """
    purpose = f"{path}: a ROS 2 bag"
    highlevel = load_optional("rosbags.highlevel", purpose)
    typesys = load_optional("rosbags.typesys", purpose)
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
    first = {c.topic: _first(reader, c) for c in reversed(reader.connections) if c.msgcount}
    return bag_columns(path, first, lambda topic: _messages(reader, topic), wanted)


def bag_columns(
    path: Path,
    first: Mapping[str, Any],
    messages: Callable[[str], Iterable[tuple[int, Any]]],
    wanted: Sequence[str],
    *,
    clocks: Mapping[str, Way] | None = None,
    kind: type[BagColumns] = BagColumns,
    what: str = "a bag",
) -> BagColumns:
    """Make columns of topics.

    Args:
        path: The file, for messages.
        first: A message of each topic.
        messages: Gives all messages of a topic, each with the time (ns, Unix) at which it was received.
        wanted: The columns that are asked for; the topic of the first gives the rows.
        clocks: The way to the stamp in the messages of a topic; ``header.stamp`` where it is missing.
        kind: The class of the columns.
        what: The kind of file, for messages.

    Raises:
        TableError: No message holds a number.
    """
    listed = [(topic, way) for topic, message in first.items() for way, _ in numbers_in(message)]
    if not listed:
        raise TableError(f"{path}: expected {what} with messages that hold numbers, found none")
    needed = topics_of(wanted, listed, kind.bare_paths) or [listed[0][0]]
    read = [
        source
        for topic in needed
        for source in sources_of(topic, messages(topic), (clocks or {}).get(topic, STAMP))
    ]
    return columns_of(path, read, wanted, listed=listed, kind=kind)


def columns_of(
    path: Path,
    read: Sequence[Source],
    wanted: Sequence[str],
    *,
    listed: Sequence[tuple[str, Way]] = (),
    kind: type[BagColumns] = BagColumns,
) -> BagColumns:
    """Make columns of sources, of which those of the first topic may give the rows.

    Args:
        path: The file, for messages.
        read: The sources.
        wanted: The columns that are asked for.
        listed: Topics and ways of numbers, of which those of other topics are named but not read.
        kind: The class of the columns.
    """
    base = _base(read, [_plain(name) for name in wanted])
    sources = [base, *(source for source in read if source is not base)]
    places: dict[str, tuple[int | None, Way]] = {"t": (None, ()), RECEIVED: (None, (RECEIVED,))}
    for place, source in enumerate(sources):
        for way in source.values:
            places.setdefault(_name(source.topic, way), (place, way))
    read_topics = {source.topic for source in sources}
    for topic, way in listed:
        if topic not in read_topics:
            places.setdefault(_name(topic, way), (None, way))
    names = tuple(places)
    return kind(
        names=names,
        width=len(names),
        lines=base.rows + 1,
        counts=np.full(len(base.rows), len(names)),
        path=path,
        places=tuple(places.values()),
        sources=tuple(sources),
        numbered={plain: names.index(name) for plain, name in _numbered_names(sources)},
        refused=dict(_refusals(sources)),
    )


def topics_of(wanted: Sequence[str], listed: Sequence[tuple[str, Way]], bare_paths: bool) -> list[str]:
    """The topics that columns stand in, in the order of the columns; of several that fit the longest."""
    topics = {_plain(topic).lstrip("/"): topic for topic, _ in reversed(listed)}
    needed: dict[str, None] = {}
    for name in wanted:
        beginnings = [topics[plain] for plain in topics if f"{_plain(name)}.".startswith(f"{plain}.")]
        if beginnings:
            needed[max(beginnings, key=len)] = None
        elif bare_paths:
            needed |= {topic: None for topic, way in listed if _is_bare(name, way)}
    return list(needed)


def _is_bare(name: str, way: Way) -> bool:
    """Whether a column's name is the way to a number, without a topic. The time has a way of its own."""
    steps = [step.name if isinstance(step, Named) else str(step) for step in way]
    return name not in (*TIMES, RECEIVED) and _steps(name) == steps


def _steps(path: str) -> list[str]:
    return [index or part for index, part in _STEP.findall(path)]


def _first(reader: Any, connection: Any) -> Any:
    _, _, raw = next(iter(reader.messages([connection])))
    return reader.deserialize(raw, connection.msgtype)


def _messages(reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    connections = [connection for connection in reader.connections if connection.topic == topic]
    for connection, time_ns, raw in reader.messages(connections):
        yield time_ns, reader.deserialize(raw, connection.msgtype)


def _base(sources: Sequence[Source], wanted: Sequence[str]) -> Source:
    """The source that gives the rows: of the first topic, and there of the first name that only one has."""
    candidates = [source for source in sources if source.topic == sources[0].topic]
    for name in wanted:
        matching = [
            candidate
            for candidate in candidates
            if any(_plain(_name(candidate.topic, way)) == name for way in candidate.values)
        ]
        if len(matching) == 1:
            return matching[0]
    return candidates[0]


def _by_place(source: Source) -> Iterator[tuple[str, str]]:
    """Of every array of named elements the plain name of a place in it, and the column it may mean."""
    for way in source.values:
        index = next((k for k, step in enumerate(way) if isinstance(step, Named)), None)
        if index is None:
            continue
        label = way[index]
        for labels in source.orders:
            if isinstance(label, Named) and label.name in labels:
                place = (*way[:index], labels.index(label.name), *way[index + 1 :])
                yield _plain(_name(source.topic, place)), _name(source.topic, way)


def _orders(sources: Sequence[Source], topic: str) -> dict[tuple[str, ...], int]:
    return {labels: n for source in sources if source.topic == topic for labels, n in source.orders.items()}


def _numbered_names(sources: Sequence[Source]) -> Iterator[tuple[str, str]]:
    """Places in arrays of named elements that mean one column, as the names never change places."""
    for source in sources:
        if len(_orders(sources, source.topic)) == 1:
            yield from _by_place(source)


def _refusals(sources: Sequence[Source]) -> Iterator[tuple[str, str]]:
    """Places in arrays of named elements that mean now one column, now another, and why."""
    for source in sources:
        orders = _orders(sources, source.topic)
        if len(orders) == 1:
            continue
        counts = "; ".join(
            f"{_list_names(labels) or 'no names'} in {n} messages" for labels, n in orders.items()
        )
        for plain, name in _by_place(source):
            yield (
                plain,
                f"expected a name, since the elements change places: {counts}; write the column as {name!r}",
            )


def _list_names(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return f"{', '.join(names[:MOST_NAMES])}{more}"


def _with_names(source: Source) -> str:
    return f" with {_list_names(source.names)}" if source.names else ""


def _name(topic: str, way: Way) -> str:
    steps = (f"[{s}]" if isinstance(s, int) else f".{s.name if isinstance(s, Named) else s}" for s in way)
    return topic + "".join(steps)


def _plain(name: str) -> str:
    """A column's name without what may be written in two ways."""
    topic, dot, rest = name.partition(".")
    return ".".join((topic.lstrip("/"), *_steps(rest))) if dot else name


def _resample(t: FloatArray, times: FloatArray, values: FloatArray, hold: Hold) -> FloatArray:
    """The values of another topic at the times ``at``; NaN outside of it and in its gaps."""
    order = np.argsort(times, kind="stable")
    times, values = times[order], values[order]
    resampled = np.full(len(t), np.nan)
    if len(times) < 2:
        return resampled
    before = np.searchsorted(times, t, side="right") - 1
    inside = (before >= 0) & (t <= times[-1])
    begin = np.clip(before, 0, len(times) - 2)
    step = times[begin + 1] - times[begin]
    rising = np.diff(times)
    inside &= step <= LONGEST_GAP * np.median(rising[rising > 0]) if (rising > 0).any() else False
    held = values[np.clip(before, 0, len(times) - 1)]
    share = np.divide(t - times[begin], step, out=np.zeros_like(t), where=step > 0)
    line = values[begin] + share * (values[begin + 1] - values[begin])
    resampled[inside] = (held if hold is Hold.ZERO else line)[inside]
    return resampled
