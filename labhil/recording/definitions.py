"""What the numbers of channels and schemas mean, in a file that may be pieced together from several.

A number means one thing in one file. Where a later part of a file gives it another meaning, the part comes
from another file, and its messages must not appear under the first one's name.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

from mcap.records import Channel, Schema


@dataclass(slots=True)
class Definitions:
    """Channels and schemas by numbers of ours: those of the file, and free ones where it uses one twice."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    _schema_numbers: dict[int, list[int]] = field(default_factory=dict)  # ours, the current one last
    _channel_numbers: dict[int, list[int]] = field(default_factory=dict)
    _doubtful: list[Schema | Channel] = field(default_factory=list)

    def schema(self, schema: Schema) -> None:
        """Take the description of a schema."""
        numbers = self._schema_numbers.setdefault(schema.id, [])
        for number in numbers:
            if replace(self.schemas[number], id=schema.id) == schema:
                numbers.sort(key=number.__eq__)
                return
        number = _free(schema.id, self.schemas)
        numbers.append(number)
        self.schemas[number] = replace(schema, id=number)

    def channel(self, channel: Channel) -> None:
        """Take the description of a channel."""
        schema = _current(channel.schema_id, self._schema_numbers)
        numbers = self._channel_numbers.setdefault(channel.id, [])
        for number in numbers:
            if self.channels[number] == replace(channel, id=number, schema_id=schema):
                numbers.sort(key=number.__eq__)
                return
        number = _free(channel.id, self.channels)
        numbers.append(number)
        self.channels[number] = replace(channel, id=number, schema_id=schema)

    def doubtful(self, description: Schema | Channel) -> None:
        """Take a description whose checksum is wrong; it counts where there is no other."""
        self._doubtful.append(description)

    def number(self, channel: int) -> int:
        """Our number of the channel that bears this one at this place of the file."""
        return _current(channel, self._channel_numbers)

    def settle(self, used: Collection[int]) -> None:
        """Adopt doubtful descriptions of what has no other, and drop what describes nothing.

        A damaged description of a channel looks like that of another channel, without messages (those in
        ``used`` have some).
        """
        for item in self._doubtful:
            if isinstance(item, Schema):
                self.schemas.setdefault(item.id, item)
            else:
                self.channels.setdefault(item.id, item)
        known = [channel for number, channel in self.channels.items() if number in used]
        for number, channel in [item for item in self.channels.items() if item[0] not in used]:
            twin = any(replace(candidate, id=number) == channel for candidate in known)
            if twin or number not in self._channel_numbers:
                del self.channels[number]

    @property
    def renumbered(self) -> bool:
        """Whether the file gives a channel's number more than one meaning."""
        return any(
            len([number for number in numbers if number in self.channels]) > 1
            for numbers in self._channel_numbers.values()
        )


def _current(number: int, numbers: dict[int, list[int]]) -> int:
    return numbers[number][-1] if number in numbers else number


def _free(number: int, taken: Collection[int]) -> int:
    """The number itself, or the first one above all others."""
    return number if number not in taken else max(taken) + 1
