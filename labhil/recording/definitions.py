"""Channels and schemas by number, in an MCAP file that may be concatenated from several files.

A number has one meaning in a file. If a later part gives it another one, that part is from another file, and
its messages must not appear under the first name.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

from mcap.records import Channel, Schema


@dataclass(slots=True)
class Definitions:
    """Channels and schemas by unique number: the file's, or an unused one if the file uses it twice."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    _schema_numbers: dict[int, list[int]] = field(default_factory=dict)  # ours, the current one last
    _channel_numbers: dict[int, list[int]] = field(default_factory=dict)
    _doubtful: list[Schema | Channel] = field(default_factory=list)

    def add_schema(self, schema: Schema) -> None:
        """Add a schema."""
        numbers = self._schema_numbers.setdefault(schema.id, [])
        for number in numbers:
            if replace(self.schemas[number], id=schema.id) == schema:
                numbers.sort(key=number.__eq__)
                return
        number = _unused_number(schema.id, self.schemas)
        numbers.append(number)
        self.schemas[number] = replace(schema, id=number)

    def add_channel(self, channel: Channel) -> None:
        """Add a channel."""
        schema = _current(channel.schema_id, self._schema_numbers)
        numbers = self._channel_numbers.setdefault(channel.id, [])
        for number in numbers:
            if self.channels[number] == replace(channel, id=number, schema_id=schema):
                numbers.sort(key=number.__eq__)
                return
        number = _unused_number(channel.id, self.channels)
        numbers.append(number)
        self.channels[number] = replace(channel, id=number, schema_id=schema)

    def add_doubtful(self, description: Schema | Channel) -> None:
        """Add a description with a wrong checksum, which counts if there is no other."""
        self._doubtful.append(description)

    def channel_number(self, channel: int) -> int:
        """Unique number of the channel that has this one at the current position in the file."""
        return _current(channel, self._channel_numbers)

    def resolve(self, used: Collection[int]) -> None:
        """Use doubtful descriptions without alternative, and drop damaged copies of others.

        A damaged description of a channel looks like another channel without messages.

        Args:
            used: numbers of channels with messages.
        """
        for item in self._doubtful:
            if isinstance(item, Schema):
                self.schemas.setdefault(item.id, item)
            else:
                self.channels.setdefault(item.id, item)
        known = [channel for number, channel in self.channels.items() if number in used]
        for number, channel in [item for item in self.channels.items() if item[0] not in used]:
            is_copy = any(replace(candidate, id=number) == channel for candidate in known)
            if is_copy or number not in self._channel_numbers:
                del self.channels[number]

    @property
    def renumbered(self) -> bool:
        """Whether a channel's number has several meanings in the file."""
        return any(
            len([number for number in numbers if number in self.channels]) > 1
            for numbers in self._channel_numbers.values()
        )


def _current(number: int, numbers: dict[int, list[int]]) -> int:
    return numbers[number][-1] if number in numbers else number


def _unused_number(number: int, taken: Collection[int]) -> int:
    """The number itself, or the first one above all others if it is taken."""
    return number if number not in taken else max(taken) + 1
