"""Messages of one topic as columns of numbers; arrays go by the names that a message gives their elements.

A JointState lists the names of its joints beside their positions. The order is the publisher's own and may
change from one message to the next, and several publishers may share a topic: a number belongs to its name.
"""

from __future__ import annotations

import dataclasses
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labhil.bounds import ImplausibleError
from labhil.signals import FloatArray, IntArray
from labhil.terminal import printable_name

LONGEST_ARRAY = 64
"""Longer arrays (images, point clouds) are no columns."""

MOST_NUMBERS = 4096
"""Numbers in the messages of one topic; more are data of another kind, such as fields named by keys."""

Labels = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Named:
    """The element of an array that bears this name."""

    name: str


Way = tuple[str | int | Named, ...]
"""How to get from a message to a number: names of fields, places in arrays, names of elements."""

STAMP: Way = ("header", "stamp")


@dataclass(frozen=True, slots=True)
class Source:
    """Messages of one topic that belong together: all of them, or those that name the same joints.

    ``rows`` (n,) are their places in the topic, ``received`` (n,) and ``stamps`` (n,, of their headers) are s
    of Unix time. ``orders`` says in how many messages the names had which order, ``clock`` is the way to a
    stamp.
    """

    topic: str
    rows: IntArray
    received: FloatArray
    values: Mapping[Way, FloatArray]
    orders: Mapping[Labels, int]
    clock: Way = STAMP

    @property
    def stamps(self) -> FloatArray | None:
        """Stamps in the messages; None where nobody filled them in."""
        stamps = self.values.get(self.clock)
        return stamps if stamps is not None and (stamps > 0).all() else None

    @property
    def names(self) -> Labels:
        """All names in its messages, in the order in which they came up."""
        return tuple(dict.fromkeys(name for labels in self.orders for name in labels))


def numbers_in(value: Any, way: Way = (), labels: Labels = ()) -> Iterator[tuple[Way, float]]:
    """Walk a message: every number (a stamp is one, in s) and the way to it."""
    if isinstance(value, (bool, int, float, np.number, np.bool_)):
        yield way, float(value)
    elif hasattr(value, "sec") and hasattr(value, "nanosec"):
        yield way, value.sec + 1e-9 * value.nanosec
    elif isinstance(value, (list, np.ndarray)):
        named = bool(labels) and len(value) == len(labels) and not _parallel_inside(value, len(labels))
        for place in range(len(value) if len(value) <= LONGEST_ARRAY else 0):
            step = Named(labels[place]) if named else place
            yield from numbers_in(value[place], (*way, step), () if named else labels)
    elif fields := _fields_of(value):
        inner_labels = labels_of(value) or labels
        for name, inner in fields:
            yield from numbers_in(inner, (*way, name), inner_labels)


def _fields_of(value: Any) -> list[tuple[str, Any]]:
    """Names and values of a message's fields; none for what is no message."""
    if isinstance(value, Mapping):
        return list(value.items())
    if dataclasses.is_dataclass(value):
        return [(part.name, getattr(value, part.name)) for part in dataclasses.fields(value)]
    return []


def labels_of(message: Any) -> Labels:
    """The names that a message gives the elements of its arrays: its field ``name`` or ``…names``."""
    for name, value in _fields_of(message):
        if not (name == "name" or name.endswith("names")) or not isinstance(value, list):
            continue
        if (
            value
            and all(isinstance(label, str) and label for label in value)
            and len(set(value)) == len(value)
        ):
            return tuple(value)
    return ()


def _parallel_inside(value: Any, count: int) -> bool:
    """Whether the elements hold arrays as long as the names (points of a trajectory): those bear them."""
    first = value[0] if len(value) else None
    if labels_of(first):
        return False
    inner = (values for _, values in _fields_of(first))
    return any(isinstance(values, (list, np.ndarray)) and len(values) == count for values in inner)


def sources_of(topic: str, messages: Iterable[tuple[int, Any]], clock: Way = STAMP) -> list[Source]:
    """Read the messages of a topic, each with the time (ns, Unix) at which it was received.

    Messages whose names have none in common come from several publishers, and are several sources. ``clock``
    is the way to their stamps. ImplausibleError when they hold more different numbers than any device.
    """
    received: list[int] = []
    labels: list[Labels] = []
    columns: dict[Way, array[float]] = {}
    for time_ns, message in messages:
        count = len(received)
        width = 0
        for way, number in numbers_in(message):
            column = columns.get(way)
            if column is None:
                column = columns[way] = array("d", [np.nan]) * count
            column.append(number)
            width += 1
        received.append(time_ns)
        labels.append(labels_of(message))
        if len(columns) > MOST_NUMBERS:
            raise ImplausibleError(
                f"the messages of {printable_name(topic)} hold more than {MOST_NUMBERS} different numbers"
            )
        if width != len(columns):  # an array may be shorter, or its names others, than in another message
            for column in columns.values():
                column.extend([np.nan] * (count + 1 - len(column)))
    values = {way: np.array(column) for way, column in columns.items()}
    seconds = np.array(received, dtype=np.float64) * 1e-9
    sources = []
    for group in _groups(labels):
        rows = np.array([row for row, order in enumerate(labels) if order in group], dtype=np.int64)
        orders = Counter(order for order in labels if order in group)
        names = {name for order in group for name in order}
        group_columns = {way: column[rows] for way, column in values.items() if _belongs(way, names)}
        sources.append(Source(topic, rows, seconds[rows], group_columns, orders, clock))
    return sources


def _belongs(way: Way, names: set[str]) -> bool:
    """Whether messages with these names have the number: the first name on the way is the message's own."""
    named = [step.name for step in way if isinstance(step, Named)]
    return not named or not names or named[0] in names


def _groups(labels: Sequence[Labels]) -> list[set[Labels]]:
    """Sets of orders that have names in common, the most frequent first."""
    groups: list[set[Labels]] = []
    for order in dict.fromkeys(labels):
        names = set(order)
        together = [group for group in groups if any(names & set(member) for member in group)]
        groups = [group for group in groups if group not in together]
        groups.append({order}.union(*together))
    counts = Counter(labels)
    return sorted(groups, key=lambda group: -sum(counts[order] for order in group))
