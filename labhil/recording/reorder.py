"""Order of the messages of a damaged file, without copies."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mcap.records import Channel

from labhil.codec import stamps_of
from labhil.errors import ProtocolError
from labhil.recording.message_store import Message, channels_of
from labhil.recording.runs import MixedRunsError, count_late, order_samples

BLOCK_MESSAGES = 1 << 14
"""Messages that are checked together."""


@dataclass(frozen=True, slots=True)
class OrderedMessages:
    """Messages in order.

    Attributes:
        messages: the messages.
        copies: number of dropped exact copies by channel.
        moved: number of messages that were behind later ones.
        notes: channels that could not be put in order, or contain several runs.
    """

    messages: Sequence[Message]
    copies: Mapping[int, int]
    moved: int
    notes: tuple[str, ...]


def reorder(messages: Sequence[Message], channels: Mapping[int, Channel]) -> OrderedMessages:
    """Put the messages of each stream in order, and drop exact copies.

    Messages of a channel only exchange their positions. Foreign channels and events have no sequence numbers
    and stay unchanged: two equal messages may be two events.

    Args:
        messages: messages in the order of the file.
        channels: channels by number.

    Returns:
        The messages in order.
    """
    result: list[Message | None] | None = None
    copies, moved, notes = {}, 0, []
    for number, indices in _message_indices(messages, channels).items():
        if _counts_up(messages, indices):
            copies[number] = 0
            continue
        topic, single = channels[number].topic, list(dict.fromkeys(messages[index] for index in indices))
        try:
            stamps = stamps_of([message.data for message in single])
            runs = order_samples(*stamps.T)
        except (ProtocolError, MixedRunsError) as error:
            notes.append(f"{topic}: left unchanged: {error}")
            continue
        if len(runs) > 1:
            notes.append(f"{topic}: {len(runs)} runs in one channel; --run N of other commands chooses one")
        copies[number] = len(indices) - len(single)
        moved += sum(count_late(stamps[np.sort(run), 0]) for run in runs)
        ordered = [single[index] for index in np.concatenate(runs).tolist()]
        result = list(messages) if result is None else result
        for index, message in zip(indices, [*ordered, *[None] * copies[number]], strict=True):
            result[index] = message
    if result is None:
        return OrderedMessages(messages, copies, moved, tuple(notes))
    return OrderedMessages(
        tuple(message for message in result if message is not None), copies, moved, tuple(notes)
    )


def _message_indices(messages: Sequence[Message], channels: Mapping[int, Channel]) -> dict[int, array[int]]:
    """Indices of the messages of each stream, by channel."""
    indices: dict[int, array[int]] = {}
    ours = {number for number, channel in channels.items() if "labhil.stream" in channel.metadata}
    for index, number in enumerate(channels_of(messages)):
        if number in ours:
            indices.setdefault(number, array("Q")).append(index)
    return indices


def _counts_up(messages: Sequence[Message], indices: array[int]) -> bool:
    """Whether the sequence numbers increase, so that the messages are in order without copies."""
    last = None
    for start in range(0, len(indices), BLOCK_MESSAGES):
        try:
            seq = stamps_of([messages[index].data for index in indices[start : start + BLOCK_MESSAGES]])[:, 0]
        except ProtocolError:
            return False
        if not (np.diff(seq) > 0).all() or (last is not None and seq[0] <= last):
            return False
        last = int(seq[-1])
    return True
