"""Replaying a recording on the bus, in a namespace of its own.

All keys are under ``replay/`` and never under ``lab/``, so that no recorder, host, run or emergency stop
receives them, and the terminal UI marks a replay. Samples keep their values and the differences of their
numbers and device times; the host's stamps are the present time.

Positions are in the recording's time, which ``labhil info`` and plots show: s of the devices' clocks from
the first sample. The samples follow each other in the time of the host. The two differ where devices' clocks
ran faster or slower than the host's; one ratio then stands for all devices.
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
from labhil.bus.register import register
from labhil.bus.session import open_bus
from labhil.errors import CommandRefusedError, OptionError, RecordingError
from labhil.host_clock import session_clock, unix_ns
from labhil.recording.recording import Event, Recording, StreamData
from labhil.recording.stamps import HOST_CLOCK
from labhil.signals import Batch, FloatArray
from labhil.supervised import SupervisedThread

TICK = 0.02
"""Duration of the batches in which samples are published, s of the host, similar to those of a device."""

MIN_SPEED, MAX_SPEED = 0.01, 100.0
"""Speeds of a replay; the bus does not take more than a hundred times the samples of a device."""


@dataclass(slots=True)
class _Track:
    """One stream: the times of its samples, s of the host, and the index of the next one to publish."""

    data: StreamData
    publisher: StreamPublisher
    metadata: dict[str, str]
    t: FloatArray
    next: int = 0
    seq_shift: int = 0
    clock_shift: int = 0

    def move_to(self, position: float) -> None:
        """Continue with the first sample at or after ``position`` s, with continuous numbers and clock."""
        last = self.next - 1
        number, clock = self._stamps(max(last, 0))
        self.next = int(np.searchsorted(self.t, position, side="left"))
        if last >= 0 and self.next < len(self.t):
            period = round(1e9 / self.data.stream.rate)
            self.seq_shift = number + 1 - int(self.data.seq[self.next])
            self.clock_shift = clock + period - int(self.data.t_hw_ns[self.next])

    def _stamps(self, index: int) -> tuple[int, int]:
        return int(self.data.seq[index]) + self.seq_shift, int(self.data.t_hw_ns[index]) + self.clock_shift

    def batch(self, position: float, speed: float, now_ns: int) -> Batch:
        """Return the samples that are due at ``position``, with stamps as if they had just come."""
        stop = int(np.searchsorted(self.t, position, side="right"))
        rows = slice(self.next, max(stop, self.next))
        self.next = rows.stop
        age_ns = np.round((position - self.t[rows]) * 1e9 / speed).astype(np.int64)
        data = self.data
        return Batch(
            data.seq[rows] + self.seq_shift,
            now_ns - age_ns,
            data.t_hw_ns[rows] + self.clock_shift,
            data.values[rows],
        )


@dataclass(slots=True)
class _State:
    """The position and settings of a replay; times in s of the host, as in the recording."""

    position: float
    duration: float
    speed: float
    paused: bool = False
    ended: bool = False
    at_ns: int = 0
    events: list[tuple[float, Event]] = field(default_factory=list)
    next_event: int = 0


class Replay:
    """Plays a recording on a bus of its own (loopback); a context manager.

    Args:
        recording: The recording.
        speed: How many times as fast as it was recorded.
        start: Where it begins, s from the recording's start, as in ``labhil info`` and in plots.
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
        # a recording of one instant has no ratio
        self._ratio = recording.duration / duration if recording.duration and duration else 1.0
        if not MIN_SPEED <= speed <= MAX_SPEED:
            raise OptionError("speed", f": expected {MIN_SPEED:g} to {MAX_SPEED:g}, found {speed:g}")
        if not 0.0 <= start <= recording.duration:
            raise OptionError("from", f": expected 0 to {recording.duration:.4g} s, found {start:g}")
        self._state = _State(start / self._ratio, duration, speed, events=list(_events(recording)))
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._ended = threading.Event()
        self._tracks: list[_Track] = []
        self._resources = ExitStack()
        self.endpoint = ""
        self.fault = ""
        """Why nothing is published any more; empty while it is."""

    def __enter__(self) -> Self:
        with ExitStack() as resources:
            offset = resources.enter_context(session_clock())
            self._bus = bus = resources.enter_context(open_bus())
            self.endpoint = bus.endpoint
            for data in self._recording.streams:
                if id(data) in self._times:
                    track = self._make_track(data, offset)
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
            resources.enter_context(register("replay", self._recording.path.name, bus.endpoint, ()))
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
        """The state of the replay."""
        state = self._state
        return ReplayMessage(
            path=self._recording.path.name[:1000],
            position=state.position * self._ratio,
            duration=state.duration * self._ratio,
            speed=state.speed,
            paused=state.paused,
            ended=state.ended,
        )

    @property
    def overflows(self) -> int:
        """Samples that the bus could not take."""
        return sum(track.publisher.overflows for track in self._tracks)

    def wait(self, seconds: float) -> bool:
        """Wait up to ``seconds`` for the end, and return whether it is reached."""
        return self._ended.wait(seconds)

    def pause(self) -> None:
        """Pause at the present position."""
        with self._lock:
            self._state.paused = True

    def play(self) -> None:
        """Continue, or begin again where it has ended."""
        with self._lock:
            if self._state.ended:
                self._go_to(0.0)
            self._state.paused = False

    def set_speed(self, speed: float) -> None:
        """Change the speed; CommandRefusedError where it is out of range."""
        if not MIN_SPEED <= speed <= MAX_SPEED:
            raise CommandRefusedError(f"speed: expected {MIN_SPEED:g} to {MAX_SPEED:g}, found {speed:g}")
        with self._lock:
            self._state.speed = speed
        for track in self._tracks:
            track.metadata["speed"] = repr(track.data.speed * speed)
            track.publisher.update_metadata(track.metadata)

    def seek(self, position: float) -> None:
        """Move to ``position``, s from the recording's start, clipped to the recording."""
        with self._lock:
            self._go_to(min(max(position / self._ratio, 0.0), self._state.duration))

    def _make_track(self, data: StreamData, offset_ns: int) -> _Track:
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
        """Publish the samples and events that are due."""
        state = self._state
        elapsed, state.at_ns = (now_ns - state.at_ns) * 1e-9, now_ns
        if state.paused or state.ended:
            return
        target = state.position + elapsed * state.speed
        state.position = min(target, state.duration)
        now_ns -= round((target - state.position) * 1e9 / state.speed)  # when the position was reached
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
    """Return when each sample came, s of the host; it never decreases, even where a clock was set back."""
    return np.maximum.accumulate(np.maximum(data.t_common, 0.0))


def _events(recording: Recording) -> Iterator[tuple[float, Event]]:
    """Yield events with their times, s of the host; periodic status reports are left out."""
    speeds = {data.device: data.speed for data in recording.streams}
    default_speed = next(iter(speeds.values()), 1.0) if len(speeds) == 1 else 1.0
    for event in recording.events:
        if event.topic == EVENT:
            yield max(event.t / speeds.get(event.device, default_speed), 0.0), event
