"""Writer of recordings; after a crash only data since the last flush are lost.

An unfinished recording is named ``NAME.mcap.part``; ``finish`` renames it. Every few tenths of a second the
open chunk is closed and the file is forced to the disk. The first disk error ends the recording, since later
data in the file could not be located.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from labhil.codec import LAYOUT_VERSION, Codec, stamps_of, stream_to_json
from labhil.errors import ProtocolError, RecordingError, RecordingFailedError
from labhil.recording.event_schemas import schema_of, with_timestamp
from labhil.recording.log_times import LogTimes
from labhil.signals import Batch, Direction, Stream
from labhil.version import __version__

FLUSH_INTERVAL = 0.2
"""Time between flushes, s; a killed process loses the data since the last one."""

MIN_FREE_SPACE = 16 * 1024 * 1024
"""Free space on the disk below which a recording ends, so that its end can be written, bytes."""

CHUNK_SIZE = 256 * 1024
MAX_TIME_NS = 2**63 - 1
EVENT_TOPIC = "event"


class RecordingWriter:
    """Writer of a recording, for one thread.

    Args:
        path: the file.
        flush_interval: time between flushes, s; with infinity the same samples always make the same bytes.

    Raises:
        RecordingError: The file or an unfinished recording of its name exists.
        RecordingFailedError: The disk failed (any method). The ``.part`` file remains, readable up to the
            last flush.

    ``longest_flush`` is how long the disk took at most to take what was forced to it, s.
    """

    def __init__(self, path: Path, *, flush_interval: float = FLUSH_INTERVAL) -> None:
        self.path = path
        self._flush_interval = flush_interval
        self.part = path.with_name(path.name + ".part")
        self.failure: str | None = None
        self.longest_flush = 0.0
        self._finished = False
        self._codecs: dict[int, Codec] = {}
        self._log_times: dict[int, LogTimes] = {}
        self._json_channels: dict[str, int] = {}
        if path.exists():
            raise RecordingError(f"{path}: expected a new file, found one that exists; nothing was written")
        self._file = _create_draft(self.part)
        _sync_folder(self.part)
        self._writer = Writer(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.LZ4)
        self._flushed_at = time.monotonic()
        with self._disk_errors():
            self._writer.start(library=f"labhil {__version__}")

    def add_stream(self, device: str, stream: Stream, metadata: Mapping[str, str] | None = None) -> int:
        """Open a channel ``/<device>/<stream>``.

        Args:
            device: name of the device.
            stream: declaration of the stream.
            metadata: further facts about the stream: ``speed``, ``serial``, ``firmware``.

        Returns:
            Number of the channel.
        """
        codec = Codec(stream)
        channel_metadata = {
            **(metadata or {}),
            "labhil.layout": LAYOUT_VERSION,
            "labhil.stream": stream_to_json(stream),
            "device": device,
            **{f"labhil.unit.{signal.name}": signal.unit for signal in stream.signals},
        }
        with self._disk_errors():
            schema = self._writer.register_schema(
                codec.schema_name, SchemaEncoding.Protobuf, codec.descriptor_set()
            )
            topic = f"/{device}/{stream.name}"
            channel = int(
                self._writer.register_channel(topic, MessageEncoding.Protobuf, schema, channel_metadata)
            )
        self._codecs[channel] = codec
        if any(signal.direction is not Direction.REQUESTED for signal in stream.signals):
            self._log_times[channel] = LogTimes(float(channel_metadata.get("speed", "1")))
        return channel

    def write(self, channel: int, samples: Batch | Sequence[bytes]) -> None:
        """Write samples.

        Args:
            channel: number of the channel.
            samples: samples, or encoded messages.

        Raises:
            ProtocolError: A message does not belong to the stream; nothing is written.
        """
        codec = self._codecs[channel]
        payloads = codec.encode(samples) if isinstance(samples, Batch) else samples
        if not payloads:
            return
        for payload in payloads:
            if len(payload) != codec.size:
                raise ProtocolError(
                    f"stream {codec.stream.name!r}: expected {codec.size} bytes, found {len(payload)}"
                )
        stamps = stamps_of(payloads)
        if (stamps < 0).any():  # negative log times make an unreadable file
            raise ProtocolError(f"stream {codec.stream.name!r}: expected stamps of 0 or more, found negative")
        times = self._log_times.get(channel)  # requested values have no device clock
        log_ns = stamps[:, 1] if times is None else times.of(stamps[:, 1], stamps[:, 2])
        with self._disk_errors():
            for payload, seq, t_ns in zip(payloads, stamps[:, 0].tolist(), log_ns.tolist(), strict=True):
                self._writer.add_message(channel, t_ns, payload, t_ns, seq & 0xFFFFFFFF)
        self.flush_when_due()

    def event(self, device: str, t_ns: int, body: Mapping[str, Any], *, topic: str = EVENT_TOPIC) -> None:
        """Write an event as JSON to ``/<device>/<topic>``.

        Args:
            device: name of the device.
            t_ns: Unix time, ns.
            body: fields of the event.
            topic: last part of the topic.
        """
        name = f"/{device}/{topic}"
        t_ns = min(max(int(t_ns), 0), MAX_TIME_NS)
        with self._disk_errors():
            if name not in self._json_channels:
                schema = self._writer.register_schema(
                    f"labhil.{topic}", SchemaEncoding.JSONSchema, schema_of(topic)
                )
                channel = self._writer.register_channel(
                    name, MessageEncoding.JSON, schema, {"device": device}
                )
                self._json_channels[name] = int(channel)
            data = json.dumps(with_timestamp(body, t_ns)).encode()
            self._writer.add_message(self._json_channels[name], t_ns, data, t_ns)
        self.flush_when_due()

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file, such as the rig file."""
        with self._disk_errors():
            self._writer.add_attachment(0, 0, name, media_type, data)

    def metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Add metadata, a table of strings."""
        with self._disk_errors():
            self._writer.add_metadata(name, {key: str(value) for key, value in data.items()})

    def flush_when_due(self) -> None:
        """Flush if the last flush was at least ``flush_interval`` ago."""
        if time.monotonic() - self._flushed_at >= self._flush_interval:
            self.flush()

    def flush(self) -> None:
        """Close the open chunk and force everything to the disk."""
        with self._disk_errors():
            self._writer.flush()
            began = time.monotonic()
            os.fdatasync(self._file.fileno())
            self.longest_flush = max(self.longest_flush, time.monotonic() - began)
            free = shutil.disk_usage(self.part.parent).free
        self._flushed_at = time.monotonic()
        if free < MIN_FREE_SPACE:
            self.finish("failed", "disk nearly full")
            self.failure = (
                f"{self.path}: the recording ended early, because only {free / 1e6:.0f} MB are left on the "
                "disk; what came in before can be read"
            )
            raise RecordingFailedError(self.failure)

    def finish(self, exit_status: str = "done", reason: str = "") -> Path:
        """Write the end of the file and rename it; safe to call twice.

        Args:
            exit_status: exit status in the metadata ``end``.
            reason: reason in these metadata.

        Returns:
            Path of the recording.
        """
        if self._finished:
            return self.path
        self.metadata("end", {"exit_status": exit_status, "reason": reason})
        with self._disk_errors():
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            self.part.replace(self.path)
            _sync_folder(self.path)
        self._finished = True
        return self.path

    def abandon(self) -> None:
        """Close the ``.part`` file without an end; safe to call twice."""
        # close() writes buffered data, which fails on a full disk; the file is closed nevertheless
        with suppress(OSError):
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._finished:
            return
        if error is None:
            self.finish()
        else:
            self.abandon()

    @contextmanager
    def _disk_errors(self) -> Iterator[None]:
        if self.failure is not None:
            raise RecordingFailedError(self.failure)
        try:
            yield
        except OSError as error:
            self.failure = (
                f"{self.part}: the recording ended early, because the disk failed: {error}; "
                "what was flushed before can be read"
            )
            self.abandon()
            raise RecordingFailedError(self.failure) from error


def media_type(name: str) -> str:
    """Media type of an attachment, by the extension of its name."""
    types = {
        ".toml": "application/toml",
        ".json": "application/json",
        ".csv": "text/csv",
        ".txt": "text/plain",
    }
    return types.get(Path(name).suffix, "application/octet-stream")


def _sync_folder(path: Path) -> None:
    """Force the name of a file to the disk, so that the file still has it after a power failure."""
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        # some file systems (FUSE, SMB) have no fsync of folders, and store names immediately
        with suppress(OSError):
            os.fsync(folder)
    finally:
        os.close(folder)


def _create_draft(part: Path) -> BinaryIO:
    if part.exists():
        raise RecordingError(
            f"{part}: expected no unfinished recording of this name, found one; move it away first"
        )
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        return part.open("xb")
    except OSError as error:
        raise RecordingFailedError(f"{part}: the recording could not be created: {error.strerror}") from error
