"""Publishing streams, events and commands; a stream never blocks the thread that reads the device."""

from __future__ import annotations

import base64
import queue
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

import zenoh

from labhil.bus.ask import ask_all, serve
from labhil.bus.incoming import dump
from labhil.bus.keys import LAB, PUBLISHED, event_key, schema_key, stream_key
from labhil.bus.session import Bus
from labhil.codec import Codec, stream_to_json
from labhil.errors import BusError
from labhil.host_clock import unix_ns
from labhil.signals import Batch, Stream
from labhil.supervised import SupervisedThread

MAX_TEXT_LENGTH = 4000
"""Characters of one text of an event: readers refuse messages that are too large."""

LISTENER_TIMEOUT = 1.0
"""How long the first samples wait in the queue for a subscriber, s."""

DELIVERY_TIMEOUT = 30.0
"""How long a publisher that leaves waits until recorders have received all that it published, s."""


class StreamPublisher:
    """Publishes the samples of one stream, and answers requests for its schema.

    ``put`` adds a batch to a bounded queue and returns at once. Where the bus is too slow, samples are
    dropped there and counted in ``overflows`` (number of samples); readers see the gap in ``seq``.

    Args:
        bus: The bus.
        device: Name of the device.
        stream: The stream.
        metadata: What a recording keeps beside the samples, such as serial number, firmware and speed.
        depth: Batches that may wait.
        namespace: That of devices, or of replays.
    """

    def __init__(
        self,
        bus: Bus,
        device: str,
        stream: Stream,
        metadata: Mapping[str, str] | None = None,
        *,
        depth: int = 4096,
        namespace: str = LAB,
    ) -> None:
        self.codec = Codec(stream)
        self.overflows = 0
        self.error: BusError | None = None
        self._queue: queue.Queue[list[bytes] | None] = queue.Queue(depth)
        self._closing = threading.Event()
        self._place = {"device": device, "stream": stream.name} if namespace == LAB else None
        self._last_seq: int | None = None
        self._session = bus.session
        key = stream_key(device, stream.name, namespace)
        self._bus, self._key = bus, key
        self._publisher = bus.session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.BLOCK, priority=zenoh.Priority.DATA
        )
        self._reply = schema_reply(self.codec, metadata or {})
        self._schema_key = schema_key(device, stream.name, namespace)
        self._schema = serve(bus, self._schema_key, lambda _: self._reply)
        self._thread = SupervisedThread(self._run, f"publish {key}")
        self._thread.start()
        bus.watch(self)

    def failure(self) -> str:
        """Return why nothing is published any more although it is open; empty while it is."""
        if self.error is not None:
            return str(self.error)
        return self._thread.failure()

    def put(self, batch: Batch) -> None:
        """Publish a batch; never blocks."""
        if len(batch) == 0:
            return
        self._last_seq = int(batch.seq[-1])
        try:
            self._queue.put_nowait(self.codec.encode(batch))
        except queue.Full:
            self.overflows += len(batch)

    def update_metadata(self, metadata: Mapping[str, str]) -> None:
        """Declare the stream again with other metadata; BusError where the session is closed."""
        self._reply = schema_reply(self.codec, metadata)
        try:
            self._declare_schema()
        except zenoh.ZError as error:
            raise BusError(f"{self._schema_key}: could not be published: {error}") from error

    def close(self) -> None:
        """Publish the queue, wait until recorders have received it, and close; safe to call twice."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._bus.unwatch(self)
        self._thread.end()
        self._close_queue()
        self._thread.join()
        self._deliver()
        self._schema.close()
        self._publisher.undeclare()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        self._wait_for_a_listener()
        declared = False
        while (payloads := self._queue.get()) is not None:
            if self.error is not None:
                self.overflows += len(payloads)
                continue
            try:
                if not declared:
                    self._declare_schema()
                    declared = True
                self._publish(payloads)
            except zenoh.ZError as error:
                self.error = BusError(f"{self._publisher.key_expr}: samples could not be published: {error}")
                self.overflows += len(payloads)

    def _publish(self, payloads: list[bytes]) -> None:
        for payload in payloads:
            self._publisher.put(payload, attachment=self._bus.sign(self._key, payload))

    def _close_queue(self) -> None:
        """Let the thread end after the queue; a thread that has died does not empty a full queue."""
        while self._thread.is_alive():
            try:
                self._queue.put(None, timeout=0.1)
            except queue.Full:
                continue
            return

    def _deliver(self) -> None:
        """State to recorders how many samples there were; they answer after they have received them."""
        if self._place is None or self._last_seq is None:
            return
        statement = {**self._place, "last_seq": self._last_seq}
        with suppress(BusError):  # a closed session: recorders notice the missing statement
            ask_all(self._bus, PUBLISHED, statement, DELIVERY_TIMEOUT)

    def _declare_schema(self) -> None:
        """Declare the stream before its first sample; later subscribers have to request its schema."""
        declaration = dump(self._reply)
        self._session.put(
            self._schema_key,
            declaration,
            attachment=self._bus.sign(self._schema_key, declaration),
            congestion_control=zenoh.CongestionControl.BLOCK,
        )

    def _wait_for_a_listener(self) -> None:
        """Wait for a subscriber: another process is known only some milliseconds after the session opened."""
        deadline = time.monotonic() + LISTENER_TIMEOUT
        while time.monotonic() < deadline:
            status: Any = self._publisher.matching_status  # zenoh's stubs call it a bool
            if status.matching:
                return
            time.sleep(0.002)


def schema_reply(codec: Codec, metadata: Mapping[str, str]) -> dict[str, Any]:
    """Return the answer to the request for the schema of a stream."""
    return {
        "stream": stream_to_json(codec.stream),
        "schema_name": codec.schema_name,
        "descriptor": base64.b64encode(codec.descriptor_set()).decode("ascii"),
        "metadata": dict(metadata),
    }


def publish_command(bus: Bus, key: str, payload: bytes) -> None:
    """Publish a command, signed with the key of the session; BusError where the session is closed."""
    key = bus.place(key)
    try:
        bus.session.put(
            key,
            payload,
            attachment=bus.sign(key, payload),
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
    except zenoh.ZError as error:
        raise BusError(f"{key}: the command could not be published: {error}") from error


def publish_event(bus: Bus, device: str, event: str | Mapping[str, Any], namespace: str = LAB) -> None:
    """Publish an event.

    Args:
        bus: The bus.
        device: Name of the device, or of the run.
        event: JSON data, or a text, which becomes ``{"text": …}``. The host's time is added as ``t_ns``
            (Unix time) where it is missing.
        namespace: That of devices, or of replays.

    Raises:
        BusError: The session is closed.
    """
    body: dict[str, Any] = {"text": event} if isinstance(event, str) else dict(event)
    body = {name: x[:MAX_TEXT_LENGTH] if isinstance(x, str) else x for name, x in body.items()}
    body.setdefault("t_ns", unix_ns())
    key = event_key(device, namespace)
    payload = dump(body)
    try:
        bus.session.put(
            key,
            payload,
            attachment=bus.sign(key, payload),
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
    except zenoh.ZError as error:
        raise BusError(f"{key}: the event could not be published: {error}") from error
