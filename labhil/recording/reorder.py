"""The messages of a broken file in their order, each once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mcap.records import Channel

from labhil.codec import stamps_of
from labhil.errors import ProtocolError
from labhil.recording.runs import MixedRunsError, late, order_of
from labhil.recording.salvage import Message


@dataclass(frozen=True, slots=True)
class Ordered:
    """Messages in order; ``copies`` were dropped, by channel; ``moved`` ones stood behind later ones.

    ``notes`` say of which channels the order could not be found, and which hold several runs.
    """

    messages: tuple[Message, ...]
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
    places: defaultdict[int, list[int]] = defaultdict(list)
    for place, message in enumerate(messages):
        if "labhil.stream" in channels[message.channel].metadata:
            places[message.channel].append(place)
    result: list[Message | None] = list(messages)
    copies, moved, notes = {}, 0, []
    for number, mine in places.items():
        topic, single = channels[number].topic, list(dict.fromkeys(messages[place] for place in mine))
        try:
            stamps = stamps_of([message.data for message in single])
            runs = order_of(*stamps.T)
        except (ProtocolError, MixedRunsError) as error:
            notes.append(f"{topic}: left as it stood: {error}")
            continue
        if len(runs) > 1:
            notes.append(f"{topic}: {len(runs)} runs in one channel; --run N of other commands chooses one")
        copies[number] = len(mine) - len(single)
        moved += sum(late(stamps[np.sort(run), 0]) for run in runs)
        ordered = [single[place] for place in np.concatenate(runs).tolist()]
        for place, message in zip(mine, [*ordered, *[None] * copies[number]], strict=True):
            result[place] = message
    kept = tuple(message for message in result if message is not None)
    return Ordered(kept, copies, moved, tuple(notes))
