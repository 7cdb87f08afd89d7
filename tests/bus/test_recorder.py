"""The recorder against real publishers in processes of their own."""

import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labhil.bus import StreamPublisher, open_bus, publish_event
from labhil.bus.ask import ask_all
from labhil.bus.keys import PUBLISHED, stream_key
from labhil.bus.publish import publish_command
from labhil.codec import Codec
from labhil.errors import CommandRefusedError, RecordingError, RecordingFailedError
from labhil.recording import read_recording
from labhil.recording.writer import FLUSH_INTERVAL
from labhil.service.recorder import Recorder

sys.path.insert(0, str(Path(__file__).parent))
from bus_peer import STREAM, batch
from test_bus import start, wait_until

HERE = Path(__file__).parent


@pytest.fixture
def bus():
    with open_bus() as opened:
        yield opened


def samples(recorder):
    return {stream.device: stream.samples for stream in recorder.summary().streams}


def test_what_is_published_is_recorded_byte_by_byte_from_the_first_sample_on(bus, tmp_path):
    path, count = tmp_path / "a.mcap", 5000
    with Recorder(bus, path, attachments={"rig.toml": b'[rig]\nkind = "ball_beam"\n'}) as recorder:
        peers = [start(bus, "publish", device, count) for device in ("bench", "other")]
        for peer in peers:
            with peer:
                assert peer.stdout.read() == "0\n"
        wait_until(lambda: samples(recorder) == {"bench": count, "other": count})
        summary = recorder.finish("done", "all steps done")
    assert summary.path == path
    assert summary.duration == pytest.approx((count - 1) * 0.01)
    assert {(s.stream, s.samples, s.gaps) for s in summary.streams} == {("state", count, 0)}
    assert [s.rate for s in summary.streams] == pytest.approx([100.0, 100.0])
    recording = read_recording(path)
    assert recording.complete
    assert recording.metadata["end"] == {"exit_status": "done", "reason": "all steps done"}
    assert recording.rig.kind.name == "ball_beam"
    for data in recording.streams:
        assert Codec(STREAM).encode(batch(0, count)) == Codec(data.stream).encode(
            type(batch(0, 1))(data.seq, data.t_acq_ns, data.t_hw_ns, data.values)
        )
        assert data.metadata["serial"] == "A1"
    texts = {(event.device, event.body["text"]) for event in recording.events if event.topic == "event"}
    assert texts == {("bench", "half way"), ("other", "half way")}
    assert {event.device for event in recording.events if event.topic == "status"} == {"recorder"}


def test_gaps_are_counted_and_the_last_status_tells_them(bus, tmp_path):
    with Recorder(bus, tmp_path / "a.mcap") as recorder, StreamPublisher(bus, "bench", STREAM) as publisher:
        publisher.put(batch(0, 100))
        publisher.put(batch(103, 100))
        publisher.put(batch(205, 1))
        wait_until(lambda: samples(recorder) == {"bench": 201})
        summary = recorder.finish()
    assert summary.streams[0].gaps == 5
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.stream_with("ball_position").lost == 5
    last = [event for event in recording.events if event.topic == "status"][-1]
    told = last.body["streams"]["/bench/state"]
    assert (told["received"], told["gaps"], told["waiting"]) == (201, 5, 0)


def test_samples_that_a_publisher_sent_last_and_that_did_not_come_are_counted(bus, tmp_path):
    with Recorder(bus, tmp_path / "a.mcap") as recorder:
        with StreamPublisher(bus, "bench", STREAM) as publisher:
            publisher.put(batch(0, 100))
        wait_until(lambda: samples(recorder) == {"bench": 100})
        assert recorder.summary().streams[0].gaps == 0
        answers = ask_all(bus, PUBLISHED, {"device": "bench", "stream": "state", "last_seq": 149})
        assert list(answers.values()) == [{"received": True}]
        for odd in ({"device": "bench", "stream": "state", "last_seq": -1}, {}):
            assert isinstance(ask_all(bus, PUBLISHED, odd)[PUBLISHED], CommandRefusedError)
        summary = recorder.finish()
    assert summary.streams[0].gaps == 50
    assert summary.warnings == ("bench/state: the last 50 samples were published, but lost",)
    recording = read_recording(tmp_path / "a.mcap")
    last = [event for event in recording.events if event.topic == "status"][-1]
    assert last.body["streams"]["/bench/state"]["gaps"] == 50
    assert summary.warnings[0] in [event.body.get("text") for event in recording.events]


