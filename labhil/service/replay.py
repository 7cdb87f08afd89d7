"""A recording on the bus as if its devices ran, in a namespace of its own.

Everything stands under ``replay/`` and never under ``lab/``: no recorder, host, run or emergency stop hears
of it, and a screen marks it. The samples keep their values, the steps of their numbers and of the device's
clock; the host's stamps are those of now.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

import numpy as np

from labhil.bus.ask import serve
from labhil.bus.incoming import ReplayMessage, ReplayRequest, parse
from labhil.bus.keys import EVENT, REPLAY, REPLAY_CONTROL
from labhil.bus.publish import StreamPublisher, publish_event
from labhil.bus.register import registered
from labhil.bus.session import open_bus
from labhil.errors import CommandRefusedError, OptionError, RecordingError
from labhil.host_clock import session_clock, unix_ns
from labhil.recording.recording import Event, Recording, StreamData
from labhil.recording.stamps import HOST_CLOCK
from labhil.signals import Batch, FloatArray
from labhil.supervised import SupervisedThread

TICK = 0.02
"""Samples go out in batches of so many s of the host, as those of a device do."""

SLOWEST, FASTEST = 0.01, 100.0
"""Speeds of a replay: more than a hundred times as many samples as a device sends, no bus takes."""


@dataclass(slots=True)
class _Track:
    """One stream: its samples over s of the host, and the next one to go out."""

    data: StreamData
    publisher: StreamPublisher
    metadata: dict[str, str]
    t: FloatArray
    next: int = 0
    seq_shift: int = 0
    clock_shift: int = 0

    def move_to(self, position: float) -> None:
        """Go on with the first sample from ``position`` on; numbers and clock go on where they were."""
        last = self.next - 1
        number, clock = self._stamps(max(last, 0))
        self.next = int(np.searchsorted(self.t, position, side="left"))
        if last >= 0 and self.next < len(self.t):
            period = round(1e9 / self.data.stream.rate)
            self.seq_shift = number + 1 - int(self.data.seq[self.next])
            self.clock_shift = clock + period - int(self.data.t_hw_ns[self.next])

    def _stamps(self, at: int) -> tuple[int, int]:
        return int(self.data.seq[at]) + self.seq_shift, int(self.data.t_hw_ns[at]) + self.clock_shift

    def batch(self, position: float, speed: float, now_ns: int) -> Batch:
        """Return what is due at ``position``, which is now, stamped as if it had just come."""
        end = int(np.searchsorted(self.t, position, side="right"))
        rows = slice(self.next, max(end, self.next))
        self.next = rows.stop
        ago = np.round((position - self.t[rows]) * 1e9 / speed).astype(np.int64)
        data = self.data
        return Batch(
            data.seq[rows] + self.seq_shift,
            now_ns - ago,
            data.t_hw_ns[rows] + self.clock_shift,
            data.values[rows],
        )


@dataclass(slots=True)
class _State:
    """Where a replay is; times in s of the host, as in the recording."""

    position: float
    duration: float
    speed: float
    paused: bool = False
    ended: bool = False
    at_ns: int = 0
    events: list[tuple[float, Event]] = field(default_factory=list)
    next_event: int = 0


class Replay:
    """Plays ``recording`` on a bus of its own (loopback) from :meth:`__enter__` until it is closed.

    Args:
        recording: What is played.
        speed: How many seconds of the recording pass in one.
        start: Where it begins, s of the host since the recording's first sample.
        loop: Whether it begins again at its end.

    Raises:
        RecordingError: The recording holds no samples.
        OptionError: ``speed`` or ``start`` is out of range.
    """

    def __init__(
        self, recording: Recording, *, speed: float = 1.0, start: float = 0.0, loop: bool = False
    ) -> None:
        self._recording, self._loop = recording, loop
        self._times = {id(data): _host_time(data) for data in recording.streams if len(data)}
        if not self._times:
            raise RecordingError(f"{recording.path}: expected samples to replay, found none")
        duration = max(float(t[-1]) for t in self._times.values())
        if not SLOWEST <= speed <= FASTEST:
            raise OptionError("speed", f": expected {SLOWEST:g} to {FASTEST:g}, found {speed:g}")
        if not 0.0 <= start <= duration:
            raise OptionError("from", f": expected 0 to {duration:.4g} s, found {start:g}")
        self._state = _State(start, duration, speed, events=list(_events(recording)))
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._ended = threading.Event()
        self._tracks: list[_Track] = []
        self._resources = ExitStack()
        self.endpoint = ""
        self.fault = ""
        """Why nothing is played any more; empty while all is well."""

    def __enter__(self) -> Self:
        with ExitStack() as resources:
            offset = resources.enter_context(session_clock())
            self._bus = bus = resources.enter_context(open_bus())
            self.endpoint = bus.endpoint
            for data in self._recording.streams:
                if id(data) in self._times:
                    track = self._track(data, offset)
                    resources.enter_context(track.publisher)
                    self._tracks.append(track)
            resources.enter_context(
                serve(
                    bus,
                    REPLAY_CONTROL,
                    self._dispatch,
                    reader=lambda payload: parse(ReplayRequest, payload, "a request to a replay"),
                    guarded=lambda request: request.action != "status",
                )
            )
            # without devices: nobody has to answer an emergency stop here
            resources.enter_context(registered("replay", self._recording.path.name, bus.endpoint, ()))
            self._go_to(self._state.position)
            self._thread = SupervisedThread(self._run, "replay", on_failure=self._note_failure)
            self._thread.start()
            resources.callback(self._thread.join)
            resources.callback(self._ending.set)
            self._resources = resources.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._resources.close()

    @property
    def status(self) -> ReplayMessage:
        """Where it is."""
        state = self._state
        return ReplayMessage(
            path=self._recording.path.name[:1000],
            position=state.position,
            duration=state.duration,
            speed=state.speed,
            paused=state.paused,
            ended=state.ended,
        )

    @property
    def overflows(self) -> int:
        """Samples that the bus could not take."""
        return sum(track.publisher.overflows for track in self._tracks)

    def wait(self, seconds: float) -> bool:
        """Wait up to ``seconds`` for the end; whether it is there."""
        return self._ended.wait(seconds)

    def pause(self) -> None:
        """Hold it where it is."""
        with self._lock:
            self._state.paused = True

    def play(self) -> None:
        """Go on; from the beginning where it had ended."""
        with self._lock:
            if self._state.ended:
                self._go_to(0.0)
            self._state.paused = False

    def set_speed(self, speed: float) -> None:
        """Play faster or slower from here on; CommandRefusedError for a speed out of range."""
        if not SLOWEST <= speed <= FASTEST:
            raise CommandRefusedError(f"speed: expected {SLOWEST:g} to {FASTEST:g}, found {speed:g}")
        with self._lock:
            self._state.speed = speed
        for track in self._tracks:
            track.metadata["speed"] = repr(track.data.speed * speed)
            track.publisher.restate(track.metadata)

    def seek(self, position: float) -> None:
        """Go to ``position``, s of the host since the first sample, or as near as there is something."""
        with self._lock:
            self._go_to(min(max(position, 0.0), self._state.duration))

    def _track(self, data: StreamData, offset_ns: int) -> _Track:
        speed = data.speed * self._state.speed
        metadata = {
            **data.metadata,
            "speed": repr(speed),
            "replay": self._recording.path.name[:1000],
            "replay_sha256": self._recording.sha256,
            HOST_CLOCK: str(offset_ns),
        }
        publisher = StreamPublisher(self._bus, data.device, data.stream, metadata, namespace=REPLAY)
        return _Track(data, publisher, metadata, self._times[id(data)])

    def _dispatch(self, request: ReplayRequest) -> dict[str, Any]:
        if request.action == "pause":
            self.pause()
        elif request.action == "play":
            self.play()
        elif request.action == "speed":
            self.set_speed(request.value)
        elif request.action == "seek":
            self.seek(request.value)
        return self.status.model_dump()

    def _go_to(self, position: float) -> None:
        state = self._state
        state.position, state.at_ns, state.ended = position, unix_ns(), False
        self._ended.clear()
        for track in self._tracks:
            track.move_to(position)
        state.next_event = sum(t < position for t, _ in state.events)

    def _run(self) -> None:
        while not self._ending.wait(TICK):
            with self._lock:
                self._step(unix_ns())
        self._thread.end()

    def _note_failure(self) -> None:
        self.fault = self._thread.failure()
        self._ended.set()

    def _step(self, now_ns: int) -> None:
        """Publish what is due by now."""
        state = self._state
        passed, state.at_ns = (now_ns - state.at_ns) * 1e-9, now_ns
        if state.paused or state.ended:
            return
        wanted = state.position + passed * state.speed
        state.position = min(wanted, state.duration)
        now_ns -= round((wanted - state.position) * 1e9 / state.speed)  # when it was there
        for track in self._tracks:
            track.publisher.put(track.batch(state.position, state.speed, now_ns))
        while state.next_event < len(state.events) and state.events[state.next_event][0] <= state.position:
            event = state.events[state.next_event][1]
            publish_event(self._bus, event.device, {**event.body, "t_ns": now_ns}, REPLAY)
            state.next_event += 1
        if state.position >= state.duration:
            if self._loop:
                self._go_to(0.0)
            else:
                state.ended = True
                self._ended.set()


def _host_time(data: StreamData) -> FloatArray:
    """When each sample came, s of the host: never back, also where a clock was set back."""
    return np.maximum.accumulate(np.maximum(data.t_common, 0.0))


def _events(recording: Recording) -> Iterator[tuple[float, Event]]:
    """What happened, over s of the host; routine reports are left out."""
    speeds = {data.device: data.speed for data in recording.streams}
    only = next(iter(speeds.values()), 1.0) if len(speeds) == 1 else 1.0
    for event in recording.events:
        if event.topic == EVENT:
            yield max(event.t / speeds.get(event.device, only), 0.0), event
