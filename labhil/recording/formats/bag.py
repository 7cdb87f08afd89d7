"""Reader of ROS 2 bags, by rosbags: a folder with ``metadata.yaml``, or one of its ``.mcap``/``.db3`` files.

A column is named ``topic.field[.sub][index]``, like ``/wheels.speed[0]``, or ``topic.field.name`` if the
message names the elements of its arrays, like ``/joint_states.position.elbow_joint``. A stamp
(``header.stamp``) is a column in s of Unix time. The rows are the messages of one topic, or of one of its
publishers if these name different joints. Other topics are resampled at the times of these messages.
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
from labhil.recording.formats.bag_messages import (
    STAMP,
    FieldPath,
    MessageGroup,
    Named,
    group_messages,
    iterate_numbers,
)
from labhil.recording.formats.columns import Columns
from labhil.signals import FloatArray, Hold

RECEIVED = "received"
"""Column of the times at which the bag's recorder received the rows, s of Unix time."""

TIME_NAMES = ("t", "time", "timestamp")
"""Names of the time of the rows, even if a message has fields with these names."""

MAX_NAMES = 12
"""Number of joints that an error message lists."""

_STEP = re.compile(r"\[([^\[\]]+)\]|\.?([^.\[\]]+)")


@dataclass(frozen=True)
class BagColumns(Columns):
    """Columns of a bag; its rows are the first group of messages.

    Attributes:
        path: the bag.
        locations: group (None: not read) and path inside a message of each column.
        groups: groups of messages.
        indexed: column of an array index, ``topic.field.2``, where the elements of the array have names.
        ambiguous: why an array index is no column.
        used: topics that were resampled.
        receiver: what stamped the messages on reception, for messages.
        bare_paths: whether columns are also found without their topic, if only one topic has them.
    """

    path: Path
    locations: tuple[tuple[int | None, FieldPath], ...]
    groups: tuple[MessageGroup, ...]
    indexed: Mapping[str, int]
    ambiguous: Mapping[str, str]
    used: set[str] = field(default_factory=set)

    row_word = "message"
    receiver = "the bag"
    bare_paths = False

    @property
    def base(self) -> MessageGroup:
        """Messages that are the rows."""
        return self.groups[0]

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about the choice of rows, their clock, and resampled topics."""
        stamps = "the stamps in their headers"
        if self.base.clock != STAMP:
            stamps = f"their {'.'.join(map(str, self.base.clock))}"
        clock = stamps if self._has_stamps else f"the times at which {self.receiver} received them"
        other_groups = tuple(
            f"{len(group.rows)} messages of {group.topic} are no rows: they name {_list_names(group.names)}"
            for group in self.groups[1:]
            if group.topic == self.base.topic
        )
        resampled = tuple(
            f"{name} is another topic: its values are taken at the times of {self.base.topic}"
            for name in sorted(self.used)
        )
        rows = f"rows are the messages of {self.base.topic}{_format_names(self.base) if other_groups else ''}"
        return (f"{rows}; without a channel t the time is {clock}", *other_groups, *resampled)

    def find(self, name: str) -> tuple[int, ...]:
        """Find columns by name, with or without the first slash, and with ``.0`` for ``[0]``.

        Raises:
            TableError: The name is an index into an array whose elements change their order.
        """
        wanted = _normalise(name)
        indices = tuple(index for index, known in enumerate(self.names or ()) if _normalise(known) == wanted)
        if indices:
            return indices
        if wanted in self.ambiguous:
            raise TableError(f"{self.path}: {name}: {self.ambiguous[wanted]}")
        if wanted in self.indexed or not self.bare_paths:
            return (self.indexed[wanted],) if wanted in self.indexed else ()
        paths = [steps for _, steps in self.locations]
        return tuple(index for index, steps in enumerate(paths) if steps and _is_bare_path(name, steps))

    def numbers(self, column: int, hold: Hold = Hold.LINEAR) -> FloatArray:
        """Values (rows,) of a column, another topic's interpolated by ``hold``; NaN where there is none."""
        number, field_path = self.locations[column]
        if not field_path:
            return self._times(self.base)
        if field_path == (RECEIVED,):
            return self.base.received
        if number is None:
            name = (self.names or ())[column]
            raise TableError(f"{self.path}: column {column}: expected a name in [channels], such as {name!r}")
        group = self.groups[number]
        if number == 0:
            return group.values[field_path]
        names = _format_names(group) if group.topic == self.base.topic else ""
        self.used.add(f"{group.topic}{names}")
        return _resample(self._times(self.base), self._times(group), group.values[field_path], hold)

    def text(self, column: int, row: int) -> str:
        """Content of a cell, for messages."""
        return f"{self.numbers(column)[row]}"

    @property
    def _has_stamps(self) -> bool:
        return self.base.stamps is not None

    def _times(self, group: MessageGroup) -> FloatArray:
        stamps = group.stamps if self._has_stamps else None
        return group.received if stamps is None else stamps


