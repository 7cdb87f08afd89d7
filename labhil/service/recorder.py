"""The recorder: writes everything that is published on a bus to one file, unchanged, and counts losses.

The thread of the subscription queues payloads. One writer thread gets the schema of each stream, which its
publisher declares before the first sample and otherwise answers on request, writes the bytes, counts gaps in
``seq`` and forces the file to the disk. The samples of a publisher that dies are kept; a disk that fails ends
the recording but never blocks publishers. Payloads that a slow disk has not taken yet wait in memory; where
too many wait, the recording ends with all that wait.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from labhil.bus.authentication import Refusals
from labhil.bus.incoming import (
    MAX_SCHEMA_BYTES,
    EventMessage,
    StreamDeclaration,
    load,
    parse,
)
from labhil.bus.keys import ALL_STREAMS, EVENT, SETPOINT, split_key
from labhil.bus.session import Bus
from labhil.bus.subscribe import subscribe
from labhil.codec import stream_from_json
from labhil.errors import BusError, CommandRefusedError, ProtocolError, RecordingFailedError
from labhil.host_clock import HostClockWatch, unix_ns
from labhil.recording.device_clocks import clocks_to_metadata
from labhil.recording.writer import RecordingWriter, media_type
from labhil.service.recorded import RecordedStream, RecordingSummary, device_clocks
from labhil.service.stream_ends import StreamEnds
from labhil.service.stream_schemas import MAX_STREAMS, StreamSchemas
from labhil.service.write_backlog import WriteBacklog
from labhil.supervised import SupervisedThread

GATHER, TICK = 0.04, 0.1
"""s; what comes within the one is written together, and after the other without samples the writer thread
looks at the clock."""

STATUS_INTERVAL = 1.0

QUIET = 0.1
LONGEST_SETTLING = 1.0
"""At the end what is still on its way is waited for: until nothing came for ``QUIET`` s, or so long."""

MAX_WAITING_BYTES = 64 * 1024 * 1024
"""Bytes of samples that wait until somebody says what they are: some minutes of a fast device, and no more
than a small machine can spare."""

UNEXPLAINED = (
    BusError, CommandRefusedError, ProtocolError,
    LookupError, AttributeError, TypeError, ValueError, ArithmeticError,
)  # fmt: skip
"""A publisher that is not known yet, or gone for good, or that says something else than what a stream is."""

MAX_CLOCK_WARNINGS = 20
"""How often a recording's warnings say that the wall clock was set, or the machine suspended."""

MAX_ODD_EVENTS, MAX_ODD_EVENT_BYTES = 100, 1000
"""How many events of a device that are none are kept as text, and how many bytes of each."""


