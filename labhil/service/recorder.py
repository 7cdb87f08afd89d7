"""The recorder: everything that is published goes into one file, as it is, and what is lost is counted.

A thread of the subscription hands payloads over; one writer thread learns what a stream is (its publisher
says so before the first sample, and is asked where that was missed), stores the bytes, counts the holes
in ``seq`` and forces the file to the disk. A stream whose publisher dies is kept as far as it came; a
disk that fails ends the recording, but never holds up the publishers. What a slow disk has not taken yet
waits in memory; where too much waits, the recording ends with all that waits.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from labhil.bus.authentication import Refusals
from labhil.bus.incoming import (
    LARGEST_SCHEMA,
    EventMessage,
    StreamDeclaration,
    excerpt,
    load,
    parse,
)
from labhil.bus.keys import ALL_STREAMS, EVENT, SETPOINT, split_key
from labhil.bus.session import Bus
from labhil.bus.subscribe import subscribe
from labhil.codec import stream_from_json
from labhil.errors import BusError, CommandRefusedError, ProtocolError, RecordingFailedError
from labhil.host_clock import unix_ns
from labhil.recording.device_clocks import ClockWatch, DeviceClock, clocks_to_metadata
from labhil.recording.stamps import HOST_CLOCK
from labhil.recording.writer import RecordingWriter, media_type
from labhil.service.recorded import RecordedStream, StreamSummary
from labhil.service.stream_ends import StreamEnds
from labhil.service.stream_schemas import MOST_STREAMS, StreamSchemas
from labhil.signals import Direction
from labhil.supervised import SupervisedThread

GATHER, TICK = 0.04, 0.1
"""s; what comes within the one is written together, and after the other without samples the writer thread
looks at the clock."""

STATUS_INTERVAL = 1.0

QUIET = 0.1
LONGEST_SETTLING = 1.0
"""At the end what is still on its way is waited for: until nothing came for ``QUIET`` s, or so long."""

MOST_WAITING = 64 * 1024 * 1024
"""Bytes of samples that wait until somebody says what they are: some minutes of a fast device, and no more
than a small machine can spare."""

UNEXPLAINED = (
    BusError,
    CommandRefusedError,
    ProtocolError,
    LookupError,
    AttributeError,
    TypeError,
    ValueError,
    ArithmeticError,
)
"""A publisher that is not known yet, or gone for good, or that says something else than what a stream is."""

MOST_ODD_EVENTS, LONGEST_ODD_EVENT = 100, 1000
"""How many events of a device that are none are kept as text, and how many bytes of each."""


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """What was recorded: ``duration`` in s of the host's clock, from the first sample to the last.

    ``warnings`` say what is wrong with the stamps of the devices' clocks, a sentence each; once it has ended.
    """

    path: Path
    duration: float
    streams: tuple[StreamSummary, ...]
    warnings: tuple[str, ...] = ()


class Recorder:
    """Records all streams and events of a bus from the moment it is made; make it before the devices.

    ``attachments`` maps names to whole files (the rig file as ``rig.toml``), ``metadata`` names to
    tables of strings. Raises what :class:`RecordingWriter` raises when the file cannot be made.

    ``failure`` tells why the recording ended early (the disk), None while all is well; ``on_failure`` is
    called once it does, in the writer's thread. One that ``waits`` keeps events from the start, and of the
    samples before :meth:`begin` only the newest second: devices of one run are not ready at the same time.

    ``most_queued`` is how much may wait for the disk, bytes, before :meth:`check` says that the disk is too
    slow: some minutes of a fast device, as much as waits for an explanation. What comes beyond twice that,
    while the run ends, is left out and counted as missing. A disk that takes longer than ``slow_flush`` (s)
    for what is forced to it is called slow, in an event and in the summary's warnings: one that spins up
    takes a second.
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
        most_queued: int = MOST_WAITING,
        slow_flush: float = 2.0,
    ) -> None:
        self._waits = waits
        self._most_queued, self._slow_flush = most_queued, slow_flush
        # each counted by one thread: bytes that came in and were kept, and those taken for the file
        self._received = self._taken = 0
        self._longest_queue = 0
        self._left_out = 0
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
        """Take in what is still on its way, end the file and give it its name; safe to call twice.

        RecordingFailedError when the disk failed: what was flushed before can still be read.
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
        """What has been recorded so far; may be asked for at any time, from any thread."""
        channels = [channel for channel in list(self._channels.values()) if channel.samples]
        ends = [(channel.first_ns, channel.last_ns) for channel in channels]
        duration = (max(end for _, end in ends) - min(start for start, _ in ends)) * 1e-9 if ends else 0.0
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
        size = sum(map(len, payloads))
        queued = self._received + size - self._taken
        if queued > 2 * self._most_queued:
            self._left_out += len(payloads)
            return
        self._received += size
        self._longest_queue = max(self._longest_queue, queued)
        self._queue.put((key, payloads))

    def check(self) -> None:
        """Raise RecordingFailedError when nothing is recorded any more, whatever the reason."""
        if self.failure is None and not self._finished:
            parts = (self._subscription, self._schemas, self._ends, self._thread)
            why = next((why for part in parts if (why := part.failure())), "")
            if why:
                self._deaf = RecordingFailedError(f"{self._writer.path}: the recorder failed: {why}")
            elif (queued := self._received - self._taken) > self._most_queued:
                self._deaf = RecordingFailedError(
                    f"{self._writer.path}: the recording ended early, because the disk is too slow: "
                    f"{queued / 1e6:.1f} MB wait to be written; they are written before the recording ends"
                )
            if self._deaf is not None:
                raise self._deaf
        if self.failure is not None:
            raise self.failure

    def _stop(self) -> None:
        deadline = time.monotonic() + LONGEST_SETTLING
        while time.monotonic() < min(deadline, self._arrived_at + QUIET):
            time.sleep(QUIET / 5)
        self._ends.look_for_publishers(list(self._channels.values()))
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
            self._taken += sum(map(len, item[1]))
            self._guard(self._tick)

    def _guard(self, action: Callable[..., None], *args: Any) -> None:
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
                self._take_event(key, device, payload)
        elif stream != SETPOINT:
            if key not in self._channels and len(self._channels) >= MOST_STREAMS:
                self._refusals.note(
                    "new streams", f"there are {MOST_STREAMS} already; {key[:200]} is left out"
                )
                return
            channel = self._channels.setdefault(key, RecordedStream(device, stream))
            self._keep_waiting(key, channel, payloads)
            self._store(channel)

    def _keep_waiting(self, key: str, channel: RecordedStream, payloads: list[bytes]) -> None:
        """Let samples wait until it is known what they are, as long as there is room."""
        size = sum(map(len, payloads))
        if channel.number is None:
            if self._waiting + size > MOST_WAITING:
                channel.refused += len(payloads)
                self._refusals.note(key, f"{len(payloads)} samples that nobody explains are left out")
                return
            self._waiting += size
            channel.size += size
        channel.waiting.extend(payloads)

    def _take_event(self, key: str, device: str, payload: bytes) -> None:
        """Store an event; of one that is none the beginning is kept as text."""
        try:
            t_ns = parse(EventMessage, payload, "an event").t_ns
            body = load(payload, "an event")
        except CommandRefusedError as error:
            self._refusals.note(key, str(error))
            if self._refusals.counts[key] <= MOST_ODD_EVENTS:
                text = payload[:LONGEST_ODD_EVENT].decode("utf-8", "replace")
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
        if not self._is_called_slow and (slow := self._slowness()):
            self._is_called_slow = True
            self._writer.event("recorder", unix_ns(), {"kind": "slow_disk", "message": slow})

    def _slowness(self) -> str:
        """What is to be said of a slow disk; "" of one that is none."""
        longest, megabytes = self._writer.longest_flush, self._longest_queue / 1e6
        if longest <= self._slow_flush and not self._left_out:
            return ""
        lost = "nothing is lost"
        if self._left_out:
            lost = f"{self._left_out} messages found no room and are missing"
        return (
            f"the disk is slow: it took up to {longest:.1f} s for what was forced to it, and up to "
            f"{megabytes:.2f} MB waited for it; {lost}"
        )

    def _store(self, channel: RecordedStream) -> None:
        """Write what waits, as soon as it is known what it is."""
        if channel.number is None:
            self._learn(channel)
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
            if (reply := self._schemas.schema_of(channel)) is None:
                return
            parse(StreamDeclaration, reply.stream, "a stream", LARGEST_SCHEMA)
            stream = stream_from_json(reply.stream)
            metadata = dict(reply.metadata)
            speed = float(metadata.get("speed", "1"))
            if not 0 < speed < float("inf"):
                raise ProtocolError(f"speed: expected a positive number, found {excerpt(metadata['speed'])}")
            channel.speed = speed
            channel.rate, channel.steady_host = stream.rate, HOST_CLOCK in metadata
            channel.second = max(1, round(stream.rate * channel.speed))
            if any(signal.direction is not Direction.REQUESTED for signal in stream.signals):
                channel.clock = ClockWatch()
            channel.number = self._writer.add_stream(channel.device, stream, metadata)
        except UNEXPLAINED as error:
            # its publisher may not be known here yet, or gone for good
            channel.fault = str(error)

    def _write_status(self) -> None:
        self._status_at = time.monotonic() + STATUS_INTERVAL
        now = unix_ns()
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
        slow = self._slowness()
        self._warnings = (
            lost
            + ((slow,) if slow else ())
            + tuple(
                f"{channel.device}/{channel.stream}: {fault.statement}"
                for channel in self._channels.values()
                for fault in channel.clock_faults()
            )
        )
        for warning in self._warnings:
            self._note(warning)
        for name, table in clocks_to_metadata(self._clocks()).items():
            self._writer.metadata(name, table)
        self._writer.finish(exit_status, reason)

    def _clocks(self) -> dict[str, DeviceClock]:
        """How each device's clock ran, by its first stream."""
        clocks: dict[str, DeviceClock] = {}
        for channel in self._channels.values():
            clock = channel.clock.clock(channel.speed) if channel.clock is not None else None
            if clock is not None:
                clocks.setdefault(channel.device, clock)
        return clocks

    def _keep_unexplained(self, channel: RecordedStream) -> None:
        """Attach the bytes of a stream whose schema is unknown: no sample is thrown away."""
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