def read_bag(path: Path, wanted: Sequence[str]) -> BagColumns:
    """Read the topics of some columns of a bag.

    Args:
        path: the bag.
        wanted: names of columns; the topic of the first one is the rows.

    Returns:
        The table.

    Raises:
        TableError: The bag cannot be read or is empty.
        MissingExtraError: rosbags is not installed.
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
    first = {c.topic: _first_message(reader, c) for c in reversed(reader.connections) if c.msgcount}
    return read_topics(path, first, lambda topic: _messages(reader, topic), wanted)


def read_topics(
    path: Path,
    first: Mapping[str, Any],
    messages: Callable[[str], Iterable[tuple[int, Any]]],
    wanted: Sequence[str],
    *,
    clocks: Mapping[str, FieldPath] | None = None,
    kind: type[BagColumns] = BagColumns,
    what: str = "a bag",
) -> BagColumns:
    """Read the topics of some columns.

    Args:
        path: the file, for messages.
        first: a message of each topic.
        messages: function that reads a topic: Unix times (ns) of reception, and messages.
        wanted: names of columns; the topic of the first one is the rows.
        clocks: path to the stamp in the messages of each topic (default: ``header.stamp``).
        kind: class of the table.
        what: kind of the file, for messages.

    Returns:
        The table.

    Raises:
        TableError: No message contains numbers.
        ImplausibleError: A topic contains more different numbers than any device has.
    """
    available = [(topic, steps) for topic, message in first.items() for steps, _ in iterate_numbers(message)]
    if not available:
        raise TableError(
            f"{path}: expected {what} with messages that hold numbers, found others in {', '.join(first)}"
        )
    needed = find_topics(wanted, available, kind.bare_paths) or [available[0][0]]
    groups = [
        group
        for topic in needed
        for group in group_messages(topic, messages(topic), (clocks or {}).get(topic, STAMP))
    ]
    return make_columns(path, groups, wanted, available=available, kind=kind)


def make_columns(
    path: Path,
    groups: Sequence[MessageGroup],
    wanted: Sequence[str],
    *,
    available: Sequence[tuple[str, FieldPath]] = (),
    kind: type[BagColumns] = BagColumns,
) -> BagColumns:
    """Make a table of groups of messages.

    Args:
        path: the file, for messages.
        groups: groups; one of those of the first topic is the rows.
        wanted: names of columns.
        available: topics and paths of numbers; those of other topics are columns that are not read.
        kind: class of the table.

    Returns:
        The table.
    """
    base = _choose_rows(groups, [_normalise(name) for name in wanted])
    groups = [base, *(group for group in groups if group is not base)]
    locations: dict[str, tuple[int | None, FieldPath]] = {"t": (None, ()), RECEIVED: (None, (RECEIVED,))}
    for number, group in enumerate(groups):
        for steps in group.values:
            locations.setdefault(_column_name(group.topic, steps), (number, steps))
    topics = {group.topic for group in groups}
    for topic, steps in available:
        if topic not in topics:
            locations.setdefault(_column_name(topic, steps), (None, steps))
    names = tuple(locations)
    return kind(
        names=names,
        width=len(names),
        lines=base.rows + 1,
        counts=np.full(len(base.rows), len(names)),
        path=path,
        locations=tuple(locations.values()),
        groups=tuple(groups),
        indexed={plain: names.index(name) for plain, name in _unambiguous_names(groups)},
        ambiguous=dict(_ambiguities(groups)),
    )


def find_topics(
    wanted: Sequence[str], available: Sequence[tuple[str, FieldPath]], bare_paths: bool
) -> list[str]:
    """Find the topics of columns.

    Args:
        wanted: names of columns.
        available: topics and paths of numbers.
        bare_paths: whether a name may be a path without a topic.

    Returns:
        Topics in the order of the columns. If several topics begin a name, the longest one.
    """
    topics = {_normalise(topic).lstrip("/"): topic for topic, _ in reversed(available)}
    needed: dict[str, None] = {}
    for name in wanted:
        prefixes = [topics[plain] for plain in topics if f"{_normalise(name)}.".startswith(f"{plain}.")]
        if prefixes:
            needed[max(prefixes, key=len)] = None
        elif bare_paths:
            needed |= {topic: None for topic, steps in available if _is_bare_path(name, steps)}
    return list(needed)


def _is_bare_path(name: str, path: FieldPath) -> bool:
    """Whether a name is a path without a topic; names of the time of the rows are none."""
    steps = [step.name if isinstance(step, Named) else str(step) for step in path]
    return name not in (*TIME_NAMES, RECEIVED) and _split(name) == steps


def _split(path: str) -> list[str]:
    return [index or part for index, part in _STEP.findall(path)]


def _first_message(reader: Any, connection: Any) -> Any:
    _, _, raw = next(iter(reader.messages([connection])))
    return reader.deserialize(raw, connection.msgtype)


def _messages(reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    connections = [connection for connection in reader.connections if connection.topic == topic]
    for connection, time_ns, raw in reader.messages(connections):
        yield time_ns, reader.deserialize(raw, connection.msgtype)


def _choose_rows(groups: Sequence[MessageGroup], wanted: Sequence[str]) -> MessageGroup:
    """The group that is the rows: of the first topic, the only one with the first such name."""
    candidates = [group for group in groups if group.topic == groups[0].topic]
    for name in wanted:
        matching = [
            candidate
            for candidate in candidates
            if any(_normalise(_column_name(candidate.topic, steps)) == name for steps in candidate.values)
        ]
        if len(matching) == 1:
            return matching[0]
    return candidates[0]


def _indexed_names(group: MessageGroup) -> Iterator[tuple[str, str]]:
    """Names by index of array elements that have names, each with the column that it may mean."""
    for steps in group.values:
        position = next((k for k, step in enumerate(steps) if isinstance(step, Named)), None)
        if position is None:
            continue
        element = steps[position]
        for labels in group.name_orders:
            if isinstance(element, Named) and element.name in labels:
                by_index = (*steps[:position], labels.index(element.name), *steps[position + 1 :])
                yield _normalise(_column_name(group.topic, by_index)), _column_name(group.topic, steps)


def _name_orders(groups: Sequence[MessageGroup], topic: str) -> dict[tuple[str, ...], int]:
    return {labels: n for group in groups if group.topic == topic for labels, n in group.name_orders.items()}


def _unambiguous_names(groups: Sequence[MessageGroup]) -> Iterator[tuple[str, str]]:
    """Indices, with their columns, of arrays whose elements keep their order."""
    for group in groups:
        if len(_name_orders(groups, group.topic)) == 1:
            yield from _indexed_names(group)


def _ambiguities(groups: Sequence[MessageGroup]) -> Iterator[tuple[str, str]]:
    """Indices of arrays whose elements change their order, with an explanation."""
    for group in groups:
        name_orders = _name_orders(groups, group.topic)
        if len(name_orders) == 1:
            continue
        counts = "; ".join(
            f"{_list_names(labels) or 'no names'} in {n} messages" for labels, n in name_orders.items()
        )
        for plain, name in _indexed_names(group):
            yield (
                plain,
                f"expected a name, since the elements change places: {counts}; write the column as {name!r}",
            )


def _list_names(names: Sequence[str]) -> str:
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    return f"{', '.join(names[:MAX_NAMES])}{more}"


def _format_names(group: MessageGroup) -> str:
    return f" with {_list_names(group.names)}" if group.names else ""


def _column_name(topic: str, steps: FieldPath) -> str:
    texts = (f"[{s}]" if isinstance(s, int) else f".{s.name if isinstance(s, Named) else s}" for s in steps)
    return topic + "".join(texts)


def _normalise(name: str) -> str:
    """A column's name in its only notation: no first slash, and ``.0`` for ``[0]``."""
    topic, dot, rest = name.partition(".")
    return ".".join((topic.lstrip("/"), *_split(rest))) if dot else name


def _resample(
    t: FloatArray, times: FloatArray, values: FloatArray, hold: Hold, max_gap: float = 100.0
) -> FloatArray:
    """Values of a topic at times ``t`` (n,); NaN outside it and in gaps of over ``max_gap`` median steps."""
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
    inside &= step <= max_gap * np.median(rising[rising > 0]) if (rising > 0).any() else False
    previous = values[np.clip(before, 0, len(times) - 1)]
    fraction = np.divide(t - times[begin], step, out=np.zeros_like(t), where=step > 0)
    interpolated = values[begin] + fraction * (values[begin + 1] - values[begin])
    resampled[inside] = (previous if hold is Hold.ZERO else interpolated)[inside]
    return resampled