def test_a_publisher_that_left_has_delivered_to_a_recorder_that_is_slow(bus, tmp_path, monkeypatch):
    take = Recorder._receive

    def take_slowly(recorder, key, payloads):
        time.sleep(0.002 * len(payloads))
        take(recorder, key, payloads)

    monkeypatch.setattr(Recorder, "_receive", take_slowly)
    with Recorder(bus, tmp_path / "a.mcap") as recorder:
        with start(bus, "publish", "bench", 2000) as peer:
            assert peer.stdout.read() == "0\n"
        summary = recorder.finish()
    assert (summary.streams[0].samples, summary.streams[0].gaps, summary.warnings) == (2000, 0, ())


def test_recording_goes_on_when_a_publisher_dies(bus, tmp_path):
    with Recorder(bus, tmp_path / "a.mcap") as recorder:
        with start(bus, "stand", "mortal") as mortal, StreamPublisher(bus, "bench", STREAM) as publisher:
            publisher.put(batch(0, 100))
            wait_until(lambda: samples(recorder).get("mortal", 0) > 20)
            mortal.send_signal(signal.SIGKILL)
            mortal.wait()
            publisher.put(batch(100, 100))
            wait_until(lambda: samples(recorder)["bench"] == 200)
        (warning,) = recorder.finish().warnings
    assert "mortal/state: its publisher is gone and did not say how many samples it published" in warning
    recording = read_recording(tmp_path / "a.mcap")
    lengths = {data.device: len(data) for data in recording.streams}
    assert lengths["bench"] == 200
    assert lengths["mortal"] > 20
    assert recording.complete


def test_samples_wait_until_somebody_says_what_they_are(bus, tmp_path):
    payloads = Codec(STREAM).encode(batch(0, 5))
    with Recorder(bus, tmp_path / "a.mcap") as recorder:
        for payload in payloads:
            publish_command(bus, stream_key("bench", "state"), payload)
        with StreamPublisher(bus, "bench", STREAM) as publisher:
            publisher.put(batch(5, 5))
            wait_until(lambda: samples(recorder) == {"bench": 10})
    assert read_recording(tmp_path / "a.mcap").streams[0].seq.tolist() == list(range(10))


def test_samples_that_nobody_explains_are_kept_as_bytes(bus, tmp_path):
    payloads = Codec(STREAM).encode(batch(0, 5))
    with Recorder(bus, tmp_path / "a.mcap"):
        for payload in payloads:
            publish_command(bus, stream_key("ghost", "state"), payload)
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.attachments["ghost.state.unexplained"] == b"".join(payloads)
    assert any("nobody said what they are" in event.body.get("text", "") for event in recording.events)


def test_what_is_no_sample_is_left_out_and_said(bus, tmp_path):
    with Recorder(bus, tmp_path / "a.mcap") as recorder, StreamPublisher(bus, "bench", STREAM) as publisher:
        publisher.put(batch(0, 5))
        wait_until(lambda: samples(recorder) == {"bench": 5})
        publish_command(bus, stream_key("bench", "state"), b"garbage")
        publish_command(bus, "lab/bench/event", b"not json")
        publisher.put(batch(5, 5))
        wait_until(lambda: samples(recorder) == {"bench": 10})
    recording = read_recording(tmp_path / "a.mcap")
    assert len(recording.streams[0]) == 10
    texts = [event.body["text"] for event in recording.events if "text" in event.body]
    assert "not json" in texts
    assert any("left out what is no sample" in text for text in texts)


def test_setpoints_and_questions_are_no_streams(bus, tmp_path):
    with Recorder(bus, tmp_path / "a.mcap"):
        publish_command(bus, "lab/bench/setpoint", b"{}")
        publish_event(bus, "bench", {"text": "limits tripped", "t_ns": 5})
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.streams == ()
    assert not recording.attachments
    assert recording.events[0].t_ns == 5


def test_stamps_of_a_clock_that_was_set_are_said_when_the_recording_ends(bus, tmp_path):
    path = tmp_path / "a.mcap"
    with Recorder(bus, path) as recorder, StreamPublisher(bus, "bench", STREAM, {}) as publisher:
        publisher.put(batch(0, 500))
        late = batch(500, 500)
        publisher.put(replace(late, t_acq_ns=late.t_acq_ns - 500_000_000))
        wait_until(lambda: samples(recorder) == {"bench": 1000})
        summary = recorder.finish()
    (warning,) = summary.warnings
    assert "bench/state: the host's stamps jump by −0.5 s at 5 s" in warning
    recording = read_recording(path)
    assert warning in [event.body.get("text") for event in recording.events]
    assert [line.removeprefix(f"{path}: ") for line in recording.warnings()] == [warning]


def test_an_error_in_the_run_still_ends_the_file(bus, tmp_path):
    with pytest.raises(ZeroDivisionError), Recorder(bus, tmp_path / "a.mcap"):
        _ = 1 / 0
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.metadata["end"] == {
        "exit_status": "failed",
        "reason": "ZeroDivisionError: division by zero",
    }


