"""A recording on the bus: read back by another session, and taken for a device by nobody."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from textual.pilot import Pilot
from textual.widgets import Static

from labhil.bus import ask, live_devices, open_bus, subscribe
from labhil.bus.keys import ALL_STREAMS, REPLAY_CONTROL, REPLAYED_STREAMS
from labhil.bus.register import find_run, registered_processes
from labhil.bus.session import Bus
from labhil.codec import Codec, stream_from_json
from labhil.errors import BusError, CommandRefusedError, OptionError, RecordingError, UsageError
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording
from labhil.service.emergency import press_everywhere, release_everywhere
from labhil.service.replay import Replay
from labhil.signals import Batch
from labhil.tui.app import LabApp
from labhil.tui.live import LivePane
from labhil.tui.replay_control import next_speed
from labhil.tui.session import Session

ROOT = Path(__file__).parents[2]
FILE = ROOT / "recordings" / "ball_beam_identify.mcap"
PATIENCE = 60.0


@pytest.fixture
def recording() -> Recording:
    return read_recording(FILE)


class Heard:
    """What came in, by key."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.payloads, self._codecs = bus, {}, {}
        self._lock = threading.Lock()

    def take(self, key: str, payloads: list[bytes]) -> None:
        with self._lock:
            self.payloads.setdefault(key, []).extend(payloads)

    def batch(self, key: str) -> Batch:
        """The samples that came in under a key so far."""
        if key not in self._codecs:
            said = ask(self.bus, "/@schema/".join(key.rsplit("/", 1)), patience=5.0)
            self._codecs[key] = Codec(stream_from_json(said["stream"]))
        with self._lock:
            return self._codecs[key].decode(list(self.payloads.get(key, [])))


@contextmanager
def listening(endpoint: str) -> Iterator[Heard]:
    with open_bus(endpoint) as bus:
        heard = Heard(bus)
        with subscribe(bus, REPLAYED_STREAMS, heard.take), subscribe(bus, ALL_STREAMS, heard.take):
            yield heard


