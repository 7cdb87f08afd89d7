"""The recorder: everything that is published goes into one file, as it is, and what is lost is counted.

A thread of the subscription hands payloads over; one writer thread learns what a stream is (its publisher
says so before the first sample, and is asked where that was missed), stores the bytes, counts the holes
in ``seq`` and forces the file to the disk. A stream whose publisher dies is kept as far as it came; a
disk that fails ends the recording, but never holds up the publishers.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from labhil.bus.ask import ask
from labhil.bus.keys import ALL_SCHEMAS, ALL_STREAMS, EVENT, SETPOINT, schema_key, split_key
from labhil.bus.session import Bus
from labhil.bus.subscribe import subscribe
from labhil.codec import stream_from_json
from labhil.documents import parse_json
from labhil.errors import BusError, CommandRefusedError, ProtocolError, RecordingFailedError
from labhil.recording.device_clocks import ClockWatch, DeviceClock, clocks_to_metadata
from labhil.recording.writer import RecordingWriter
from labhil.service.recorded import RecordedStream, StreamSummary
from labhil.signals import Direction

TICK = 0.1
"""s; how long the writer thread waits for samples before it looks at the clock."""

STATUS_INTERVAL = 1.0
SCHEMA_TIMEOUT = 1.0
SCHEMA_INTERVAL = 0.25
"""s between two questions for a schema that nobody answered."""

QUIET = 0.1
LONGEST_SETTLING = 1.0
"""At the end what is still on its way is waited for: until nothing came for ``QUIET`` s, or so long."""

UNEXPLAINED = (
    BusError,
    CommandRefusedError,
    ProtocolError,
    LookupError,
    AttributeError,
    TypeError,
    ValueError,
)
"""A publisher that is not known yet, or gone for good, or that says something else than what a stream is."""


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """What was recorded: ``duration`` in s of the host's clock, from the first sample to the last."""

    path: Path
    duration: float
    streams: tuple[StreamSummary, ...]