def test_a_recording_that_exists_is_refused_and_nothing_is_left_behind(bus, tmp_path):
    before = set(threading.enumerate())
    (tmp_path / "a.mcap").write_bytes(b"precious")
    with pytest.raises(RecordingError, match="expected a new file"):
        Recorder(bus, tmp_path / "a.mcap")
    with Recorder(bus, tmp_path / "b.mcap"):
        pass
    assert set(threading.enumerate()) == before


def record_on_a_small_disk(path):
    """Runs in a process of its own, whose files may not grow beyond 40 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))
    status = 1
    with open_bus() as bus, StreamPublisher(bus, "bench", STREAM) as publisher:
        recorder = Recorder(bus, path)
        first = 0
        while recorder.failure is None:
            publisher.put(batch(first, 20))
            first += 20
            time.sleep(0.01)
        publisher.put(batch(first, 20))
        try:
            recorder.finish()
        except RecordingFailedError as error:
            status = 0 if "the disk failed" in str(error) and publisher.error is None else 2
    sys.stdout.write(json.dumps({"threads": threading.active_count()}))
    sys.stdout.flush()
    os._exit(status)


@pytest.mark.extended
def test_a_full_disk_ends_the_recording_cleanly(tmp_path):
    path = tmp_path / "a.mcap"
    code = (
        f"import sys; sys.path.insert(0, {str(HERE)!r});"
        "import test_recorder as t; t.record_on_a_small_disk(t.Path(sys.argv[1]))"
    )
    done = subprocess.run([sys.executable, "-c", code, path], check=True, stdout=subprocess.PIPE)
    assert json.loads(done.stdout) == {"threads": 1}
    recording = read_recording(tmp_path / "a.mcap.part")
    assert not recording.complete
    data = recording.stream_with("ball_position")
    assert len(data) > 0
    assert np.array_equal(data.seq, np.arange(len(data)))


def test_a_killed_recorder_leaves_what_it_flushed(bus, tmp_path):
    path = tmp_path / "a.mcap"
    code = (
        "import sys, time; from pathlib import Path; from labhil.bus import open_bus;"
        "from labhil.service.recorder import Recorder\n"
        "with open_bus(sys.argv[1]) as bus, Recorder(bus, Path(sys.argv[2])) as recorder:\n"
        "    while True:\n"
        "        print(sum(s.samples for s in recorder.summary().streams), flush=True); time.sleep(0.05)\n"
    )
    with (
        start(bus, "stand", "bench") as bench,
        subprocess.Popen(
            [sys.executable, "-c", code, bus.endpoint, path], stdout=subprocess.PIPE, text=True
        ) as recorder,
    ):
        assert bench.stdout.readline() == "ready\n"
        due = float("inf")
        for line in recorder.stdout:
            if int(line) > 1000:
                due = min(due, time.monotonic() + 3.0 * FLUSH_INTERVAL)
            if time.monotonic() > due:
                break
        recorder.kill()
        bench.kill()
    data = read_recording(tmp_path / "a.mcap.part").stream_with("ball_position")
    assert len(data) > 100
    assert data.lost == 0
    assert np.array_equal(data.values, batch(int(data.seq[0]), len(data)).values)


def test_what_strangers_publish_is_left_out_and_said(bus, tmp_path):
    with Recorder(bus, tmp_path / "a.mcap"), StreamPublisher(bus, "bench", STREAM) as publisher:
        publisher.put(batch(0, 5))
        for key in (stream_key("bench", "state"), "lab/nobody/event", "lab/bench/@schema/state"):
            for _ in range(20):
                bus.session.put(key, b"false")
        publisher.put(batch(5, 5))
    recording = read_recording(tmp_path / "a.mcap")
    (data,) = recording.streams
    assert (len(data), data.lost) == (10, 0)
    said = [str(event.body["message"]) for event in recording.events if event.body.get("kind") == "rejected"]
    for key in (stream_key("bench", "state"), "lab/nobody/event", "lab/bench/@schema/state"):
        assert any(f"refused at {key}: not authenticated" in text for text in said), said


def test_what_happens_to_the_machines_clocks_stands_in_the_recording_and_is_told(bus, tmp_path, monkeypatch):
    wall = time.time_ns
    with Recorder(bus, tmp_path / "a.mcap") as recorder:
        monkeypatch.setattr(time, "time_ns", lambda: wall() + 3_600_000_000_000)
        summary = recorder.finish("0", "done")
    assert summary.warnings == ("the wall clock was set ahead by 3600 s; stamps go on as before",)
    (event,) = [e for e in read_recording(summary.path).events if e.body.get("kind") == "clock_set"]
    assert event.device == "recorder" and event.body["message"] == summary.warnings[0]