class Recorder:
    """Records all streams and events of a bus from its construction on; make it before the devices.

    Args:
        bus: The bus.
        path: The recording.
        attachments: Files by name, such as the rig file as ``rig.toml``.
        metadata: Tables of strings by name.
        waits: Keep of the samples before :meth:`begin` only the newest second (but all events): the devices
            of one run are not ready at the same time.
        on_failure: Is called in the writer's thread once the recording fails.
        max_backlog: Bytes that may wait for the disk before :meth:`check` raises that it is too slow.
        slow_flush: Time of one forced write from which the disk is called slow, in an event and in the
            warnings of the summary, s.

    Attributes:
        failure: Why the recording ended early, such as a full disk; None while it has not.

    Raises:
        RecordingFailedError: The file cannot be made.
    """

    def __init__(
        self,
        bus: Bus,
        path: Path,
        *,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        waits: bool = False,
        on_failure: Callable[[], object] = lambda: None,
        max_backlog: int = MAX_WAITING_BYTES,
        slow_flush: float = 2.0,
    ) -> None:
        self._waits = waits
        self._backlog = WriteBacklog(max_backlog, slow_flush)
        self._is_called_slow = False
        self.failure: RecordingFailedError | None = None
        self._deaf: RecordingFailedError | None = None
        self._on_failure = on_failure
        self._bus = bus
        self._channels: dict[str, RecordedStream] = {}
        # what is refused is refused in the threads that listen, and written in the one that writes
        self._remarks: queue.Queue[str] = queue.Queue()
        self._refusals = Refusals(self._remarks.put)
        self._waiting = 0
        self._queue: queue.Queue[tuple[str, list[bytes]] | None] = queue.Queue()
        self._arrived_at = time.monotonic()
        self._status_at = time.monotonic()
        self._host_clocks = HostClockWatch()
        self._clock_warnings: list[str] = []
        self._writer = RecordingWriter(path)
        self._finished = False
        self._warnings: tuple[str, ...] = ()
        try:
            for name, data in (attachments or {}).items():
                self._writer.attach(name, media_type(name), data)
            for name, table in (metadata or {}).items():
                self._writer.metadata(name, table)
            self._writer.flush()
            with ExitStack() as listening:
                self._schemas = listening.enter_context(closing(StreamSchemas(bus, self._refusals)))
                self._ends = listening.enter_context(closing(StreamEnds(bus, self._refusals)))
                self._subscription = subscribe(bus, ALL_STREAMS, self._receive, self._refusals, gather=GATHER)
                listening.enter_context(self._subscription)
                self._listening = listening.pop_all()
        except BaseException:
            self._writer.abandon()
            for begun in (self._writer.path, self._writer.part):
                begun.unlink(missing_ok=True)  # nothing is in it, and it would look like a recording
            raise
        self._thread = SupervisedThread(self._run, f"record {path.name}", on_failure=on_failure)
        self._thread.start()

    def begin(self) -> None:
        """Keep all samples from now on."""
        self._waits = False

    def finish(self, exit_status: str = "done", reason: str = "") -> RecordingSummary:
        """Write what is still arriving, complete the file and give it its name; safe to call twice.

        Raises:
            RecordingFailedError: The disk failed; what was flushed before can still be read.
        """
        if not self._finished:
            self._finished = True
            self._stop()
            self._guard(self._write_rest, exit_status, reason)
            for channel in self._channels.values():
                channel.clock = None  # megabytes of stamps, which are written now
            self.failure = self.failure or self._deaf
        if self.failure is not None:
            raise self.failure
        return self.summary()

    def summary(self) -> RecordingSummary:
        """Return what has been recorded so far; safe from any thread."""
        channels = [channel for channel in list(self._channels.values()) if channel.samples]
        spans = [(channel.first_ns, channel.last_ns) for channel in channels]
        duration = (
            (max(last for _, last in spans) - min(first for first, _ in spans)) * 1e-9 if spans else 0.0
        )
        streams = tuple(channel.summary() for channel in channels)
        return RecordingSummary(self._writer.path, duration, streams, self._warnings)

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
        if self._backlog.admit(payloads):
            self._queue.put((key, payloads))

    def check(self) -> None:
        """Raise RecordingFailedError where nothing is recorded any more, for any reason."""
        if self.failure is None and not self._finished:
            parts = (self._subscription, self._schemas, self._ends, self._thread)
            why = next((why for part in parts if (why := part.failure())), "")
            if why:
                self._deaf = RecordingFailedError(f"{self._writer.path}: the recorder failed: {why}")
            elif why := self._backlog.overflow():
                self._deaf = RecordingFailedError(
                    f"{self._writer.path}: the recording ended early, because {why}"
                )
            if self._deaf is not None:
                raise self._deaf
        if self.failure is not None:
            raise self.failure

    def _stop(self) -> None:
        deadline = time.monotonic() + LONGEST_SETTLING
        while time.monotonic() < min(deadline, self._arrived_at + QUIET):
            time.sleep(QUIET / 5)
        self._ends.check_publishers(list(self._channels.values()))
        self._listening.close()
        self._thread.end()
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        while True:
            try:
                item = self._queue.get(timeout=TICK)
            except queue.Empty:
                self._guard(self._tick)
                continue
            if item is None:
                return
            self._guard(self._take, *item)
            self._backlog.note_written(item[1])
            self._guard(self._tick)

    def _guard(self, action: Callable[..., None], *args: Any) -> None:
        """Run an action and note its failure; after a failure run nothing, so that publishers never wait."""
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
                self._take_event(key, device, payload)
        elif stream != SETPOINT:
            if key not in self._channels and len(self._channels) >= MAX_STREAMS:
                self._refusals.note(
                    "new streams", f"there are {MAX_STREAMS} already; {key[:200]} is left out"
                )
                return
            channel = self._channels.setdefault(key, RecordedStream(device, stream))
            self._keep_waiting(key, channel, payloads)
            self._store(channel)

    def _keep_waiting(self, key: str, channel: RecordedStream, payloads: list[bytes]) -> None:
        """Keep samples until their schema is known, as long as there is room."""
        size = sum(map(len, payloads))
        if channel.number is None:
            if self._waiting + size > MAX_WAITING_BYTES:
                channel.refused += len(payloads)
                self._refusals.note(key, f"{len(payloads)} samples that nobody explains are left out")
                return
            self._waiting += size
            channel.size += size
        channel.waiting.extend(payloads)

    def _take_event(self, key: str, device: str, payload: bytes) -> None:
        """Store an event; of a malformed one keep the beginning as text."""
        try:
            t_ns = parse(EventMessage, payload, "an event").t_ns
            body = load(payload, "an event")
        except CommandRefusedError as error:
            self._refusals.note(key, str(error))
            if self._refusals.counts[key] <= MAX_ODD_EVENTS:
                text = payload[:MAX_ODD_EVENT_BYTES].decode("utf-8", "replace")
                self._writer.event(device, unix_ns(), {"text": text})
            return
        self._writer.event(device, t_ns, body)

    def _tick(self) -> None:
        self._write_remarks()
        for channel in self._channels.values():
            if channel.waiting:
                self._store(channel)
        if time.monotonic() >= self._status_at:
            self._write_status()
        self._writer.flush_when_due()
        if not self._is_called_slow and (slow := self._backlog.slowness(self._writer.longest_flush)):
            self._is_called_slow = True
            self._writer.event("recorder", unix_ns(), {"kind": "slow_disk", "message": slow})

    def _store(self, channel: RecordedStream) -> None:
        """Write the waiting samples as soon as their schema is known."""
        if channel.number is None:
            self._open_channel(channel)
        if channel.number is None:
            return
        if self._waits:
            del channel.waiting[: -channel.second]
            return
        payloads, channel.waiting = channel.waiting, []
        self._waiting -= channel.size
        channel.size = 0
        try:
            self._writer.write(channel.number, payloads)
            channel.count(payloads)
        except ProtocolError:
            self._store_one_by_one(channel, channel.number, payloads)

    def _store_one_by_one(self, channel: RecordedStream, number: int, payloads: list[bytes]) -> None:
        """Store payloads of which at least one is malformed: keep the others."""
        for payload in payloads:
            try:
                self._writer.write(number, [payload])
                channel.count([payload])
            except ProtocolError as error:
                channel.refused += 1
                if channel.refused == 1:
                    self._note(f"/{channel.device}/{channel.stream}: left out what is no sample: {error}")

    def _open_channel(self, channel: RecordedStream) -> None:
        """Open the channel where its schema is known; otherwise request it, at most once per interval."""
        try:
            if (reply := self._schemas.schema_of(channel)) is None:
                return
            parse(StreamDeclaration, reply.stream, "a stream", MAX_SCHEMA_BYTES)
            stream = stream_from_json(reply.stream)
            metadata = dict(reply.metadata)
            channel.apply_schema(stream, metadata)
            channel.number = self._writer.add_stream(channel.device, stream, metadata)
        except UNEXPLAINED as error:
            # its publisher may not be known here yet, or gone for good
            channel.fault = str(error)

    def _write_status(self) -> None:
        self._status_at = time.monotonic() + STATUS_INTERVAL
        now = unix_ns()
        streams = {
            f"/{channel.device}/{channel.stream}": channel.status(now) for channel in self._channels.values()
        }
        self._writer.event(
            "recorder", now, {"streams": streams, "queued": self._queue.qsize()}, topic="status"
        )
        for kind, message in self._host_clocks.look():
            self._writer.event("recorder", now, {"kind": kind, "message": message})
            if len(self._clock_warnings) < MAX_CLOCK_WARNINGS:
                self._clock_warnings.append(message)

    def _write_rest(self, exit_status: str, reason: str) -> None:
        """Write the last status, samples without a schema, and the end of the file."""
        self._waits = False
        self._write_remarks()
        for channel in self._channels.values():
            channel.asked_at = float("-inf")
            if channel.waiting:
                self._store(channel)
            if channel.waiting:
                self._keep_unexplained(channel)
        lost = self._ends.count_missing(self._channels.values())
        self._write_status()
        slow = self._backlog.slowness(self._writer.longest_flush)
        notes = (
            lost
            + ((slow,) if slow else ())
            + tuple(
                f"{channel.device}/{channel.stream}: {fault.statement}"
                for channel in self._channels.values()
                for fault in channel.clock_faults()
            )
        )
        for note in notes:
            self._note(note)
        self._warnings = notes + tuple(self._clock_warnings)
        for name, table in clocks_to_metadata(device_clocks(self._channels.values())).items():
            self._writer.metadata(name, table)
        self._writer.finish(exit_status, reason)

    def _keep_unexplained(self, channel: RecordedStream) -> None:
        """Attach the bytes of a stream whose schema is unknown, so that no sample is lost."""
        name = f"{channel.device}.{channel.stream}.unexplained"
        self._writer.attach(name, "application/octet-stream", b"".join(channel.waiting))
        self._note(
            f"/{channel.device}/{channel.stream}: {len(channel.waiting)} samples came in, but nobody said "
            f"what they are ({channel.fault}); their bytes are attached as {name}"
        )

    def _write_remarks(self) -> None:
        while not self._remarks.empty():
            self._writer.event("recorder", unix_ns(), {"kind": "rejected", "message": self._remarks.get()})

    def _note(self, text: str) -> None:
        self._writer.event("recorder", unix_ns(), {"text": text})