class Recorder:
    """Records all streams and events of a bus from the moment it is made; make it before the devices.

    ``attachments`` maps names to whole files (the rig file as ``rig.toml``), ``metadata`` names to
    tables of strings. Raises what :class:`RecordingWriter` raises when the file cannot be made.

    ``failure`` tells why the recording ended early (the disk), None while all is well; ``on_failure`` is
    called once it does, in the writer's thread.
    """

    def __init__(
        self,
        bus: Bus,
        path: Path,
        *,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        on_failure: Callable[[], object] = lambda: None,
    ) -> None:
        self.failure: RecordingFailedError | None = None
        self._on_failure = on_failure
        self._bus = bus
        self._channels: dict[str, RecordedStream] = {}
        self._told: dict[tuple[str, str], bytes] = {}
        self._queue: queue.SimpleQueue[tuple[str, list[bytes]] | None] = queue.SimpleQueue()
        self._arrived_at = time.monotonic()
        self._status_at = time.monotonic()
        self._writer = RecordingWriter(path)
        self._finished = False
        try:
            for name, data in (attachments or {}).items():
                self._writer.attach(name, _media_type(name), data)
            for name, table in (metadata or {}).items():
                self._writer.metadata(name, table)
            self._writer.flush()
            self._schemas = subscribe(bus, ALL_SCHEMAS, self._receive_schema)
            self._subscription = subscribe(bus, ALL_STREAMS, self._receive)
        except BaseException:
            self._writer.abandon()
            raise
        self._thread = threading.Thread(target=self._run, name=f"record {path.name}")
        self._thread.start()

    def finish(self, exit_status: str = "done", reason: str = "") -> RecordingSummary:
        """Take in what is still on its way, end the file and give it its name; safe to call twice.

        RecordingFailedError when the disk failed: what was flushed before can still be read.
        """
        if not self._finished:
            self._finished = True
            self._stop()
            self._guarded(self._write_rest, exit_status, reason)
        if self.failure is not None:
            raise self.failure
        return self.summary()

    def summary(self) -> RecordingSummary:
        """What has been recorded so far; may be asked for at any time, from any thread."""
        channels = [channel for channel in list(self._channels.values()) if channel.samples]
        ends = [(channel.first_ns, channel.last_ns) for channel in channels]
        duration = (max(end for _, end in ends) - min(start for start, _ in ends)) * 1e-9 if ends else 0.0
        streams = tuple(channel.summary() for channel in channels)
        return RecordingSummary(self._writer.path, duration, streams)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._finished:
            return
        if error is None:
            self.finish()
            return
        try:
            self.finish("failed", f"{type(error).__name__}: {error}")
        except RecordingFailedError as failure:
            error.add_note(str(failure))  # the first error is what ended the run

    def _receive(self, key: str, payloads: list[bytes]) -> None:
        self._arrived_at = time.monotonic()
        self._queue.put((key, payloads))

    def _receive_schema(self, key: str, payloads: list[bytes]) -> None:
        self._told[split_key(key)] = payloads[-1]

    def _stop(self) -> None:
        deadline = time.monotonic() + LONGEST_SETTLING
        while time.monotonic() < min(deadline, self._arrived_at + QUIET):
            time.sleep(QUIET / 5)
        self._subscription.close()
        self._schemas.close()
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        while True:
            try:
                item = self._queue.get(timeout=TICK)
            except queue.Empty:
                self._guarded(self._tick)
                continue
            if item is None:
                return
            self._guarded(self._take, *item)
            self._guarded(self._tick)

    def _guarded(self, action: Callable[..., None], *args: Any) -> None:
        """Once the recording has failed, nothing is done, so that publishers are not held up."""
        if self.failure is not None:
            return
        try:
            action(*args)
        except RecordingFailedError as failure:
            self.failure = failure
            self._on_failure()
        except Exception as error:  # noqa: BLE001 - a thread that dies in silence would lose everything after it
            self._writer.abandon()
            self.failure = RecordingFailedError(f"{self._writer.part}: the recorder failed: {error!r}")
            self._on_failure()

    def _take(self, key: str, payloads: list[bytes]) -> None:
        device, stream = split_key(key)
        if stream == EVENT:
            for payload in payloads:
                self._writer.event(device, *_event(payload))
        elif stream != SETPOINT:
            channel = self._channels.setdefault(key, RecordedStream(device, stream))
            channel.waiting.extend(payloads)
            self._store(channel)

    def _tick(self) -> None:
        for channel in self._channels.values():
            if channel.waiting:
                self._store(channel)
        if time.monotonic() >= self._status_at:
            self._write_status()
        self._writer.flush_when_due()

    def _store(self, channel: RecordedStream) -> None:
        """Write what waits, as soon as it is known what it is."""
        if channel.number is None:
            self._learn(channel)
        if channel.number is None:
            return
        payloads, channel.waiting = channel.waiting, []
        try:
            self._writer.write(channel.number, payloads)
            channel.count(payloads)
        except ProtocolError:
            self._store_one_by_one(channel, channel.number, payloads)

    def _store_one_by_one(self, channel: RecordedStream, number: int, payloads: list[bytes]) -> None:
        """Among these payloads is one that is no message of the stream: keep the others."""
        for payload in payloads:
            try:
                self._writer.write(number, [payload])
                channel.count([payload])
            except ProtocolError as error:
                channel.refused += 1
                if channel.refused == 1:
                    self._note(f"/{channel.device}/{channel.stream}: left out what is no sample: {error}")

    def _learn(self, channel: RecordedStream) -> None:
        """Open the channel if it is known what it is; else ask, but not all the time."""
        try:
            reply = self._schema_of(channel)
            if reply is None:
                return
            stream = stream_from_json(reply["stream"])
            told = {str(name): str(value) for name, value in reply["metadata"].items()}
            channel.speed = float(told.get("speed", "1"))
            if any(signal.direction is not Direction.REQUESTED for signal in stream.signals):
                channel.clock = ClockWatch()
            channel.number = self._writer.add_stream(channel.device, stream, told)
        except (
            BusError,
            CommandRefusedError,
            ProtocolError,
            LookupError,
            AttributeError,
            ValueError,
        ) as error:
            # its publisher may not be known here yet, or gone for good
            channel.trouble = str(error)

    def _schema_of(self, channel: RecordedStream) -> dict[str, Any] | None:
        told = self._told.get((channel.device, channel.stream))
        if told is not None:
            return dict(parse_json(told))
        if time.monotonic() < channel.asked_at + SCHEMA_INTERVAL:
            return None
        channel.asked_at = time.monotonic()
        return ask(self._bus, schema_key(channel.device, channel.stream), timeout=SCHEMA_TIMEOUT)

    def _write_status(self) -> None:
        self._status_at = time.monotonic() + STATUS_INTERVAL
        now = time.time_ns()
        streams = {
            f"/{channel.device}/{channel.stream}": {
                "received": channel.samples,
                "gaps": channel.gaps,
                "refused": channel.refused,
                "waiting": len(channel.waiting),
                "lag": (now - channel.last_ns) * 1e-9 if channel.samples else None,
            }
            for channel in self._channels.values()
        }
        self._writer.event(
            "recorder", now, {"streams": streams, "queued": self._queue.qsize()}, topic="status"
        )

    def _write_rest(self, exit_status: str, reason: str) -> None:
        """The last status, what nobody explained, and the end of the file."""
        for channel in self._channels.values():
            channel.asked_at = float("-inf")
            if channel.waiting:
                self._store(channel)
            if channel.waiting:
                self._keep_unexplained(channel)
        self._write_status()
        for name, table in clocks_to_metadata(self._clocks()).items():
            self._writer.metadata(name, table)
        self._writer.finish(exit_status, reason)

    def _clocks(self) -> dict[str, DeviceClock]:
        """How each device's clock ran, by its first stream."""
        clocks: dict[str, DeviceClock] = {}
        for channel in self._channels.values():
            found = channel.clock.clock(channel.speed) if channel.clock is not None else None
            if found is not None:
                clocks.setdefault(channel.device, found)
        return clocks

    def _keep_unexplained(self, channel: RecordedStream) -> None:
        """Attach the bytes of a stream whose schema nobody told: no sample is thrown away."""
        name = f"{channel.device}.{channel.stream}.unexplained"
        self._writer.attach(name, "application/octet-stream", b"".join(channel.waiting))
        self._note(
            f"/{channel.device}/{channel.stream}: {len(channel.waiting)} samples came in, but nobody said "
            f"what they are ({channel.trouble}); their bytes are attached as {name}"
        )

    def _note(self, text: str) -> None:
        self._writer.event("recorder", time.time_ns(), {"text": text})


def _event(payload: bytes) -> tuple[int, dict[str, Any]]:
    """The time and the body of an event; one that is no JSON is kept as text."""
    try:
        body = parse_json(payload)
        t_ns = int(body["t_ns"])
    except (ValueError, KeyError, TypeError):
        return time.time_ns(), {"text": payload.decode("utf-8", "replace")}
    return t_ns, body


def _media_type(name: str) -> str:
    types = {".toml": "application/toml", ".json": "application/json", ".txt": "text/plain"}
    return types.get(Path(name).suffix, "application/octet-stream")
