"""Reader of MCAP files of other programs.

Each number in their messages is a column ``topic.field[.sub][index]``. The rows are the messages of one
topic; other topics are resampled at their times. The time is a stamp in the messages if they have one,
otherwise the log time of the file. Only the topics of the wanted columns are decoded.
"""

from __future__ import annotations

import errno
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mcap.reader import SeekingReader
from mcap.records import Schema

from labhil.bounds import Budget, ImplausibleError
from labhil.errors import LabhilError, MissingExtraError, TableError
from labhil.recording.bounded_file import BoundedFile
from labhil.recording.formats.bag import BagColumns, read_topics
from labhil.recording.formats.bag_messages import STAMP, FieldPath
from labhil.recording.formats.mcap_decoders import (
    ENCODINGS,
    Decode,
    DecodeError,
    MessageFormat,
    Stamp,
    make_decoder,
)
from labhil.recording.metadata import MAX_RECORD_SIZE

PUBLISH_TIME = "publish_time"
"""Column of the times at which messages were sent, s, if they differ from the log times of the file."""

MAX_LISTED = 12
"""Number of topics that an error message lists."""

STAMP_PATHS: tuple[FieldPath, ...] = (STAMP, ("timestamp",), ("stamp",))
"""Paths at which programs store the time of a message's values."""