def wait_until(condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not come to that"
        time.sleep(0.02)


def first_seconds(recording: Recording, seconds: float) -> Recording:
    """The beginning of a recording, so that a test sees its end soon."""
    streams = tuple(
        replace(
            data,
            **{
                name: getattr(data, name)[data.t <= seconds]
                for name in ("seq", "t_acq_ns", "t_hw_ns", "values", "t")
            },
        )
        for data in recording.streams
    )
    return replace(recording, streams=streams)


def key_of(recording: Recording) -> str:
    data = recording.stream_with("ball_position")
    return f"replay/{data.device}/{data.stream.name}"


def test_another_session_reads_back_what_the_recording_holds(recording: Recording) -> None:
    short = first_seconds(recording, 10.0)
    data = short.stream_with("ball_position")
    with Replay(short, speed=10.0) as replay, listening(replay.endpoint) as heard:
        assert replay.wait(PATIENCE)
        key = key_of(short)
        wait_until(
            lambda: (
                key in heard.payloads and len(heard.batch(key)) and heard.batch(key).seq[-1] == data.seq[-1]
            )
        )
        found = heard.batch(key)
        assert {place.split("/")[0] for place in heard.payloads} == {"replay"}
    rows = np.searchsorted(data.seq, found.seq)  # who joins late has missed the first
    assert len(found) > 0.5 * len(data)
    assert np.array_equal(data.seq[rows], found.seq)
    assert np.array_equal(data.values[rows], found.values)
    assert np.array_equal(data.t_hw_ns[rows], found.t_hw_ns)
    assert np.all(np.diff(found.t_acq_ns) >= 0)
    assert abs(found.t_acq_ns[-1] - time.time_ns()) < 120e9, "stamped as if it had just come"
    shown = (found.t_acq_ns - found.t_acq_ns[-1]) * 1e-9
    recorded = (data.t_common[rows] - data.t_common[rows][-1]) / 10.0
    assert np.allclose(shown, recorded, atol=1e-3), "no faster and no slower than it was asked for"


@pytest.mark.extended
def test_a_hole_stays_a_hole_and_events_come_with_their_texts(recording: Recording) -> None:
    short = first_seconds(recording, 4.0)
    data = short.stream_with("ball_position")
    whole = np.r_[0 : len(data) // 2, len(data) // 2 + 7 : len(data)]
    holed = replace(
        data, **{name: getattr(data, name)[whole] for name in ("seq", "t_acq_ns", "t_hw_ns", "values", "t")}
    )
    others = tuple(each for each in short.streams if each is not data)
    with Replay(replace(short, streams=(holed, *others)), speed=5.0) as replay:
        replay.pause()
        replay.seek(0.0)
        with listening(replay.endpoint) as heard:
            time.sleep(0.5)
            replay.play()
            assert replay.wait(PATIENCE)
            key = key_of(short)
            wait_until(
                lambda: (
                    len(heard.batch(key))
                    and heard.batch(key).seq[-1] == heard.batch(key).seq[0] + data.seq[-1] - data.seq[0]
                )
            )
            steps = np.diff(heard.batch(key).seq)
            said = b"".join(b"".join(p) for place, p in heard.payloads.items() if place.endswith("/event"))
    assert sorted(set(steps.tolist())) == [1, 8]
    early = [e for e in recording.events if e.topic == "event" and e.t <= 3.0 and e.body.get("message")]
    assert early
    assert all(str(event.body["message"]).encode() in said for event in early)


def test_a_pause_holds_it_and_it_goes_on_where_it_was(recording: Recording) -> None:
    with Replay(recording, speed=2.0) as replay, open_bus(replay.endpoint) as bus:
        wait_until(lambda: replay.status.position > 0.3)
        said = ask(bus, REPLAY_CONTROL, {"action": "pause"}, patience=5.0)
        assert said["paused"]
        time.sleep(0.3)
        assert ask(bus, REPLAY_CONTROL, {})["position"] == said["position"]
        assert ask(bus, REPLAY_CONTROL, {"action": "speed", "value": 20.0})["speed"] == 20.0
        schema = ask(bus, "/@schema/".join(key_of(recording).rsplit("/", 1)))
        world = recording.stream_with("ball_position").speed
        assert float(schema["metadata"]["speed"]) == pytest.approx(20.0 * world)
        assert schema["metadata"]["replay"] == FILE.name
        assert schema["metadata"]["replay_sha256"] == recording.sha256
        ask(bus, REPLAY_CONTROL, {"action": "play"})
        wait_until(lambda: ask(bus, REPLAY_CONTROL, {})["position"] > said["position"] + 1.0)
        with pytest.raises(CommandRefusedError, match=r"expected 0\.01 to 100"):
            ask(bus, REPLAY_CONTROL, {"action": "speed", "value": 1e6})
        with pytest.raises(CommandRefusedError, match="action"):
            ask(bus, REPLAY_CONTROL, {"action": "fly"})


def test_positions_are_in_the_time_of_info_and_plots(recording: Recording) -> None:
    """Also where the clocks of the devices ran twice as fast as that of the host."""
    streams = tuple(
        replace(data, speed=2.0 * data.speed, clock=replace(data.clock, map=None))
        for data in recording.streams
    )
    fast = replace(recording, streams=streams)
    data, key = fast.stream_with("ball_position"), key_of(fast)
    assert data.t_common[-1] == pytest.approx(data.t[-1] / 2.0)
    with pytest.raises(OptionError, match=f"expected 0 to {fast.duration:.4g} s"):
        Replay(fast, start=fast.duration + 0.1)
    with Replay(fast, start=20.0) as replay, listening(replay.endpoint) as heard:
        assert 20.0 <= replay.status.position <= replay.status.duration
        assert replay.status.duration == pytest.approx(fast.duration)
        replay.pause()
        replay.seek(24.0)
        assert replay.status.position == pytest.approx(24.0)
        heard.payloads.clear()
        replay.play()
        wait_until(lambda: key in heard.payloads)
        first = data.t[data.seq == heard.batch(key).seq[0] - replay._tracks[0].seq_shift]
    assert first == pytest.approx(24.0, abs=0.2)


def test_going_back_and_looping_never_turn_numbers_or_clocks_back(recording: Recording) -> None:
    short = first_seconds(recording, 3.0)
    with Replay(short, speed=10.0, loop=True) as replay, listening(replay.endpoint) as heard:
        key, data = key_of(short), short.stream_with("ball_position")
        wait_until(lambda: len(heard.payloads.get(key, [])) > 3 * len(data))
        found = heard.batch(key)
    assert np.all(np.diff(found.seq) == 1)
    assert np.all(np.diff(found.t_hw_ns) > 0)
    first = np.flatnonzero(np.all(found.values == data.values[0], axis=1))
    assert len(first) >= 2, "it has begun again"


def test_nobody_takes_it_for_a_device_or_a_run(recording: Recording) -> None:
    with Replay(recording) as replay, open_bus(replay.endpoint) as bus:
        assert [entry.devices for entry in registered_processes("replay")] == [()]
        assert not registered_processes("run")
        with pytest.raises(UsageError, match="found none"):
            find_run()
        ask(bus, REPLAY_CONTROL, {}, patience=5.0)
        assert live_devices(bus) == ()
        device = recording.streams[0].device
        with pytest.raises(BusError, match="nobody answers"):
            ask(bus, f"lab/{device}/cmd/lease", {"action": "take", "holder": "me"})
        try:
            stopped = press_everywhere("a test", "to see who answers")
        finally:
            release_everywhere()
        assert (dict(stopped.answered), dict(stopped.failed), stopped.silent) == ({}, {}, ())
        assert not replay.status.ended


def test_wrong_use_says_what_is_expected(recording: Recording) -> None:
    with pytest.raises(OptionError, match=r"0\.01 to 100, found 0"):
        Replay(recording, speed=0.0)
    with pytest.raises(OptionError, match="expected 0 to"):
        Replay(recording, start=1e6)
    with pytest.raises(RecordingError, match="expected samples to replay, found none"):
        Replay(replace(recording, streams=()))


@pytest.mark.extended
def test_the_command_plays_and_ends_with_its_recording_or_with_ctrl_c(tmp_path: Path) -> None:
    command = [sys.executable, "-P", "-m", "labhil", "replay", str(FILE), "--no-screen"]
    end = read_recording(FILE).duration
    done = subprocess.run(
        [*command, "--speed", "100", "--from", str(round(end * 0.5))],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
        timeout=PATIENCE,
    )
    assert done.stdout.startswith("tcp/127.0.0.1:")
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout is not None
        endpoint = process.stdout.readline().strip()
        with listening(endpoint) as heard:
            wait_until(lambda: len(heard.payloads.get(key_of(read_recording(FILE)), [])) > 50)
        os.kill(process.pid, signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    assert not registered_processes("replay")


def test_the_live_page_draws_it_says_so_and_steers_it(recording: Recording, tmp_path: Path) -> None:
    async def go() -> None:
        with Replay(recording) as replay, Session() as lab:
            app = LabApp(tmp_path, lab, tab="live")
            async with app.run_test(size=(80, 24)) as pilot:
                await come(pilot, lambda: len(app.query_one(LivePane)._charts) >= 2)
                await come(pilot, lambda: "REPLAY" in shown(app))
                assert {view.state for _, view in lab.devices()} == {"replay"}
                await pilot.press("p")
                await come(pilot, lambda: replay.status.paused and "PAUSED" in shown(app))
                await pilot.press("greater_than_sign")
                await come(pilot, lambda: replay.status.speed == 2.0)
                at = replay.status.position
                await pilot.press("j", "p")
                await come(pilot, lambda: not replay.status.paused)
                assert replay.status.position < at + PATIENCE
                places = lab.signal_sources()
                assert {place.device.split("/")[0] for place in places} == {"replay"}

    asyncio.run(go())


async def come(pilot: Pilot[None], condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it did not come to that"
        await pilot.pause(0.05)


def shown(app: LabApp) -> str:
    return str(app.query_one("#live-state", Static).render())


def test_speeds_go_in_round_steps_and_stay_in_bounds() -> None:
    assert [next_speed(1.0, 1), next_speed(3.0, 1), next_speed(1.0, -1)] == [2.0, 5.0, 0.5]
    assert [next_speed(100.0, 1), next_speed(0.1, -1)] == [100.0, 0.1]
