"""Whole runs: the command line, the simulated device on its wire, the recording read back."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL

from labhil.errors import RecordingError
from labhil.experiment.experiment import parse_experiment
from labhil.experiment.run import Progress, run_experiment
from labhil.kinds import kind_named
from labhil.physics.rigs import record_of
from labhil.recording.reader import read_recording
from labhil.recording.recording import Recording

MARK = "LABHIL_TEST_RUN"
PATIENCE = 120.0

RIG = """
[rig]
kind = "ball_beam"
[known]
ball_mass = 0.261
[limits]
servo_angle = { min = -1.2, max = 1.2, rate = 12.0 }
ball_position = { min = -0.3, max = 0.3 } # beyond the stops: a ball that a busy machine drops ends no run
"""


def experiment(address: str = "twin", duration: float = 6.0, twin: str = "", more: str = "") -> str:
    return f"""
[experiment]
name = "two sines"
[devices.bench]
plugin = "ball_beam"
address = "{address}"
rig = "rig.toml"
twin = {{ speed = 5.0, seed = 3, terms = ["viscous_friction", "coulomb_friction"]{twin} }}
{more}
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "two_sine"
frequencies = [0.23, 0.31]
amplitude = 0.4
stabilise = {{ on = "ball_position", kp = 7.0, kd = 3.0 }}
duration = {duration}
"""


class Cli:
    """Runs ``labhil`` in a directory, and sees to it that nothing it started outlives it."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.mark = f"{directory}-{os.getpid()}"
        (directory / "rig.toml").write_text(RIG)

    def start(self, text: str, *options: str) -> subprocess.Popen[str]:
        (self.directory / "experiment.toml").write_text(text)
        return subprocess.Popen(
            [*PATIENT_LABHIL, "run", "experiment.toml", *options],
            cwd=self.directory,
            env={**os.environ, MARK: self.mark},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, text: str, *options: str) -> subprocess.CompletedProcess[str]:
        return self.finish(self.start(text, *options))

    def finish(self, process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
        out, err = process.communicate(timeout=300.0)
        assert "Traceback" not in err
        self.wait_for_silence()
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def wait_for_silence(self) -> None:
        """Every process that the run started ends with it, or soon after."""
        wait_until(lambda: not list(self.processes()), "processes of the run are left")

    def processes(self) -> Iterator[psutil.Process]:
        for process in psutil.process_iter():
            try:
                if process.environ().get(MARK) == self.mark and process.status() != psutil.STATUS_ZOMBIE:
                    yield process
            except psutil.Error:
                continue

    def host(self, run: subprocess.Popen[str]) -> psutil.Process:
        """The host of a run; where that has ended by itself, the test fails with what it said."""
        hosts = [process for process in self.processes() if "labhil.service.host" in process.cmdline()]
        assert hosts, f"the run has ended: {self.finish(run).stderr}"
        return hosts[0]

    def recordings(self) -> list[Path]:
        return sorted(self.directory.glob("*.mcap*"))

    def wait_until_it_records(self) -> None:
        """The recorder flushes twice a second: a recording of this size holds samples."""
        wait_until(
            lambda: any(path.stat().st_size > 20_000 for path in self.recordings()), "nothing was recorded"
        )


def wait_until(condition: Callable[[], bool], otherwise: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, otherwise
        time.sleep(0.05)


@pytest.fixture
def cli(tmp_path: Path) -> Cli:
    return Cli(tmp_path)


def last_line(done: subprocess.CompletedProcess[str]) -> Path:
    return Path(done.stdout.splitlines()[-1])


def kinds(recording: Recording, device: str) -> list[str]:
    """Return what happened to a device, or to the ``run``, in order."""
    events = [event for event in recording.events if (event.device, event.topic) == (device, "event")]
    return [event.body["kind"] for event in events]


@pytest.fixture(scope="module")
def done_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """Return the result of an undisturbed run, as its JSON says it, and the path of its recording."""
    cli = Cli(tmp_path_factory.mktemp("run"))
    done = cli.run(experiment(twin=", set = { start_position = 0.01 }"), "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    return result, cli.directory / result["path"]


def test_a_run_leaves_what_it_did(done_run: tuple[dict[str, Any], Path]) -> None:
    result, path = done_run
    assert result["schema"] == "labhil.run/1"
    assert (result["exit_status"], result["reason"]) == (0, "all steps are done")
    recording = read_recording(path)
    assert recording.complete
    assert recording.rig is not None
    assert recording.rig.known_number("ball_mass") == 0.261
    state = recording.stream_with("ball_position", "servo_angle")
    told = {(item["device"], item["stream"]): item for item in result["streams"]}[("bench", "state")]
    assert (len(state), state.lost) == (told["samples"], told["gaps"]) == (len(state), 0)
    # measured as samples arrive, and a machine with much to do lets the first of them wait
    assert told["rate"] == pytest.approx(100.0, rel=0.3)
    assert state.speed == 5.0
    assert 6.0 <= state.t[-1] < 12.0
    np.testing.assert_allclose(np.diff(state.t), 0.01, atol=0.002)
    assert kinds(recording, "run") == ["starting", "running", "stopping", "finished"]


def test_the_recorded_input_is_the_command_in_effect(done_run: tuple[dict[str, Any], Path]) -> None:
    recording = read_recording(done_run[1])
    state = recording.stream_with("ball_position", "servo_angle")
    command = recording.stream_with("servo_angle_requested", "servo_angle_applied")
    sent = np.unique(command["servo_angle_applied"])
    in_effect = state["servo_angle"]
    moved = in_effect[in_effect != 0.0]
    # the pulse width has steps of π/1000; what the device shows was sent to it, and nothing else
    nearest = np.abs(moved[:, None] - sent[None, :]).min(axis=1)
    assert len(moved) > 100
    assert nearest.max() < np.pi / 1000


def test_what_a_twin_is_made_of_stands_beside_the_recording_only(
    done_run: tuple[dict[str, Any], Path],
) -> None:
    path = done_run[1]
    answer = json.loads(path.with_suffix(".twin.json").read_text())
    assert answer["terms"] == ["viscous_friction", "coulomb_friction"]
    recording = read_recording(path)
    assert set(recording.attachments) == {"rig.toml", "experiment.toml"}
    told = json.dumps(
        [dict(recording.metadata), [dict(stream.metadata) for stream in recording.streams]], default=dict
    )
    told += "".join(data.decode() for data in recording.attachments.values())
    for secret in ("viscous", "coulomb", "start_position", "twin ="):
        assert secret not in told


def test_ctrl_c_leaves_a_readable_recording(cli: Cli) -> None:
    process = cli.start(experiment(duration=100.0))
    cli.wait_until_it_records()
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGINT)
    done = cli.finish(process)
    assert done.returncode == 1
    assert "stopped by SIGINT" in done.stderr
    recording = read_recording(cli.directory / last_line(done))
    assert recording.complete
    assert recording.path.suffix == ".mcap"
    assert kinds(recording, "bench").count("safe") == 1


@pytest.mark.extended
def test_ctrl_c_before_the_first_sample_leaves_nothing(cli: Cli) -> None:
    before = {path.name for path in cli.directory.iterdir()} | {"experiment.toml"}
    process = cli.start(experiment(duration=100.0))
    deadline = time.monotonic() + PATIENCE
    while not list(cli.directory.glob("*.twin.json")):
        assert time.monotonic() < deadline, "no twin has started"
        time.sleep(0.001)
    process.send_signal(signal.SIGINT)
    done = cli.finish(process)
    assert done.returncode == 1
    assert "stopped by SIGINT" in done.stderr
    assert {path.name for path in cli.directory.iterdir()} == before


def test_a_limit_that_trips_ends_the_run(cli: Cli) -> None:
    (cli.directory / "rig.toml").write_text(RIG.replace("-0.3, max = 0.3", "-0.03, max = 0.03"))
    done = cli.run(experiment(duration=100.0))
    assert done.returncode == 1
    assert "bench: ball_position" in done.stderr
    assert "left its limits, -0.03 to 0.03" in done.stderr
    recording = read_recording(cli.directory / last_line(done))
    assert "tripped" in kinds(recording, "bench")


@pytest.mark.extended
def test_a_port_that_is_not_there_is_bad_input(cli: Cli) -> None:
    done = cli.run(experiment(address="/dev/ttyNOT_THERE"))
    assert done.returncode == 2
    assert "bench: /dev/ttyNOT_THERE" in done.stderr
    assert done.stdout == ""
    assert cli.recordings() == []


@pytest.mark.parametrize(
    ("fault", "message"),
    [("fault_reset_at", "booted again in the middle of the run"), ("fault_silence_at", "said nothing for")],
)
@pytest.mark.extended
def test_a_device_that_fails_in_the_middle_keeps_what_was_recorded(
    cli: Cli, fault: str, message: str
) -> None:
    done = cli.run(experiment(duration=100.0, twin=f", set = {{ {fault} = 4.0 }}"))
    assert done.returncode == 2
    assert message in done.stderr
    recording = read_recording(cli.directory / last_line(done))
    assert recording.complete
    assert len(recording.stream_with("ball_position")) >= 400
    assert kinds(recording, "bench")[-1] == kinds(recording, "run")[-1] == "failed"


@pytest.mark.extended
def test_garbage_in_the_middle_is_counted_and_survived(cli: Cli) -> None:
    done = cli.run(experiment(duration=4.0, twin=", set = { fault_garbage_at = 2.0 }"))
    assert done.returncode == 0, done.stderr
    recording = read_recording(cli.directory / last_line(done))
    assert len(recording.stream_with("ball_position")) >= 399


@contextmanager
def garbage_server() -> Iterator[str]:
    """A port where somebody talks, but not our protocol."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        over = threading.Event()

        def talk() -> None:
            connection, _ = server.accept()
            with connection:
                while not over.wait(0.02):
                    try:
                        connection.sendall(b"NMEA? $GPGGA,123519,4807.038,N\r\n\x00" * 4)
                    except OSError:
                        return

        thread = threading.Thread(target=talk)
        thread.start()
        yield f"socket://127.0.0.1:{server.getsockname()[1]}"
        over.set()
        thread.join()


@pytest.mark.extended
def test_garbage_on_the_line_is_bad_input(cli: Cli) -> None:
    with garbage_server() as address:
        done = cli.run(experiment(address=address))
    assert done.returncode == 2
    assert f"bench: {address}" in done.stderr
    assert "expected frames" in done.stderr
    assert cli.recordings() == []


@pytest.mark.extended
def test_a_host_that_is_killed_ends_the_run(cli: Cli) -> None:
    process = cli.start(experiment(duration=100.0))
    cli.wait_until_it_records()
    cli.host(process).kill()
    done = cli.finish(process)
    assert done.returncode == 1
    assert "the host of 'bench' died (SIGKILL)" in done.stderr
    assert read_recording(cli.directory / last_line(done)).complete


@pytest.mark.extended
def test_a_run_that_is_killed_takes_everything_with_it(cli: Cli) -> None:
    process = cli.start(experiment(duration=100.0))
    cli.wait_until_it_records()
    process.kill()
    process.communicate()
    cli.wait_for_silence()
    (part,) = cli.recordings()
    assert part.name.endswith(".mcap.part")
    recording = read_recording(part)
    assert not recording.complete
    assert len(recording.stream_with("ball_position")) > 100


def test_a_dry_run_touches_nothing(cli: Cli) -> None:
    done = cli.run(experiment(address="/dev/ttyNOT_THERE"), "--dry-run")
    assert done.returncode == 0
    assert "/dev/ttyNOT_THERE" in done.stdout
    assert cli.recordings() == []


def test_an_experiment_file_that_is_wrong_is_told(cli: Cli) -> None:
    done = cli.run(experiment().replace("amplitude", "amplitud"), "--dry-run")
    assert done.returncode == 2
    assert "experiment.toml: steps.0.amplitud: unknown key (did you mean 'amplitude'?)" in done.stderr


def two_devices(second: str = "") -> str:
    return experiment(
        duration=4.0,
        more=f"""
[devices.other]
plugin = "ball_beam"
address = "twin"
twin = {{ speed = 5.0, seed = 4, terms = []{second} }}
[[steps]]
device = "other"
signal = "servo_angle"
excitation = "steps"
levels = [0.1, -0.1]
dwell = 0.5
at = 0.0
duration = 3.0
""",
    ).replace("duration = 4.0", "at = 0.0\nduration = 4.0")


def run_here(directory: Path, text: str, progress: Callable[[Progress], None] = lambda _: None) -> Any:
    (directory / "rig.toml").write_text(RIG)
    return run_experiment(parse_experiment(text, directory / "experiment.toml"), directory, progress)


@pytest.mark.extended
def test_two_devices_run_together_into_one_recording(tmp_path: Path) -> None:
    seen: list[Progress] = []
    result = run_here(tmp_path, two_devices(), seen.append)
    assert result.exit_status == 0, result.reason
    assert {(stream.device, stream.stream) for stream in result.streams} == {
        (device, stream) for device in ("bench", "other") for stream in ("state", "command")
    }
    recording = read_recording(result.path)
    assert set(recording.attachments) == {"rig.toml", "rig.other.toml", "experiment.toml"}
    assert len(list(tmp_path.glob("*.twin.json"))) == 2
    # a world that has paused on a busy machine has no steady clock
    steady = {data.device for data in recording.streams if data.clock.offset_error is not None}
    assert set(recording.clocks) == steady & {"bench", "other"}
    assert all(0.0 < offset.error < 0.1 for offset in recording.clock_offsets.values())
    with pytest.raises(RecordingError, match="found bench, other; choose one with --device"):
        record_of(recording, kind_named("ball_beam"))
    other = recording.of_device("other")
    assert other.rig is not None and other.rig.known == {}
    assert len(record_of(other, kind_named("ball_beam"))) == len(other.stream_with("ball_position"))
    with pytest.raises(RecordingError, match="did you mean 'bench'"):
        recording.of_device("bnch")
    assert [progress.state.value for progress in seen][:2] == ["starting", "running"]
    assert seen[-1].state.value == "finished"
    assert any(0.0 < progress.elapsed < progress.duration == 4.0 for progress in seen)


@pytest.mark.extended
def test_one_failing_device_does_not_keep_the_other_from_stopping(tmp_path: Path) -> None:
    result = run_here(tmp_path, two_devices(", set = { fault_reset_at = 1.0 }"))
    assert result.exit_status == 2
    assert "other:" in result.reason
    recording = read_recording(result.path)
    assert kinds(recording, "bench")[-2:] == ["safe", "stopped"]
    assert kinds(recording, "other")[-1] == "failed"