@dataclass(frozen=True)
class McapColumns(BagColumns):
    """Columns of an MCAP file.

    Attributes:
        decode_faults: lines about messages that could not be decoded.
        skipped_topics: topics that are no columns, and why.
    """

    decode_faults: tuple[str, ...] = ()
    skipped_topics: tuple[tuple[str, str], ...] = ()

    receiver = "the file's recorder"
    bare_paths = True

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about the choice of rows, their clock, and messages that could not be decoded."""
        return (*super().notes, *self.decode_faults)

    @property
    def skipped(self) -> str:
        """Topics that are no columns, and why, for messages."""
        return _format_skipped(self.skipped_topics)


def read_mcap(path: Path, wanted: Sequence[str]) -> McapColumns:
    """Read the topics of some columns of an MCAP file.

    Args:
        path: the file.
        wanted: names of columns; the topic of the first one is the rows.

    Returns:
        The table.

    Raises:
        TableError: The file cannot be read, is a labhil recording, or contains no numbers in a supported
            encoding.
        ImplausibleError: The file claims more content than it can contain.
        MissingExtraError: A wanted topic needs rosbags, which is not installed.
    """
    try:
        with path.open("rb") as stream:
            return _File(path, BoundedFile(stream)).columns(wanted)
    except (LabhilError, ImplausibleError, MemoryError):
        raise
    except Exception as error:  # struct, lz4, zstd and mcap each raise their own on a damaged file
        what = str(error) or type(error).__name__
        if isinstance(error, OSError) and error.errno == errno.EINVAL:  # a seek to before its beginning
            what = "it is cut off"
        raise TableError(
            f"{path}: expected a whole MCAP file, found one that cannot be read: {what}; `mcap recover` "
            "(of MCAP's command line tool) saves what is whole"
        ) from error


@dataclass
class _File:
    """An open MCAP file, with the decoders of its channels and the failures of these."""

    path: Path
    stream: Any
    decoders: dict[int, Decode] = field(default_factory=dict)
    failed: Counter[str] = field(default_factory=Counter)
    first_failure: dict[str, str] = field(default_factory=dict)
    skipped_topics: dict[str, str] = field(default_factory=dict)
    missing: MissingExtraError | None = None

    def __post_init__(self) -> None:
        self.reader = SeekingReader(self.stream, validate_crcs=True, record_size_limit=MAX_RECORD_SIZE)
        self.summary = self.reader.get_summary()
        self._refuse_labhil_recording()
        self._refuse_claims()

    def columns(self, wanted: Sequence[str]) -> McapColumns:
        """Read the columns of the wanted topics; other columns have only names."""
        first = dict(self._first_messages())
        if not first and self.missing is not None:
            raise self.missing
        if not first:
            reasons = _format_skipped(tuple(self.skipped_topics.items()))
            raise TableError(
                f"{self.path}: expected an MCAP file with messages in {', '.join(ENCODINGS)} that hold "
                f"numbers, found {reasons or 'one without messages'}"
            )
        self.failed.clear()  # the messages that were decoded to find the columns are decoded again
        self.first_failure.clear()
        columns = read_topics(
            self.path,
            first,
            self._messages,
            wanted,
            clocks={topic: _find_stamp(message) for topic, message in first.items()},
            kind=McapColumns,
            what="an MCAP file",
        )
        assert isinstance(columns, McapColumns)
        decode_faults = tuple(
            f"{count} messages of {topic} cannot be decoded; the first: {self.first_failure[topic]}"
            for topic, count in self.failed.items()
        )
        return replace(
            columns, decode_faults=decode_faults, skipped_topics=tuple(self.skipped_topics.items())
        )

    def _refuse_labhil_recording(self) -> None:
        channels = self.summary.channels.values() if self.summary else ()
        if any("labhil.stream" in channel.metadata for channel in channels):
            raise TableError(
                f"{self.path}: expected a table, found a labhil recording, which needs no import"
            )

    def _refuse_claims(self) -> None:
        """Raise ImplausibleError if the chunks claim more than the file can contain."""
        budget = Budget.of(self.path.stat().st_size)
        for chunk in self.summary.chunk_indexes if self.summary else ():
            budget.take_content(chunk.uncompressed_size)

    def _first_messages(self) -> Iterator[tuple[str, Any]]:
        """First decodable message of each topic; topics without one are put into ``skipped_topics``."""
        attempts: Counter[str] = Counter()
        decoded: set[str] = set()
        for topic, message in self._candidates(decoded, attempts):
            attempts[topic] += 1
            if message is None:
                self.skipped_topics.setdefault(topic, self.first_failure[topic])
            else:
                decoded.add(topic)
                self.skipped_topics.pop(topic, None)
                yield topic, message

    def _candidates(
        self, decoded: set[str], attempts: Counter[str], max_attempts: int = 100
    ) -> Iterator[tuple[str, Any]]:
        """Messages of topics that are not yet ``decoded``, at most ``max_attempts`` of each.

        With an index topic by topic, otherwise in the order of the file.
        """
        requested: str | None
        for requested in self._topics() or (None,):
            for schema, channel, record in self.reader.iter_messages(requested):
                topic = channel.topic
                if topic not in decoded and attempts[topic] < max_attempts:
                    yield topic, self._decode(schema, channel, record)
                if requested is not None and (topic in decoded or attempts[topic] >= max_attempts):
                    break

    def _topics(self) -> list[str]:
        """Topics in the index of the file; none without an index."""
        if self.summary is None or not self.summary.chunk_indexes:
            return []
        return list(dict.fromkeys(channel.topic for channel in self.summary.channels.values()))

    def _messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        for schema, channel, record in self.reader.iter_messages([topic]):
            message = self._decode(schema, channel, record)
            yield record.log_time, {} if message is None else message

    def _decode(self, schema: Schema | None, channel: Any, record: Any) -> Any:
        """Decode a message to plain data; None if that fails."""
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
            message.setdefault(PUBLISH_TIME, Stamp(*divmod(record.publish_time, 10**9)))
        return message

    def _decoder(self, schema: Schema | None, channel: Any) -> Decode:
        form = MessageFormat(
            channel.message_encoding,
            "" if schema is None else schema.name,
            "" if schema is None else schema.encoding,
            b"" if schema is None else schema.data,
        )
        try:
            return make_decoder(form, f"{self.path}: {channel.topic}: a message in {form.encoding}")
        except MissingExtraError as error:
            self.missing = self.missing or error
            return _failing(DecodeError(str(error)))
        except DecodeError as error:
            return _failing(error)


def _failing(error: DecodeError) -> Decode:
    """Decoder of a channel that cannot be decoded: it fails with every message."""

    def fail(payload: bytes) -> Any:
        raise error

    return fail


def _find_stamp(message: Any) -> FieldPath:
    """Path to the stamp of a message; that of a header if there is none."""
    for path in STAMP_PATHS:
        value = message
        for step in path:
            value = value.get(step) if isinstance(value, Mapping) else getattr(value, str(step), None)
        if hasattr(value, "sec") and hasattr(value, "nanosec"):
            return path
    return STAMP


def _format_skipped(skipped_topics: Sequence[tuple[str, str]]) -> str:
    listed = [f"{topic} is no column: {reason}" for topic, reason in skipped_topics[:MAX_LISTED]]
    more = (
        [f"{len(skipped_topics) - MAX_LISTED} more topics are none"]
        if len(skipped_topics) > MAX_LISTED
        else []
    )
    return "; ".join([*listed, *more])
