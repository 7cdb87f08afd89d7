"""What stands at the other end of the wire is not the bench, or stops being it: whole runs, in words.

More of this kind: a port that is not there, text on the line, a reset, a silence and garbage in the
middle are in ``tests/run/test_run.py``; the driver alone in ``tests/wire/test_ball_beam_driver.py``;
tables, MAT files and rig files in ``tests/recording/test_tables.py``; empty, cut and damaged recordings
in ``tests/recording/test_recording.py``.
"""

from __future__ import annotations

import os
import random
import re
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL

from labhil.recording import read_recording

PATIENCE = 180.0
LABHIL = (sys.executable, "-P", "-m", "labhil")

RIG = """
[rig]
kind = "ball_beam"
[limits]
servo_angle = { min = -1.2, max = 1.2, rate = 12.0 }
ball_position = { min = -0.3, max = 0.3 } # beyond the stops: a ball that a busy machine drops ends no run
"""
EXPERIMENT = """
[experiment]
name = "matrix"
[devices.bench]
plugin = "ball_beam"
address = "ADDRESS"
rig = "rig.toml"
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "two_sine"
frequencies = [0.23, 0.31]
amplitude = 0.6
stabilise = { on = "ball_position", kp = 7.0, kd = 3.0 }
duration = 100.0
"""


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    """Return what starts ``labhil run`` with the bench at an address."""
    processes: list[subprocess.Popen[str]] = []

    def run(address: str) -> subprocess.Popen[str]:
        (tmp_path / "rig.toml").write_text(RIG)
        (tmp_path / "experiment.toml").write_text(EXPERIMENT.replace("ADDRESS", address))
        processes.append(
            subprocess.Popen(
                [*PATIENT_LABHIL, "run", "experiment.toml"],
                cwd=tmp_path,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        return processes[-1]

    yield run
    for process in processes:
        with process:
            process.kill()


def told(process: subprocess.Popen[str], status: int) -> tuple[str, str]:
    """Return what a run said, in its results and in its complaint, which is no traceback."""
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == status, err
    assert "Traceback" not in err
    return out, err


def refused(process: subprocess.Popen[str], directory: Path) -> str:
    """Return the complaint of a run that had nothing to record, and left nothing behind."""
    out, err = told(process, 2)
    assert out == ""
    assert sorted(path.name for path in directory.iterdir()) == ["experiment.toml", "rig.toml"]
    return err


@contextmanager
def pseudo_terminal(say: Callable[[], bytes]) -> Iterator[str]:
    """A serial line on which somebody says ``say()`` again and again, whatever is sent to him."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    over = threading.Event()

    def talk() -> None:
        while not over.wait(0.01):
            with suppress(BlockingIOError):
                os.write(ours, say())
            with suppress(BlockingIOError):
                os.read(ours, 4096)

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        over.set()
        thread.join()
        os.close(theirs)
        os.close(ours)


@pytest.mark.extended
def test_noise_on_a_serial_line(start: Callable[[str], subprocess.Popen[str]], tmp_path: Path) -> None:
    noise = random.Random(1)
    with pseudo_terminal(lambda: noise.randbytes(40)) as address:
        complaint = refused(start(address), tmp_path)
    assert f"bench: {address}: expected frames" in complaint
    assert re.search(r"found \d+ or more bytes without one: ([0-9a-f]{2} ){16}", complaint)


@pytest.mark.extended
def test_a_serial_line_without_a_word(start: Callable[[str], subprocess.Popen[str]], tmp_path: Path) -> None:
    with pseudo_terminal(lambda: b"") as address:
        complaint = refused(start(address), tmp_path)
    assert f"bench: {address}: the port is open, but nothing came from it within 4 s" in complaint


@contextmanager
def web_server() -> Iterator[str]:
    """A port that takes what it hears for a request, complains in HTTP and hangs up."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)
        over = threading.Event()

        def answer() -> None:
            while not over.is_set():
                with suppress(TimeoutError, ConnectionError):
                    connection, _ = server.accept()
                    with connection:
                        connection.recv(4096)
                        connection.sendall(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")
                        connection.shutdown(socket.SHUT_WR)
                        while connection.recv(4096):
                            continue

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            yield f"socket://127.0.0.1:{server.getsockname()[1]}"
        finally:
            over.set()
            thread.join()


@pytest.mark.extended
def test_a_port_that_talks_http(start: Callable[[str], subprocess.Popen[str]], tmp_path: Path) -> None:
    with web_server() as address:
        complaint = refused(start(address), tmp_path)
    assert f"bench: {address}: expected frames" in complaint
    # H  T  T  P  /  1  .  1
    assert "48 54 54 50 2f 31 2e 31" in complaint


@pytest.mark.extended
def test_a_port_where_nobody_listens(start: Callable[[str], subprocess.Popen[str]], tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"socket://127.0.0.1:{server.getsockname()[1]}"
    complaint = refused(start(address), tmp_path)
    assert f"bench: {address}: cannot be opened: connection refused" in complaint


@pytest.mark.extended
def test_a_cable_that_is_pulled(start: Callable[[str], subprocess.Popen[str]], tmp_path: Path) -> None:
    """The device dies in the middle: what it said until then is kept, under its final name."""
    command = [*LABHIL, "twin", "ball_beam", "--seed", "2", "--speed", "5", "--wire", "tcp"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as twin:
        assert twin.stdout is not None
        address = twin.stdout.readline().strip()
        process = start(address)
        wait_for_samples(tmp_path)
        twin.kill()
        out, complaint = told(process, 2)
    assert f"bench: {address}: the wire is gone" in complaint
    recording = read_recording(tmp_path / out.splitlines()[-1])
    assert recording.complete
    assert len(recording.stream_with("ball_position", "servo_angle")) > 100
    assert recording.metadata["end"]["exit_status"] == "2"


def wait_for_samples(directory: Path) -> None:
    deadline = time.monotonic() + PATIENCE
    while not any(path.stat().st_size > 20_000 for path in directory.glob("*.mcap.part")):
        assert time.monotonic() < deadline, "nothing was recorded"
        time.sleep(0.05)
