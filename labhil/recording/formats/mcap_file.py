"""MCAP files of other programs: every number in their messages is a column ``topic.field[.sub][index]``.

The rows are the messages of one topic; columns of others are taken at the times of these. The time is a stamp
in the messages where there is one, otherwise the file's log time. Only the topics in question are unpacked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mcap.reader import SeekingReader
from mcap.records import Schema

from labhil.bounds import Budget, ImplausibleError
from labhil.errors import LabhilError, MissingExtraError, TableError
from labhil.recording.formats.bag import BagColumns, bag_columns
from labhil.recording.formats.bag_messages import STAMP, Way
from labhil.recording.formats.mcap_decoders import (
    ENCODINGS,
    Decode,
    DecodeError,
    Stamp,
    WellFormed,
    decoder_for,
)
from labhil.recording.metadata import LARGEST_RECORD

PUBLISHED = "publish_time"
"""The column of the times at which messages were sent, s, where the file has others than its log times."""

TRIED = 100
"""Messages of a topic of which the first that can be decoded says what columns there are."""

MOST_LISTED = 12
"""Topics that a message lists."""

STAMPS: tuple[Way, ...] = (STAMP, ("timestamp",), ("stamp",))
"""Where programs keep the time at which a message was true."""


@dataclass(frozen=True)
class McapColumns(BagColumns):
    """Columns of an MCAP file.

    ``faults`` says which messages could not be decoded, ``unread`` which topics are none, and why.
    """

    faults: tuple[str, ...] = ()
    unread: tuple[tuple[str, str], ...] = ()

    receiver = "the file's recorder"
    bare_paths = True

    @property
    def notes(self) -> tuple[str, ...]:
        """Which messages give the rows and which clock the time, and what could not be decoded."""
        return (*super().notes, *self.faults)

    @property
    def left_out(self) -> str:
        """Which topics are no columns, for messages."""
        return _unread_in_words(self.unread)


def read_mcap(path: Path, wanted: Sequence[str]) -> McapColumns:
    """Read the topics that ``wanted`` columns stand in; the first of them gives the rows.

    Args:
        path: The file.
        wanted: Names of columns that the rig file asks for.

    Raises:
        TableError: The file cannot be read, is a recording of ours, or holds no numbers in an encoding that
            is read.
        MissingExtraError: A topic in question needs rosbags, which is not installed.
    """
    try:
        with path.open("rb") as stream:
            return _File(path, stream).columns(wanted)
    except (LabhilError, ImplausibleError, MemoryError):
        raise
    except Exception as error:  # struct, lz4, zstd and mcap each raise their own on a damaged file
        what = str(error) or type(error).__name__
        raise TableError(
            f"{path}: expected a whole MCAP file, found one that cannot be read: {what}; `mcap recover` "
            "(of MCAP's command line tool) saves what is whole"
        ) from error


@dataclass
class _File:
    path: Path
    stream: Any
    decoders: dict[int, Decode] = field(default_factory=dict)
    failed: Counter[str] = field(default_factory=Counter)
    first_failure: dict[str, str] = field(default_factory=dict)
    unread: dict[str, str] = field(default_factory=dict)
    missing: MissingExtraError | None = None

    def __post_init__(self) -> None:
        self.reader = SeekingReader(self.stream, validate_crcs=True, record_size_limit=LARGEST_RECORD)
        self.summary = self.reader.get_summary()
        self._refuse_ours()
        self._refuse_claims()

    def columns(self, wanted: Sequence[str]) -> McapColumns:
        """The columns of the topics that are wanted, and the names of all others."""
        first = dict(self._first_messages())
        if not first and self.missing is not None:
            raise self.missing
        if not first:
            raise TableError(
                f"{self.path}: expected an MCAP file with messages in {', '.join(ENCODINGS)} that hold "
                f"numbers, found {_unread_in_words(tuple(self.unread.items())) or 'one without messages'}"
            )
        self.failed.clear()  # those that were read to see what there is are read again
        self.first_failure.clear()
        columns = bag_columns(
            self.path,
            first,
            self._messages,
            wanted,
            clocks={topic: _clock_of(message) for topic, message in first.items()},
            kind=McapColumns,
            what="an MCAP file",
        )
        assert isinstance(columns, McapColumns)
        faults = tuple(
            f"{count} messages of {topic} cannot be decoded; the first: {self.first_failure[topic]}"
            for topic, count in self.failed.items()
        )
        return replace(columns, faults=faults, unread=tuple(self.unread.items()))

    def _refuse_ours(self) -> None:
        channels = self.summary.channels.values() if self.summary else ()
        if any("labhil.stream" in channel.metadata for channel in channels):
            raise TableError(
                f"{self.path}: expected a table, found an MCAP recording of ours, which needs no import"
            )

    def _refuse_claims(self) -> None:
        """ImplausibleError where the chunks claim more than the file can hold."""
        budget = Budget.of(self.path.stat().st_size)
        for chunk in self.summary.chunk_indexes if self.summary else ():
            budget.take_content(chunk.uncompressed_size)

    def _first_messages(self) -> Iterator[tuple[str, Any]]:
        """Of each topic the first message that can be decoded; why there is none is kept in ``unread``."""
        tried: Counter[str] = Counter()
        found: set[str] = set()
        for topic, message in self._candidates(found, tried):
            tried[topic] += 1
            if message is None:
                self.unread.setdefault(topic, self.first_failure[topic])
            else:
                found.add(topic)
                self.unread.pop(topic, None)
                yield topic, message

    def _candidates(self, found: set[str], tried: Counter[str]) -> Iterator[tuple[str, Any]]:
        """Messages to choose the first ones from; by topic where the file has an index, else all of it."""
        asked: str | None
        for asked in self._topics() or (None,):
            for schema, channel, record in self.reader.iter_messages(asked):
                topic = channel.topic
                if topic not in found and tried[topic] < TRIED:
                    yield topic, self._decode(schema, channel, record)
                if asked is not None and (topic in found or tried[topic] >= TRIED):
                    break

    def _topics(self) -> list[str]:
        """The topics that the index of the file names; none where it has no index."""
        if self.summary is None or not self.summary.chunk_indexes:
            return []
        return list(dict.fromkeys(channel.topic for channel in self.summary.channels.values()))

    def _messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        for schema, channel, record in self.reader.iter_messages([topic]):
            message = self._decode(schema, channel, record)
            yield record.log_time, {} if message is None else message

    def _decode(self, schema: Schema | None, channel: Any, record: Any) -> Any:
        """A message as plain data, None where it cannot be decoded."""
        decode = self.decoders.get(channel.id)
        if decode is None:
            decode = self.decoders[channel.id] = self._decoder(schema, channel)
        try:
            message = decode(record.data)
        except (MemoryError, LabhilError):
            raise
        except Exception as error:  # noqa: BLE001 - json, protobuf and rosbags each raise their own
            self.failed[channel.topic] += 1
            self.first_failure.setdefault(channel.topic, (str(error) or type(error).__name__)[:200])
            return None
        if isinstance(message, dict) and record.publish_time != record.log_time:
            message.setdefault(PUBLISHED, Stamp(*divmod(record.publish_time, 10**9)))
        return message

    def _decoder(self, schema: Schema | None, channel: Any) -> Decode:
        form = WellFormed(
            channel.message_encoding,
            "" if schema is None else schema.name,
            "" if schema is None else schema.encoding,
            b"" if schema is None else schema.data,
        )
        try:
            return decoder_for(form, f"{self.path}: {channel.topic}: a message in {form.encoding}")
        except MissingExtraError as error:
            self.missing = self.missing or error
            return _failing(DecodeError(str(error)))
        except DecodeError as error:
            return _failing(error)


def _failing(error: DecodeError) -> Decode:
    """What takes the place of a decoder where there is none: it fails on every message."""

    def fail(payload: bytes) -> Any:
        raise error

    return fail


def _clock_of(message: Any) -> Way:
    """The way to the stamp of a message; that of a header where there is none."""
    for way in STAMPS:
        value = message
        for step in way:
            value = value.get(step) if isinstance(value, Mapping) else getattr(value, str(step), None)
        if hasattr(value, "sec") and hasattr(value, "nanosec"):
            return way
    return STAMP


def _unread_in_words(unread: Sequence[tuple[str, str]]) -> str:
    listed = [f"{topic} is no column: {reason}" for topic, reason in unread[:MOST_LISTED]]
    more = [f"{len(unread) - MOST_LISTED} more topics are none"] if len(unread) > MOST_LISTED else []
    return "; ".join([*listed, *more])
