"""A passive view of one bus: samples of its devices, their regularity, and their states.

One thread receives samples, another polls what samples do not show (presence, lease). The screen reads
snapshots when it draws; no sample becomes a message to it.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from labhil.bus.ask import ask
from labhil.bus.incoming import (
    MAX_SCHEMA_BYTES,
    EventMessage,
    ReplayMessage,
    SchemaMessage,
    StreamDeclaration,
    parse,
    validate,
)
from labhil.bus.keys import (
    ALL_SCHEMAS,
    ALL_STREAMS,
    EVENT,
    LAB,
    REPLAY,
    REPLAY_CONTROL,
    REPLAYED_SCHEMAS,
    REPLAYED_STREAMS,
    SETPOINT,
    command_key,
    schema_key,
    split_key,
)
from labhil.bus.live import live_devices
from labhil.bus.session import Bus
from labhil.bus.subscribe import subscribe
from labhil.codec import stream_from_json
from labhil.errors import BusError, CommandRefusedError, ProtocolError
from labhil.signals import Signal, Stream
from labhil.supervised import SupervisedThread
from labhil.tui.stream_watch import UNDECODABLE, StreamHealth, StreamWatch

POLL_INTERVAL = 0.5
"""Time between two polls of the devices, s."""

REQUEST_TIMEOUT = 0.5
"""Longest time for the answer to one request, s."""

MISSES_UNTIL_GONE = 3
"""Polls without an answer after which a bus or a replay counts as gone: a busy process answers late."""

MOST_EVENTS = 200
MOST_DEVICES = 1000
MALFORMED = (CommandRefusedError, *UNDECODABLE)

COMMAND_STREAM = "command"

REPLAYED = f"{REPLAY}/"
"""Prefix of the name of a device that is only replayed; names of devices contain no slash."""


@dataclass(frozen=True, slots=True)
class Announcement:
    """Hold an event that a device or a run announced, at Unix time ``t_ns``."""

    t_ns: int
    device: str
    kind: str
    message: str


@dataclass(frozen=True, slots=True)
class DeviceView:
    """Hold a snapshot of a device.

    Attributes:
        name: Name on the bus; a replayed device has the prefix ``replay/``.
        state: State that its host reports, "gone" or "unknown".
        reason: Why it is in that state.
        holder: Who has the lease of its commands.
        health: Regularity of its main stream.
        stream: Its main stream.
        speed: Seconds of its time in one second.
        metadata: Metadata of the main stream.
        last_values: Newest values, one for each column; empty before the first sample.
        event: Its newest event.
    """

    name: str
    state: str
    reason: str
    holder: str | None
    health: StreamHealth | None
    stream: Stream | None
    speed: float
    metadata: Mapping[str, str]
    last_values: tuple[float, ...]
    event: Announcement | None

    @property
    def is_replayed(self) -> bool:
        """Whether a recording is played, and no device is present."""
        return self.name.startswith(REPLAYED)


@dataclass(slots=True)
class _DeviceState:
    streams: dict[str, StreamWatch] = field(default_factory=dict)
    state: str = "unknown"
    reason: str = ""
    holder: str | None = None
    alive: bool = True
    event: Announcement | None = None

    @property
    def main(self) -> StreamWatch | None:
        """The stream of measurements."""
        measured = [stream_watch for name, stream_watch in self.streams.items() if name != COMMAND_STREAM]
        return measured[0] if measured else None


class BusWatch:
    """Watch everything on a bus, as a context manager.

    Args:
        bus: The bus; its owner closes it.
    """

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.events: deque[Announcement] = deque(maxlen=MOST_EVENTS)
        self._fault = ""
        self.replay: ReplayMessage | None = None
        """The replay on this bus, if one is there."""
        self._replay_misses = 0
        self._devices: dict[str, _DeviceState] = {}
        self._undeclared: dict[tuple[str, str], float] = {}
        self._lock = threading.Lock()
        self._stop_polling = threading.Event()
        self._poll_thread = SupervisedThread(self._poll, "poll devices")
        self._resources = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as resources:
            for schemas in (ALL_SCHEMAS, REPLAYED_SCHEMAS):
                resources.enter_context(subscribe(self.bus, schemas, self._handle_schemas))
            for streams in (ALL_STREAMS, REPLAYED_STREAMS):
                resources.enter_context(subscribe(self.bus, streams, self._handle_messages))
            self._poll_thread.start()
            resources.callback(self._poll_thread.join)
            resources.callback(self._stop_polling.set)
            resources.callback(self._poll_thread.end)
            self._resources = resources.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._resources.close()

    # snapshots for the screen

    def devices(self) -> list[DeviceView]:
        """Return every device that was seen, in order of appearance, with its present state."""
        now = time.monotonic()
        with self._lock:
            devices = list(self._devices.items())
        return [_view_of(name, device, now) for name, device in devices]

    def signals(self) -> list[tuple[str, str, Signal]]:
        """Return device, stream and signal of everything that comes in."""
        with self._lock:
            return [
                (name, stream, signal)
                for name, device in self._devices.items()
                for stream, stream_watch in device.streams.items()
                for signal in stream_watch.stream.signals
            ]

    def stream(self, device: str, stream: str) -> StreamWatch | None:
        """Return a stream by the names of device and stream; None where it is not known."""
        with self._lock:
            device_state = self._devices.get(device)
            return None if device_state is None else device_state.streams.get(stream)

    @property
    def fault(self) -> str:
        """The last error in an incoming message; empty where there was none."""
        with self._lock:
            streams = [
                stream_watch for device in self._devices.values() for stream_watch in device.streams.values()
            ]
        return self._fault or next((stream_watch.fault for stream_watch in streams if stream_watch.fault), "")

    def failure(self) -> str:
        """Return why the view is out of date although nobody closed it; empty while it is not."""
        return self._poll_thread.failure() or self.bus.failure()

    @property
    def alive(self) -> bool:
        """Whether the host of any device is present."""
        with self._lock:
            return any(device.alive for device in self._devices.values())

    # messages from the bus, in its threads

    def _handle_schemas(self, key: str, payloads: list[bytes]) -> None:
        try:
            self._register_stream(
                *_split_key(key), parse(SchemaMessage, payloads[-1], "a schema", MAX_SCHEMA_BYTES)
            )
        except MALFORMED as error:
            self._fault = f"{key}: {error}"

    def _handle_messages(self, key: str, payloads: list[bytes]) -> None:
        device, stream = _split_key(key)
        if stream == EVENT:
            for payload in payloads:
                self._record_event(device, payload)
        elif stream != SETPOINT:
            stream_watch = self.stream(device, stream)
            if stream_watch is None:
                with self._lock:
                    if len(self._undeclared) < MOST_DEVICES:
                        self._undeclared.setdefault((device, stream), float("-inf"))
                return
            stream_watch.receive(payloads, time.monotonic(), time.time_ns())

    def _register_stream(self, device: str, stream: str, reply: SchemaMessage) -> None:
        parse(StreamDeclaration, reply.stream, "a stream", MAX_SCHEMA_BYTES)
        metadata = dict(reply.metadata)
        speed = float(metadata.get("speed", 1.0))
        if not 0 < speed < float("inf"):
            raise ProtocolError(f"speed: expected a positive number, found {speed}")
        declared = stream_from_json(reply.stream)
        device_state = self.stream(device, stream) if device.startswith(REPLAYED) else None
        if device_state is not None and device_state.stream == declared:  # only its speed was changed
            device_state.speed, device_state.metadata = speed, metadata
            return
        stream_watch = StreamWatch(declared, speed, metadata)
        with self._lock:
            self._device(device).streams[stream] = stream_watch
            self._undeclared.pop((device, stream), None)

    def _record_event(self, device: str, payload: bytes) -> None:
        state = ""
        try:
            event = parse(EventMessage, payload, "an event")
            text, state = event.message or event.reason or event.text, event.state
            kind = state if event.kind == "note" and state else event.kind
            announcement = Announcement(event.t_ns, device, kind, text)
        except CommandRefusedError:
            announcement = Announcement(
                time.time_ns(), device, "note", payload[:1000].decode("utf-8", "replace")
            )
        self.events.append(announcement)
        if device == "run" or device.startswith(REPLAYED):
            return  # the state in a recording is not the present one
        with self._lock:
            if device not in self._devices and len(self._devices) >= MOST_DEVICES:
                return
            entry = self._device(device)
            entry.event = announcement
            if state:
                entry.state, entry.reason = state, announcement.message

    def _device(self, name: str) -> _DeviceState:
        return self._devices.setdefault(name, _DeviceState())

    # requests, in the polling thread

    def _poll(self) -> None:
        while not self._stop_polling.wait(POLL_INTERVAL):
            try:
                self._poll_once()
            except (BusError, *MALFORMED) as error:
                self._fault = str(error)

    def _poll_once(self) -> None:
        self._fault = ""
        alive = live_devices(self.bus)
        with self._lock:
            for device in self._devices.values():
                for stream_watch in device.streams.values():
                    stream_watch.fault = ""
            for name in alive:
                self._device(name)
            devices = list(self._devices.items())
        self._poll_replay(name for name, _ in devices)
        with self._lock:
            for name, device in devices:
                device.alive = name in alive or (name.startswith(REPLAYED) and self.replay is not None)
            unknown = list(self._undeclared)
            unknown += [(name, "state") for name, device in devices if device.alive and not device.streams]
        for device_name, stream in dict.fromkeys(unknown):
            self._request_schema(device_name, stream)
        for name, device in devices:
            if device.alive and name.startswith(REPLAYED):
                device.state, device.reason = _replay_state(self.replay)
            elif device.alive:
                self._request_status(name, device)

    def _poll_replay(self, names: Iterable[str]) -> None:
        if self.replay is None and not any(name.startswith(REPLAYED) for name in names):
            return
        try:
            self.control_replay("status")
        except (BusError, CommandRefusedError):
            self._replay_misses += 1
            if self._replay_misses >= MISSES_UNTIL_GONE:  # a busy one answers late
                self.replay = None

    def control_replay(self, action: str, value: float = 0.0) -> None:
        """Send a command to the replay on this bus, and wait for its answer.

        Args:
            action: "status", "pause", "play", "speed" or "seek".
            value: The speed, or the position in s.

        Raises:
            BusError: No replay answers.
            CommandRefusedError: The replay refuses.
        """
        answer = ask(self.bus, REPLAY_CONTROL, {"action": action, "value": value}, timeout=REQUEST_TIMEOUT)
        self.replay, self._replay_misses = validate(ReplayMessage, answer, "a replay"), 0

    def _request_schema(self, device: str, stream: str) -> None:
        try:
            reply = ask(self.bus, schema_key(*_key_parts(device, stream)), timeout=REQUEST_TIMEOUT)
            self._register_stream(device, stream, validate(SchemaMessage, reply, "a schema"))
        except (BusError, *MALFORMED) as error:
            self._fault = f"{device}/{stream}: {error}"

    def _request_status(self, name: str, device: _DeviceState) -> None:
        try:
            status = ask(self.bus, command_key(name, "status"), timeout=REQUEST_TIMEOUT)
        except (BusError, CommandRefusedError) as error:
            device.state, device.reason = "no answer", str(error)
            return
        device.state, device.reason = str(status.get("state", "unknown")), str(status.get("reason", ""))
        holder = status.get("holder")
        device.holder = None if holder is None else str(holder)


def _split_key(key: str) -> tuple[str, str]:
    """Device and stream of a key; replayed devices keep the prefix that no real one has."""
    device, stream = split_key(key)
    return (f"{REPLAYED}{device}" if key.startswith(REPLAYED) else device), stream


def _key_parts(device: str, stream: str) -> tuple[str, str, str]:
    """Device, stream and namespace, as functions that make keys take them."""
    return device.removeprefix(REPLAYED), stream, REPLAY if device.startswith(REPLAYED) else LAB


def _replay_state(replay: ReplayMessage | None) -> tuple[str, str]:
    """State of a replay, and its position in the recording."""
    if replay is None:
        return "gone", ""
    where = f"{replay.position:.1f} of {replay.duration:.1f} s of {replay.path}"
    if replay.ended:
        return "replay ended", where
    return ("replay paused" if replay.paused else "replay"), where


def _view_of(name: str, device: _DeviceState, now: float) -> DeviceView:
    main = device.main
    health, last_values, metadata = None, (), {}
    if main is not None:
        health, metadata = main.health(now), dict(main.metadata)
        _, _, values = main.ring.newest(0.0)
        last_values = tuple(values[-1].tolist()) if len(values) else ()
    return DeviceView(
        name=name,
        state=device.state if device.alive else "gone",
        reason=device.reason,
        holder=device.holder if device.alive else None,
        health=health,
        stream=None if main is None else main.stream,
        speed=1.0 if main is None else main.speed,
        metadata=metadata,
        last_values=last_values,
        event=device.event,
    )
