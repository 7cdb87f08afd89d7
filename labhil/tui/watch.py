"""A seat on a bus that only looks: what its devices send, how regularly, and what they say of themselves.

One thread takes samples in, another asks what cannot be seen in samples (who is there, who holds the
lease). The screen reads snapshots when it draws; no sample ever becomes a message to it.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import numpy as np

from labhil.bus.ask import ask
from labhil.bus.incoming import (
    LARGEST_SCHEMA,
    EventMessage,
    SchemaMessage,
    StreamDeclaration,
    parse,
    validate,
)
from labhil.bus.keys import ALL_SCHEMAS, ALL_STREAMS, EVENT, SETPOINT, command_key, schema_key, split_key
from labhil.bus.live import live_devices
from labhil.bus.session import Bus
from labhil.bus.subscribe import subscribe
from labhil.codec import Codec, stream_from_json
from labhil.errors import BusError, CommandRefusedError, ProtocolError
from labhil.host_clock import steady_ns
from labhil.recording.stamps import HOST_CLOCK
from labhil.signals import FloatArray, Signal, Stream
from labhil.tui.ring import Ring

KEPT = 60.0
"""How far back a plot can look, s of the host's clock."""

MEASURED_OVER = 2.0
"""Rate and delays are those of the newest samples of so many s of the host's clock."""

SILENT_AFTER = 0.6
"""A stream that sends nothing for so long is marked as silent, s; slow streams after five periods."""

ASK_INTERVAL = 0.5
ASK_TIMEOUT = 0.5
MOST_ROWS = 65536
MOST_EVENTS = 200

MOST_DEVICES = 1000
UNEXPLAINED = (
    ProtocolError,
    CommandRefusedError,
    LookupError,
    AttributeError,
    TypeError,
    ValueError,
    ArithmeticError,
)
"""A stream that is not what it says must not hide the others."""

COMMAND_STREAM = "command"


@dataclass(frozen=True, slots=True)
class Said:
    """Something a device or a run announced, at Unix time ``t_ns``."""

    t_ns: int
    device: str
    kind: str
    message: str


@dataclass(frozen=True, slots=True)
class Beat:
    """How regularly a stream comes in.

    ``rate`` is measured (samples per s of the host's clock), None while there are too few; ``age`` is s
    since the newest sample came; ``silent`` is whether that is too long. ``transit`` is from acquisition on
    the host to here, ``lateness`` by how much the slowest sample was later at the host than the quickest,
    by the device's clock; both s.
    """

    rate: float | None
    age: float
    silent: bool
    gaps: int
    received: int
    transit: float | None
    lateness: float | None


@dataclass(frozen=True, slots=True)
class DeviceView:
    """A device as a screen shows it. ``state`` is the host's own word, "gone" or "unknown"."""

    name: str
    state: str
    reason: str
    holder: str | None
    beat: Beat | None
    stream: Stream | None
    speed: float
    metadata: Mapping[str, str]
    last: tuple[float, ...]
    event: Said | None


@dataclass(slots=True)
class StreamWatch:
    """One stream as it comes in."""

    stream: Stream
    speed: float
    metadata: Mapping[str, str]
    codec: Codec = field(init=False)
    ring: Ring = field(init=False)
    received: int = 0
    gaps: int = 0
    last_seq: int | None = None
    arrived_at: float = 0.0
    transits: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=512))

    def __post_init__(self) -> None:
        self.codec = Codec(self.stream)
        rows = round(self.stream.rate * self.speed * KEPT * 1.1)
        self.ring = Ring(self.stream.width, min(max(rows, 1024), MOST_ROWS))

    @property
    def ahead_ns(self) -> int:
        """By how much the clock that stamps the samples is ahead of this machine's wall clock, ns.

        The wall clock may have been set since the session of the device began, its clock not.
        """
        offset = self.metadata.get(HOST_CLOCK)
        return 0 if offset is None else steady_ns() + int(offset) - time.time_ns()

    def take(self, payloads: list[bytes], now: float, now_ns: int) -> None:
        """Take messages in."""
        batch = self.codec.decode(payloads)
        seq = batch.seq
        before = self.last_seq if self.last_seq is not None else int(seq[0]) - 1
        self.gaps += int(np.maximum(np.diff(seq, prepend=before) - 1, 0).sum())
        self.last_seq = int(seq[-1])
        self.received += len(batch)
        self.arrived_at = now
        self.transits.append((now, (now_ns + self.ahead_ns - int(batch.t_acq_ns[-1])) * 1e-9))
        self.ring.append(batch)

    def beat(self, now: float) -> Beat:
        """How regularly it came in lately; times on the monotonic clock, s."""
        age = now - self.arrived_at
        silent = age > max(SILENT_AFTER, 5.0 / (self.stream.rate * self.speed))
        t_acq, t_hw, _ = self.ring.newest(MEASURED_OVER)
        rate = lateness = None
        if len(t_acq) > 2 and t_acq[-1] > t_acq[0] and not silent:
            rate = (len(t_acq) - 1) / ((t_acq[-1] - t_acq[0]) * 1e-9)
            delays = (t_acq - t_acq[0]) - (t_hw - t_hw[0]) / self.speed
            lateness = float(delays.max() - delays.min()) * 1e-9
        recent = [transit for at, transit in self.transits.copy() if now - at < MEASURED_OVER]
        transit = float(np.median(recent)) if recent and not silent else None
        return Beat(rate, age, silent, self.gaps, self.received, transit, lateness)


