"""A lab in which nothing moves: fixed samples, fixed clock, so that screens can be compared."""

from __future__ import annotations

import numpy as np

from labhil.bus.incoming import ReplayMessage
from labhil.bus.latch import Latch
from labhil.service.emergency import Outcome
from labhil.signals import Batch, Direction, Hold, Signal, Stream
from labhil.tui.bus_watch import Announcement, DeviceView
from labhil.tui.session import SignalSource
from labhil.tui.stream_watch import StreamHealth, StreamWatch

NOW_NS = 1_790_000_000_000_000_000
ENDPOINT = "tcp/127.0.0.1:40123"
RATE = 100.0

STATE = Stream(
    "state",
    (
        Signal("ball_position", "m", Direction.OUTPUT, description="position of the ball from the pivot"),
        Signal("servo_angle", "rad", Direction.INPUT, hold=Hold.LINEAR, description="angle of the gear disc"),
    ),
    RATE,
)


class StillLab:
    """What the screen asks of a lab, answered from fixed data: one live device, one silent, one gone."""

    def __init__(self, *, empty: bool = False) -> None:
        self._empty = empty
        self.fault = ""
        self.replay: ReplayMessage | None = None
        self.latch: Latch | None = None
        self._bench = StreamWatch(STATE, 1.0, {"plugin": "ball_beam"})
        n = 2000
        t = np.arange(n) / RATE
        t_ns = NOW_NS - np.round((t[-1] - t) * 1e9).astype(np.int64)
        ball = 0.12 * np.sin(2 * np.pi * 0.23 * t) + 0.05 * np.sin(2 * np.pi * 0.71 * t)
        servo = np.clip(0.9 * np.sin(2 * np.pi * 0.31 * t), -0.7, 0.7)
        self._bench.ring.append(Batch(np.arange(n), t_ns, t_ns, np.column_stack([ball, servo])))

    def devices(self) -> list[tuple[str, DeviceView]]:
        if self._empty:
            return []
        good = StreamHealth(99.98, 0.004, False, 0, 2000, 0.0006, 0.0021)
        late = StreamHealth(None, 2.3, True, 14, 812, None, None)
        told = {"plugin": "ball_beam", "address": "/dev/ttyACM0", "firmware": "1.4.0", "serial": "BB-0007"}
        leased = Announcement(NOW_NS - 12_000_000_000, "bench", "leased", "lease taken by 'run two-sine'")
        quiet = Announcement(NOW_NS - 2_300_000_000, "spare", "quiet", "the device sends no samples")
        run = "run two-sine-identify"
        return [
            (
                ENDPOINT,
                DeviceView(
                    "bench", "active", "commanded", run, good, STATE, 1.0, told, (0.0312, -0.25), leased
                ),
            ),
            (
                ENDPOINT,
                DeviceView("spare", "idle", "connected", None, late, STATE, 1.0, told, (0.11, 0.0), quiet),
            ),
            (ENDPOINT, DeviceView("old", "gone", "", None, None, None, 1.0, {}, (), None)),
        ]

    def signal_sources(self) -> list[SignalSource]:
        return (
            []
            if self._empty
            else [SignalSource(ENDPOINT, "bench", "state", signal) for signal in STATE.signals]
        )

    def stream(self, _place: SignalSource) -> StreamWatch:
        return self._bench

    def replays(self) -> list[tuple[str, ReplayMessage]]:
        return [] if self.replay is None else [(ENDPOINT, self.replay)]

    def control_replay(self, _endpoint: str, action: str, value: float = 0.0) -> None:
        assert self.replay is not None
        change = {"paused": action == "pause"} if action in ("pause", "play") else {"speed": value}
        self.replay = self.replay.model_copy(update=change)

    def events(self) -> list[Announcement]:
        if self._empty:
            return []
        return [
            Announcement(NOW_NS - 13_000_000_000, "run", "starting", "starting"),
            Announcement(
                NOW_NS - 12_000_000_000, "bench", "leased", "lease taken by 'run two-sine-identify'"
            ),
            Announcement(NOW_NS - 12_000_000_000, "run", "running", "all devices are connected"),
            Announcement(
                NOW_NS - 1_000_000_000,
                "spare",
                "tripped",
                "ball_position 0.26 m is beyond its limit of 0.24 m",
            ),
        ]

    def failure(self) -> str:
        return ""

    def stop_all(self, reason: str) -> Outcome:
        self.latch = Latch("the terminal UI", reason, NOW_NS * 1e-9)
        return Outcome({"bench": "latched"}, {}, ("spare",))

    def release(self) -> None:
        self.latch = None
