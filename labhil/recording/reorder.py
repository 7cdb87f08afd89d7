"""The messages of a broken file in their order, each once."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mcap.records import Channel

from labhil.codec import stamps_of
from labhil.errors import ProtocolError
from labhil.recording.message_store import Message, channels_of
from labhil.recording.runs import MixedRunsError, late, order_of

BLOCK = 1 << 14
"""Messages that are looked at together."""


@dataclass(frozen=True, slots=True)
class Ordered:
    """Messages in order; ``copies`` were dropped, by channel; ``moved`` ones stood behind later ones.

    ``notes`` say which channels could not be put in order, and which hold several runs.
    """

    messages: Sequence[Message]
    copies: Mapping[int, int]
    moved: int
    notes: tuple[str, ...]


def reorder(messages: Sequence[Message], channels: Mapping[int, Channel]) -> Ordered:
    """Put the messages of every stream of ours in order and drop exact copies.

    The messages of a channel take the places that the channel has in the file. Channels of other programs
    and events stay as they are: nothing counts them, so that two alike may be two that happened.

    Args:
        messages: As they stand in the file.
        channels: What their numbers stand for.
    """
    result: list[Message | None] | None = None
    copies, moved, notes = {}, 0, []
    for number, places in _places(messages, channels).items():
        if _counts_up(messages, places):
            copies[number] = 0
            continue
        topic, single = channels[number].topic, list(dict.fromkeys(messages[place] for place in places))
        try:
            stamps = stamps_of([message.data for message in single])
            runs = order_of(*stamps.T)
        except (ProtocolError, MixedRunsError) as error:
            notes.append(f"{topic}: left as it stood: {error}")
            continue
        if len(runs) > 1:
            notes.append(f"{topic}: {len(runs)} runs in one channel; --run N of other commands chooses one")
        copies[number] = len(places) - len(single)
        moved += sum(late(stamps[np.sort(run), 0]) for run in runs)
        ordered = [single[place] for place in np.concatenate(runs).tolist()]
        result = list(messages) if result is None else result
        for place, message in zip(places, [*ordered, *[None] * copies[number]], strict=True):
            result[place] = message
    if result is None:
        return Ordered(messages, copies, moved, tuple(notes))
    return Ordered(tuple(message for message in result if message is not None), copies, moved, tuple(notes))


def _places(messages: Sequence[Message], channels: Mapping[int, Channel]) -> dict[int, array[int]]:
    """Where the messages of each stream of ours stand, by its channel."""
    places: dict[int, array[int]] = {}
    ours = {number for number, channel in channels.items() if "labhil.stream" in channel.metadata}
    for place, number in enumerate(channels_of(messages)):
        if number in ours:
            places.setdefault(number, array("Q")).append(place)
    return places


def _counts_up(messages: Sequence[Message], places: array[int]) -> bool:
    """Whether the samples at these places count up as they stand: then each stands once, and in order."""
    last = None
    for start in range(0, len(places), BLOCK):
        try:
            seq = stamps_of([messages[place].data for place in places[start : start + BLOCK]])[:, 0]
        except ProtocolError:
            return False
        if not (np.diff(seq) > 0).all() or (last is not None and seq[0] <= last):
            return False
        last = int(seq[-1])
    return True
