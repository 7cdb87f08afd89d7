"""Messages of a ROS topic as columns of numbers.

A JointState lists the names of its joints beside their positions. Their order may change from one message to
the next, and several publishers may share a topic. Such numbers are therefore columns by name.
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

MAX_ARRAY_LENGTH = 64
"""Longest array that becomes columns; longer ones are images or point clouds."""

MAX_NUMBERS = 4096
"""Largest number of columns of a topic; more are other data, such as mappings with arbitrary keys."""

Labels = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Named:
    """An array element with a name."""

    name: str


FieldPath = tuple[str | int | Named, ...]
"""Path from a message to a number: names of fields, indices of arrays, names of array elements."""

STAMP: FieldPath = ("header", "stamp")


@dataclass(frozen=True, slots=True)
class MessageGroup:
    """Messages of a topic: all, or those that name the same joints.

    Attributes:
        topic: the topic.
        rows: positions in the topic, (n,).
        received: times at which the bag received them, (n,), s of Unix time.
        values: numbers by path, (n,) each.
        name_orders: number of messages by order of the names.
        clock: path to the stamp.
    """

    topic: str
    rows: IntArray
    received: FloatArray
    values: Mapping[FieldPath, FloatArray]
    name_orders: Mapping[Labels, int]
    clock: FieldPath = STAMP

    @property
    def stamps(self) -> FloatArray | None:
        """Stamps in the messages, (n,), s of Unix time; None if they are empty."""
        stamps = self.values.get(self.clock)
        return stamps if stamps is not None and (stamps > 0).all() else None

    @property
    def names(self) -> Labels:
        """Names in the messages, in the order of their first appearance."""
        return tuple(dict.fromkeys(name for labels in self.name_orders for name in labels))


def iterate_numbers(
    value: Any, path: FieldPath = (), labels: Labels = ()
) -> Iterator[tuple[FieldPath, float]]:
    """Yield all numbers of a message with their paths; a stamp is a number in s.

    Args:
        value: the message, or a part of it.
        path: path to this part.
        labels: names of the elements of arrays in this part.

    Yields:
        Path and number.
    """
    if isinstance(value, (bool, int, float, np.number, np.bool_)):
        yield path, float(value)
    elif hasattr(value, "sec") and hasattr(value, "nanosec"):
        yield path, value.sec + 1e-9 * value.nanosec
    elif isinstance(value, (list, np.ndarray)):
        named = bool(labels) and len(value) == len(labels) and not _parallel_inside(value, len(labels))
        for index in range(len(value) if len(value) <= MAX_ARRAY_LENGTH else 0):
            step = Named(labels[index]) if named else index
            yield from iterate_numbers(value[index], (*path, step), () if named else labels)
    elif fields := _fields_of(value):
        inner_labels = element_names(value) or labels
        for name, inner in fields:
            yield from iterate_numbers(inner, (*path, name), inner_labels)


def _fields_of(value: Any) -> list[tuple[str, Any]]:
    """Names and values of a message's fields; empty if it is no message."""
    if isinstance(value, Mapping):
        return list(value.items())
    if dataclasses.is_dataclass(value):
        return [(part.name, getattr(value, part.name)) for part in dataclasses.fields(value)]
    return []


def element_names(message: Any) -> Labels:
    """Names of array elements in the field ``name`` or ``…names`` of a message; empty without one."""
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
    """Whether the elements contain arrays with ``count`` items, as points of a trajectory do."""
    first = value[0] if len(value) else None
    if element_names(first):
        return False
    inner = (values for _, values in _fields_of(first))
    return any(isinstance(values, (list, np.ndarray)) and len(values) == count for values in inner)


def group_messages(
    topic: str, messages: Iterable[tuple[int, Any]], clock: FieldPath = STAMP
) -> list[MessageGroup]:
    """Read the messages of a topic, and group them by publisher.

    Args:
        topic: the topic.
        messages: Unix times (ns) of reception and messages.
        clock: path to the stamp of a message.

    Returns:
        Groups, the largest first. Messages without a common name are of different publishers.

    Raises:
        ImplausibleError: The messages contain more different numbers than any device has.
    """
    received: list[int] = []
    labels: list[Labels] = []
    columns: dict[FieldPath, array[float]] = {}
    for time_ns, message in messages:
        count = len(received)
        width = 0
        for path, number in iterate_numbers(message):
            column = columns.get(path)
            if column is None:
                column = columns[path] = array("d", [np.nan]) * count
            column.append(number)
            width += 1
        received.append(time_ns)
        labels.append(element_names(message))
        if len(columns) > MAX_NUMBERS:
            raise ImplausibleError(
                f"the messages of {printable_name(topic)} hold more than {MAX_NUMBERS} different numbers"
            )
        if width != len(columns):  # a shorter array than in another message, or other names
            for column in columns.values():
                column.extend([np.nan] * (count + 1 - len(column)))
    values = {path: np.array(column) for path, column in columns.items()}
    seconds = np.array(received, dtype=np.float64) * 1e-9
    groups = []
    for group in _groups(labels):
        rows = np.array([row for row, order in enumerate(labels) if order in group], dtype=np.int64)
        name_orders = Counter(order for order in labels if order in group)
        names = {name for order in group for name in order}
        group_columns = {path: column[rows] for path, column in values.items() if _belongs(path, names)}
        groups.append(MessageGroup(topic, rows, seconds[rows], group_columns, name_orders, clock))
    return groups


def _belongs(path: FieldPath, names: set[str]) -> bool:
    """Whether messages with these names contain the number: the first name on the path is the message's."""
    named = [step.name for step in path if isinstance(step, Named)]
    return not named or not names or named[0] in names


def _groups(labels: Sequence[Labels]) -> list[set[Labels]]:
    """Sets of name orders with common names, the most frequent first."""
    groups: list[set[Labels]] = []
    for order in dict.fromkeys(labels):
        names = set(order)
        together = [group for group in groups if any(names & set(member) for member in group)]
        groups = [group for group in groups if group not in together]
        groups.append({order}.union(*together))
    counts = Counter(labels)
    return sorted(groups, key=lambda group: -sum(counts[order] for order in group))