@dataclass(slots=True)
class _Device:
    streams: dict[str, StreamWatch] = field(default_factory=dict)
    state: str = "unknown"
    reason: str = ""
    holder: str | None = None
    alive: bool = True
    event: Said | None = None

    @property
    def main(self) -> StreamWatch | None:
        """The stream of what is measured."""
        found = [watched for name, watched in self.streams.items() if name != COMMAND_STREAM]
        return found[0] if found else None


class Watch:
    """Looks at everything on ``bus`` from :meth:`__enter__` until it is closed; the bus stays its owner's."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.events: deque[Said] = deque(maxlen=MOST_EVENTS)
        self.trouble = ""
        self._devices: dict[str, _Device] = {}
        self._unknown: dict[tuple[str, str], float] = {}
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._resources = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as resources:
            resources.enter_context(subscribe(self.bus, ALL_SCHEMAS, self._take_schemas))
            resources.enter_context(subscribe(self.bus, ALL_STREAMS, self._take))
            self._asking = asking = threading.Thread(target=self._ask_around, name="ask devices")
            asking.start()
            resources.callback(asking.join)
            resources.callback(self._ending.set)
            self._resources = resources.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._resources.close()

    # what the screen asks

    def devices(self) -> list[DeviceView]:
        """Every device that was seen, in order of appearance, as things stand now."""
        now = time.monotonic()
        with self._lock:
            found = list(self._devices.items())
        return [_view(name, device, now) for name, device in found]

    def signals(self) -> list[tuple[str, str, Signal]]:
        """Every signal that comes in: device, stream and what it is."""
        with self._lock:
            return [
                (name, stream, signal)
                for name, device in self._devices.items()
                for stream, watched in device.streams.items()
                for signal in watched.stream.signals
            ]

    def stream(self, device: str, stream: str) -> StreamWatch | None:
        """The stream of that name, None where it is not known."""
        with self._lock:
            found = self._devices.get(device)
            return None if found is None else found.streams.get(stream)

    def failure(self) -> str:
        """Return why what is shown is news no more, though nobody closed this; empty while all is well."""
        if not self._ending.is_set() and not self._asking.is_alive():
            return "the thread that asks the devices has died"
        return self.bus.failure()

    @property
    def alive(self) -> bool:
        """Whether any host is there."""
        with self._lock:
            return any(device.alive for device in self._devices.values())

    # what comes from the bus, in its threads

    def _take_schemas(self, key: str, payloads: list[bytes]) -> None:
        try:
            self._learn(*split_key(key), parse(SchemaMessage, payloads[-1], "a schema", LARGEST_SCHEMA))
        except UNEXPLAINED as error:
            self.trouble = f"{key}: {error}"

    def _take(self, key: str, payloads: list[bytes]) -> None:
        device, stream = split_key(key)
        if stream == EVENT:
            for payload in payloads:
                self._note(device, payload)
        elif stream != SETPOINT:
            watched = self.stream(device, stream)
            if watched is None:
                with self._lock:
                    if len(self._unknown) < MOST_DEVICES:
                        self._unknown.setdefault((device, stream), float("-inf"))
                return
            try:
                watched.take(payloads, time.monotonic(), time.time_ns())
            except UNEXPLAINED as error:
                self.trouble = f"{key}: {error}"

    def _learn(self, device: str, stream: str, reply: SchemaMessage) -> None:
        parse(StreamDeclaration, reply.stream, "a stream", LARGEST_SCHEMA)
        metadata = dict(reply.metadata)
        speed = float(metadata.get("speed", 1.0))
        if not 0 < speed < float("inf"):
            raise ProtocolError(f"speed: expected a positive number, found {speed}")
        watched = StreamWatch(stream_from_json(reply.stream), speed, metadata)
        with self._lock:
            self._device(device).streams[stream] = watched
            self._unknown.pop((device, stream), None)

    def _note(self, device: str, payload: bytes) -> None:
        state = ""
        try:
            event = parse(EventMessage, payload, "an event")
            text, state = event.message or event.reason or event.text, event.state
            kind = state if event.kind == "note" and state else event.kind
            said = Said(event.t_ns, device, kind, text)
        except CommandRefusedError:
            said = Said(time.time_ns(), device, "note", payload[:1000].decode("utf-8", "replace"))
        self.events.append(said)
        if device == "run":
            return
        with self._lock:
            if device not in self._devices and len(self._devices) >= MOST_DEVICES:
                return
            found = self._device(device)
            found.event = said
            if state:
                found.state, found.reason = state, said.message

    def _device(self, name: str) -> _Device:
        return self._devices.setdefault(name, _Device())

    # what has to be asked

    def _ask_around(self) -> None:
        while not self._ending.wait(ASK_INTERVAL):
            try:
                self._ask_once()
            except (BusError, *UNEXPLAINED) as error:
                self.trouble = str(error)

    def _ask_once(self) -> None:
        self.trouble = ""
        alive = live_devices(self.bus)
        with self._lock:
            for name in alive:
                self._device(name)
            known = list(self._devices.items())
            for name, device in known:
                device.alive = name in alive
            unknown = list(self._unknown)
            unknown += [(name, "state") for name, device in known if device.alive and not device.streams]
        for device_name, stream in dict.fromkeys(unknown):
            self._ask_schema(device_name, stream)
        for name, device in known:
            if device.alive:
                self._ask_status(name, device)

    def _ask_schema(self, device: str, stream: str) -> None:
        try:
            reply = ask(self.bus, schema_key(device, stream), timeout=ASK_TIMEOUT)
            self._learn(device, stream, validate(SchemaMessage, reply, "a schema"))
        except (BusError, *UNEXPLAINED) as error:
            self.trouble = f"{device}/{stream}: {error}"

    def _ask_status(self, name: str, device: _Device) -> None:
        try:
            status = ask(self.bus, command_key(name, "status"), timeout=ASK_TIMEOUT)
        except (BusError, CommandRefusedError) as error:
            device.state, device.reason = "no answer", str(error)
            return
        device.state, device.reason = str(status.get("state", "unknown")), str(status.get("reason", ""))
        holder = status.get("holder")
        device.holder = None if holder is None else str(holder)


def _view(name: str, device: _Device, now: float) -> DeviceView:
    main = device.main
    beat, last, metadata = None, (), {}
    if main is not None:
        beat, metadata = main.beat(now), dict(main.metadata)
        _, _, values = main.ring.newest(0.0)
        last = tuple(values[-1].tolist()) if len(values) else ()
    return DeviceView(
        name=name,
        state=device.state if device.alive else "gone",
        reason=device.reason,
        holder=device.holder if device.alive else None,
        beat=beat,
        stream=None if main is None else main.stream,
        speed=1.0 if main is None else main.speed,
        metadata=metadata,
        last=last,
        event=device.event,
    )


def trace(watched: StreamWatch, signal: str, seconds: float, now_ns: int) -> tuple[FloatArray, FloatArray]:
    """The newest ``seconds`` of a signal: s before ``now_ns`` (n,), negative, and values (n, columns)."""
    t_acq, _, values = watched.ring.newest(seconds)
    ago: FloatArray = (t_acq - (now_ns + watched.ahead_ns)).astype(np.float64) * 1e-9
    return ago, values[:, watched.stream.columns_of(signal)]
