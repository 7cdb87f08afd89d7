"""A second process on the bus that has no key and sends whatever it likes."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh

from labhil.bus import latch, register
from labhil.bus.ask import ask
from labhil.bus.authentication import Signer, Verifier, new_key
from labhil.bus.keys import ALL_STREAMS, command_key, event_key, schema_key, setpoint_key, stream_key
from labhil.bus.publish import publish_command
from labhil.bus.session import open_bus
from labhil.bus.subscribe import subscribe
from labhil.codec import Codec, stream_from_json
from labhil.errors import CommandRefusedError
from labhil.experiment.control import RunControl, RunState
from labhil.experiment.device_run import DeviceRun
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.run import RunResult, run_experiment
from labhil.recording.reader import read_recording
from labhil.service.emergency import press_everywhere
from labhil.service.messages import Setpoint
from labhil.service.recorder import Recorder
from labhil.signals import Batch

PATIENCE = 60.0
RIG = """
[rig]
kind = "ball_beam"
[limits]
servo_angle = { min = -1.2, max = 1.2, rate = 12.0 }
"""
EXPERIMENT = """
[experiment]
name = "strangers"
[devices.bench]
plugin = "ball_beam"
address = "twin"
rig = "rig.toml"
twin = { speed = 2.0, seed = 3 }
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "chirp"
frequencies = [0.2, 0.4]
amplitude = 0.1
stabilise = { on = "ball_position", kp = 7.0, kd = 3.0 }
duration = 300.0
"""
DEEP = b'{"a":' * 5000 + b"1" + b"}" * 5000
NUMBERS = (
    "1e999",
    "-1e999",
    "NaN",
    "Infinity",
    "-Infinity",
    "9" * 400,
    "-1",
    "1.5",
    "true",
    "null",
    '"1"',
    "[]",
    "{}",
)
TEXTS = ('"\\ud800"', '"\\udc00x"', "1", "null", "true", "[]", "{}", f'"{"x" * 5000}"', '"\\u0000"')
WIDE = {"name": "a b", "unit": "", "direction": "input", "width": 10**9}
MALFORMED = [
    b"",
    b"{}",
    b"[]",
    b"null",
    b"true",
    b"0",
    b'"text"',
    b"{",
    b"}",
    b"[{}]",
    b"\x00",
    b"\xff\xfe",
    b"\xed\xa0\x80",
    b"{'t_ns': 1}",
    b'{"t_ns": 1,}',
    b"[" * 100_000,
    DEEP,
    b'{"a": ' + DEEP + b"}",
    b" " * 70_000 + b"{}",
    b"x" * 1_000_000,
    b'{"x": "' + b"y" * 70_000 + b'"}',
    bytes(range(256)),
    *(b'{"token": "x", "values": {}, "kind": "a", "message": "b", "t_ns": %s}' % n.encode() for n in NUMBERS),
    *(b'{"token": "x", "t_ns": 1, "values": {"servo_angle": %s}}' % n.encode() for n in NUMBERS),
    *(b'{"t_ns": 1, "kind": %s, "message": "b"}' % t.encode() for t in TEXTS),
    *(b'{"action": %s, "holder": "x"}' % t.encode() for t in TEXTS),
    *(b'{"action": "return", "token": %s}' % t.encode() for t in TEXTS),
    *(b'{"reason": %s, "action": "perhaps"}' % t.encode() for t in TEXTS),
    *(b'{"stream": %s, "metadata": {"speed": "nan"}}' % t.encode() for t in TEXTS),
    b'{"stream": "{\\"name\\": \\"state\\", \\"rate\\": 1e999, \\"signals\\": []}", "metadata": {}}',
    json.dumps({"stream": json.dumps({"name": "state", "rate": 1, "signals": [WIDE]})}).encode(),
]  # fmt: skip
PUBLISHED = (
    event_key("bench"),
    setpoint_key("bench"),
    stream_key("bench", "state"),
    stream_key("bench", "command"),
    schema_key("bench", "state"),
    event_key("run"),
    "lab/nobody/state",
    "lab/nobody/event",
)
ASKED = (
    *(command_key("bench", name) for name in ("status", "set", "safe", "lease", "shutdown")),
    *(command_key("@run", name) for name in ("status", "pause", "resume", "stop", "abort")),
    schema_key("bench", "state"),
)


@contextmanager
def stranger(endpoint: str) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    for key, value in (
        ("mode", "peer"),
        ("scouting/multicast/enabled", False),
        ("connect/endpoints", [endpoint]),
        ("listen/endpoints", ["tcp/127.0.0.1:0"]),
    ):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        time.sleep(0.5)
        yield session


def asked(session: zenoh.Session, key: str, payload: bytes, attachment: bytes | None = None) -> list[Any]:
    replies = session.get(key, payload=payload, attachment=attachment, timeout=3.0)
    return [
        json.loads((reply.ok.payload if reply.ok is not None else reply.err.payload).to_bytes())
        for reply in replies
    ]


class Running:
    """A run in a thread of its own."""

    def __init__(self, directory: Path) -> None:
        (directory / "rig.toml").write_text(RIG)
        experiment = parse_experiment(EXPERIMENT, directory / "experiment.toml")
        self.control, self.result = RunControl(), None
        self.thread = threading.Thread(target=self._run, args=(experiment, directory))
        self.thread.start()
        assert self.control.wait_for(RunState.RUNNING, timeout=PATIENCE), self.control.reason
        (self.entry,) = register.registered_processes("run")

    def _run(self, experiment: Any, directory: Path) -> None:
        self.result = run_experiment(experiment, directory, control=self.control)

    def finish(self, within: float = PATIENCE) -> RunResult:
        self.thread.join(within)
        assert self.result is not None, "the run goes on"
        return self.result


@pytest.fixture
def start_run(tmp_path: Path) -> Iterator[Callable[[], Running]]:
    runs: list[Running] = []

    def start() -> Running:
        runs.append(Running(tmp_path))
        return runs[-1]

    yield start
    latch.release()
    for run in runs:
        if run.thread.is_alive():
            run.control.abort("the test is over")
            run.thread.join(PATIENCE)


def test_whatever_comes_in_the_emergency_stop_is_heard(start_run: Callable[[], Running]) -> None:
    assert len(MALFORMED) >= 50
    run = start_run()
    with stranger(run.entry.endpoint) as session:
        for key in PUBLISHED:
            for payload in MALFORMED:
                session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        for key in ASKED:
            for payload in MALFORMED:
                for reply in asked(session, key, payload):
                    assert "state" in reply or "stream" in reply or reply["error"] == "CommandRefusedError", (
                        reply
                    )
        (status,) = asked(session, command_key("bench", "status"), b"{}")
    assert run.control.state is RunState.RUNNING, run.control.reason
    assert status["state"] == "active" and status["refused"][setpoint_key("bench")] == len(MALFORMED)
    outcome = press_everywhere("a test", "after all that")
    assert dict(outcome.answered) == {"bench": "latched"}
    result = run.finish(10.0)
    assert result.exit_status == 1 and "emergency stop by a test" in result.reason
    recording = read_recording(result.path)
    rejected = [event for event in recording.events if event.body.get("kind") == "rejected"]
    assert {event.device for event in rejected} == {"bench", "recorder", "run"}
    assert len(rejected) < 200, "not every one is reported"


@pytest.mark.extended
def test_a_second_operator_moves_nothing(start_run: Callable[[], Running]) -> None:
    run = start_run()
    with open_bus(run.entry.endpoint) as bus:  # who has the key, but not the lease
        with pytest.raises(CommandRefusedError, match="the device is held by"):
            ask(bus, command_key("bench", "lease"), {"holder": "a second operator"}, patience=10.0)
        for name, payload in (("set", {}), ("lease", {"action": "return"}), ("lease", {"action": "renew"})):
            question = {"token": "guessed", "t_ns": time.time_ns(), "values": {"servo_angle": 0.5}, **payload}
            with pytest.raises(CommandRefusedError, match="this is not its token"):
                ask(bus, command_key("bench", name), question)
        for age in (0, 10**9, -(10**9)):
            setpoint = Setpoint("guessed", time.time_ns() - age, {"servo_angle": 0.5})
            publish_command(bus, setpoint_key("bench"), setpoint.to_bytes())
        deadline = time.monotonic() + PATIENCE
        while (status := ask(bus, command_key("bench", "status")))["refused"].get(setpoint_key("bench")) != 3:
            assert time.monotonic() < deadline, status
    assert status["state"] == "active" and abs(status["applied"]["servo_angle"]) < 0.5
    assert run.control.state is RunState.RUNNING, run.control.reason


@pytest.mark.extended
def test_false_samples_and_events_move_no_run(start_run: Callable[[], Running]) -> None:
    run = start_run()
    state, event = stream_key("bench", "state"), event_key("bench")
    heard: dict[str, tuple[bytes, bytes]] = {}
    with stranger(run.entry.endpoint) as session:

        def listen(sample: zenoh.Sample) -> None:
            heard[str(sample.key_expr)] = sample.payload.to_bytes(), sample.attachment.to_bytes()

        listening = session.declare_subscriber("lab/bench/*", listen)
        deadline = time.monotonic() + PATIENCE
        while state not in heard:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        listening.undeclare()
        sample, code = heard[state]
        codec = Codec(stream_from_json(asked(session, schema_key("bench", "state"), b"{}")[0]["stream"]))
        true = codec.decode([sample])
        (false,) = codec.encode(
            Batch(true.seq + 10**6, true.t_acq_ns + 10**12, true.t_hw_ns + 10**12, true.values + 10.0)
        )
        failed = json.dumps({"t_ns": time.time_ns() + 10**9, "kind": "failed", "message": "false"}).encode()
        for key, payload in ((state, false), (event, failed)):
            for attachment in (None, code, code[:-1], Signer([new_key()]).sign(key, payload)):
                session.put(key, payload, attachment=attachment)
        for _ in range(5):
            session.put(state, sample, attachment=code)
        before = asked(session, command_key("@run", "status"), b"{}")[0]
        time.sleep(0.5)
        after = asked(session, command_key("@run", "status"), b"{}")[0]
    assert run.control.state is RunState.RUNNING, run.control.reason
    assert after["state"] == "running" and after != before, "the steps go on"
    run.control.stop("enough")
    result = run.finish()
    (recorded,) = [data for data in read_recording(result.path).streams if data.stream.name == "state"]
    assert abs(recorded["ball_position"]).max() < 1.0 and recorded.lost == 0
    said = " ".join(str(one.body.get("message")) for one in read_recording(result.path).events)
    assert f"refused at {state}: " in said and f"refused at {event}: not authenticated" in said


@pytest.mark.extended
@pytest.mark.parametrize("payload", [b"{}", b'{"by": 5, "reason": ["x"]}', b'{"action": "press", "x": 1e9}'])
def test_anybody_may_press_the_emergency_stop_however_badly(bench: Any, payload: bytes) -> None:
    with stranger(bench.bus.endpoint) as session:
        (answer,) = asked(session, command_key("bench", "estop"), payload)
        assert answer == {"state": "latched", "latched": True}
        (refused,) = asked(session, command_key("bench", "estop"), b'{"action": "release"}')
    assert "not authenticated" in refused["message"]
    assert bench.ask("status")["state"] == "latched"
    assert bench.ask("estop", action="release")["latched"] is False


def test_only_who_has_the_key_commands(bench: Any) -> None:
    heard: list[tuple[bytes, bytes]] = []
    token = bench.take_lease()
    with stranger(bench.bus.endpoint) as session:

        def listen(sample: zenoh.Sample) -> None:
            heard.append((sample.payload.to_bytes(), sample.attachment.to_bytes()))

        listening = session.declare_subscriber(setpoint_key("bench"), listen)
        time.sleep(0.3)
        while not heard:
            bench.put(0.0)
            time.sleep(0.02)
        listening.undeclare()
        payload, code = heard[-1]
        assert json.loads(payload)["token"] == token  # it is no secret, and of no use
        moved = Setpoint(token, time.time_ns(), {"servo_angle": 0.5}).to_bytes()
        refusals = {
            "replayed": (payload, code),
            "forged": (moved, code),
            "unsigned": (moved, None),
            "of another key": (moved, Signer([new_key()]).sign(setpoint_key("bench"), moved)),
            "cut": (moved, code[:-1]),
        }
        for data, attachment in refusals.values():
            session.put(setpoint_key("bench"), data, attachment=attachment)
        for name, question in (
            ("lease", {"action": "return", "token": token}),
            ("lease", {"action": "take"}),
            ("set", json.loads(moved)),
            ("shutdown", {}),
            ("safe", {}),
        ):
            (answer,) = asked(session, command_key("bench", name), json.dumps(question).encode())
            assert "not authenticated" in answer["message"]
    deadline = time.monotonic() + 60.0
    while (counts := bench.ask("status")["refused"]).get(setpoint_key("bench"), 0) < len(refusals):
        assert time.monotonic() < deadline, counts
    assert counts[command_key("bench", "lease")] == 2
    assert bench.ask("status")["applied"] == {"servo_angle": 0.0}
    assert "not authenticated" in bench.wait_for_event("rejected")["message"] or "replayed" in str(
        bench.events
    )


def test_the_key_is_this_users_alone_and_gone_with_its_session() -> None:
    with open_bus() as bus, open_bus(bus.endpoint) as joined:
        files = list(register.runtime_directory().glob(f"{os.getpid()}-*.key"))
        assert len(files) == 2 and all(file.stat().st_mode & 0o077 == 0 for file in files)
        assert bus.keys == joined.keys
    assert not list(register.runtime_directory().glob(f"{os.getpid()}-*.key"))


def test_numbers_come_once_in_any_order_and_not_from_before(monkeypatch: pytest.MonkeyPatch) -> None:
    key = new_key()
    verifier, signer = Verifier([key]), Signer([new_key(), key])
    codes = [signer.sign("a", b"x") for _ in range(100)]
    for index in (3, 1, 2, 0, 99, 98, 50):
        assert verifier.objection("a", b"x", codes[index]) == ""
        assert "replayed" in verifier.objection("a", b"x", codes[index])
    assert "replayed" in verifier.objection("a", b"x", codes[10])  # more than the window behind
    assert "not made with" in verifier.objection("b", b"x", codes[60])
    assert "not made with" in verifier.objection("a", b"y", codes[60])
    assert verifier.objection("a", b"x", codes[60]) == ""
    assert "another time" in Verifier([key]).objection("a", b"x", codes[61])
    assert Verifier([key], transit=60.0).objection("a", b"x", codes[61]) == ""
    monkeypatch.setattr(time, "monotonic_ns", partial(int, time.monotonic_ns() + 60 * 10**9))
    assert "another time" in Verifier([key], transit=100.0).objection("a", b"x", codes[61])
    assert Verifier([key], max_age=120.0, transit=100.0).objection("a", b"x", codes[61]) == ""


@pytest.mark.extended
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize(
    "part",
    [
        "the recorder",
        pytest.param("events of a device", marks=pytest.mark.extended),
        pytest.param("a listener", marks=pytest.mark.extended),
    ],
)
def test_a_thread_that_dies_ends_the_run(
    start_run: Callable[[], Running], monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    run = start_run()
    began = time.monotonic()

    def dies(*_: object) -> None:
        raise SystemExit

    if part == "events of a device":
        monkeypatch.setattr(DeviceRun, "_take_event", dies)
    elif part == "the recorder":
        monkeypatch.setattr(Recorder, "_tick", dies)
    else:
        monkeypatch.setattr(DeviceRun, "_decode_own", dies)
    with open_bus(run.entry.endpoint) as bus:  # which has the key: what is not signed comes to no thread
        key, event = event_key("bench"), b'{"t_ns": 9000000000000000000, "kind": "x"}'
        bus.session.put(key, event, attachment=bus.sign(key, event))
        while run.control.state is RunState.RUNNING and time.monotonic() < began + 60.0:
            time.sleep(0.01)
    # how soon is measured by measure_threads.py: a test machine may have no time for a second or two
    assert run.control.state is not RunState.RUNNING
    result = run.finish()
    assert result.exit_status == 1
    assert "died" in result.reason or "SystemExit" in result.reason


def test_what_a_callback_raises_is_a_failure_of_the_bus() -> None:
    def fails(_key: str, _payloads: list[bytes]) -> None:
        raise KeyError("t_ns")

    with open_bus() as bus, subscribe(bus, ALL_STREAMS, fails):
        assert bus.failure() == ""
        deadline = time.monotonic() + 60.0
        while not bus.failure() and time.monotonic() < deadline:
            publish_command(bus, event_key("a"), b"{}")
            time.sleep(0.01)
        assert "KeyError('t_ns')" in bus.failure()
    with pytest.raises(CommandRefusedError):
        Setpoint.from_bytes(b"[]")
