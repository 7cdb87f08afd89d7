"""The twin of a UR5 against the unmodified client, each time in a process of its own."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from labhil.driver import TwinOptions
from labhil.errors import UsageError
from labhil.service.child import Child
from labhil_sim_ur5.codec import Command
from labhil_sim_ur5.settings import TwinSettings

sys.path.insert(0, str(Path(__file__).parent))
from ur5_process import RawClient, address, call, running_twin

SHORT = ("receive_every_getter", "move_joints", "kinematics", "io_outputs", "speed_joints")
FAST_UNLOCK = ("--set", "unlock_after=0.3")
needs_client = pytest.mark.skipif(
    importlib.util.find_spec("rtde_control") is None, reason="ur-rtde is not installed (pip install ur-rtde)"
)


@pytest.fixture(scope="module")
def twin() -> Iterator[tuple[str, Child]]:
    host = address(1)
    with running_twin(host, "--series", "cb3", *FAST_UNLOCK) as process:
        yield host, process


@needs_client
@pytest.mark.extended
def test_the_client_reads_moves_and_switches(twin: tuple[str, Child]) -> None:
    call(twin[0], *SHORT)


def test_inputs_belong_to_one_client_until_it_goes(twin: tuple[str, Child]) -> None:
    wanted = b"input_int_register_0,input_double_register_0"
    with RawClient(twin[0]) as first:
        assert first.ask(Command.INPUTS, wanted) == b"\x01INT32,DOUBLE"
        assert first.ask(Command.INPUTS, wanted) == b"\x02INT32,DOUBLE"
        with RawClient(twin[0]) as second:
            assert second.ask(Command.INPUTS, wanted) == b"\x00IN_USE,IN_USE"
            assert second.ask(Command.INPUTS, b"no_such_input") == b"\x00NOT_FOUND"
    deadline = time.monotonic() + 60.0
    answer = b""
    while answer != b"\x01INT32,DOUBLE" and time.monotonic() < deadline:
        with RawClient(twin[0]) as third:
            answer = third.ask(Command.INPUTS, wanted)
    assert answer == b"\x01INT32,DOUBLE"


def test_what_makes_no_sense_is_answered_or_cut_off(twin: tuple[str, Child]) -> None:
    with RawClient(twin[0]) as client:
        assert client.ask(Command.PROTOCOL_VERSION, b"\x00\x01") == b"\x00"
        assert client.ask(Command.PROTOCOL_VERSION, b"\x00\x02") == b"\x01"
        assert client.ask(Command.START) == b"\x00", "started without anything to send"
        assert client.ask(Command.OUTPUTS, bytes(8) + b"actual_q,nonsense") == b"\x00VECTOR6D,NOT_FOUND"
        client.send(b"\x00\x05\x01ab")
        assert client.next()[0] == Command.TEXT
        client.send(b"\x00\x02U")
        with pytest.raises(ConnectionError):
            client.next()


@pytest.mark.extended
def test_a_second_twin_at_the_same_address_says_what_to_do(twin: tuple[str, Child]) -> None:
    command = [sys.executable, "-m", "labhil", "twin", "ur5", "--host", twin[0]]
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
    assert done.returncode == 2
    assert "--host" in done.stderr


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"series": "5.3.1"}, "5.4.0"),
        ({"parameters": {"fault.drop_att": 1.0}}, "fault.drop_at"),
        ({"parameters": {"home[3]": 9.0}}, "home must lie"),
        ({"parameters": {"fault.stall_at": -1.0}}, "fault.stall_at"),
        ({"speed": 2.0}, "real time"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        TwinSettings.of(TwinOptions(**options))


def test_the_import_brings_nothing_else() -> None:
    code = (
        "import sys\nfrom labhil_sim_ur5 import TWIN, running_twin\n"
        "print(*(n for n in ('zenoh', 'mcap', 'numba', 'mujoco', 'scipy', 'numpy', 'rtde_control') "
        "if n in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() in ("", "numpy")


@pytest.mark.timeout(600)
@needs_client
@pytest.mark.parametrize(
    "series",
    [
        pytest.param("cb3", marks=pytest.mark.extended),
        # two cores do not keep the time of 500 Hz beside a client and other tests
        *(pytest.param(v, marks=pytest.mark.by_hand) for v in ("5.4.0", "5.9.0", "e", "5.23.0", "5.26.0")),
    ],
)
def test_every_call_of_the_client(series: str) -> None:
    host = address(2)
    with running_twin(host, "--series", series, *FAST_UNLOCK):
        call(host, timeout=400.0)


@pytest.mark.extended
@pytest.mark.timeout(300)
@needs_client
def test_two_twins_at_once() -> None:
    first, second = address(3), address(4)
    with (
        running_twin(first, "--series", "cb3"),
        running_twin(second, "--series", "cb3", "--set", "home[0]=1.0"),
    ):
        call(first, "move_joints", "speed_joints")
        call(second, "move_joints", "speed_joints")
        with RawClient(first) as one, RawClient(second) as other:
            one.stream(["actual_q"], 125.0)
            other.stream(["actual_q"], 125.0)
            assert np.allclose(one.doubles(), other.doubles(), atol=0.3)


@pytest.mark.extended
@pytest.mark.timeout(200)
def test_faults_by_the_clock() -> None:
    host = address(5)
    faults = ("--set", "fault.protective_stop_at=0.3", "--set", "fault.drop_at=1.0", *FAST_UNLOCK)
    with running_twin(host, "--series", "cb3", *faults), RawClient(host) as client:
        client.stream(["timestamp", "speed_scaling"], 125.0)
        seen = []
        with pytest.raises(ConnectionError):
            while True:
                seen.append(client.doubles())
        assert seen[0][1] == 1.0
        assert seen[-1][1] == 0.0, "the protective stop held the arm"
        with RawClient(host) as again:
            again.stream(["timestamp"], 125.0)
            assert again.doubles()[0] > seen[-1][0], "the port stays open and the clock goes on"


@pytest.mark.extended
@pytest.mark.timeout(200)
def test_faults_by_a_line() -> None:
    host = address(6)
    with running_twin(host, "--series", "cb3") as twin:
        with RawClient(host) as client:
            client.stream(["timestamp", "standard_analog_input1"], 125.0)
            before = client.doubles()[0]
            begun = time.monotonic()
            twin.send("stall 0.8\n")
            twin.send("analog_in 1 3.5\n")
            while client.doubles()[1] != 3.5:
                pass
            assert time.monotonic() - begun > 0.7
            assert client.doubles()[0] > before
            twin.send("nonsense\nstall much\ntruncate\n")
            with pytest.raises(ConnectionError):
                while True:
                    client.doubles()
        deadline = time.monotonic() + 60.0
        while "done: truncate" not in twin.last_error() and time.monotonic() < deadline:
            time.sleep(0.05)
        assert "done: truncate" in twin.last_error()


@pytest.mark.extended
@pytest.mark.timeout(200)
@needs_client
@pytest.mark.parametrize("line", ["emergency stop", "end program"])
def test_a_stop_from_outside_reaches_the_client(line: str) -> None:
    host = address(7)
    code = (
        "import sys, time, rtde_control\n"
        f"c = rtde_control.RTDEControlInterface({host!r})\n"
        "print('ready', flush=True)\n"
        "print(c.moveJ([3.0, -1.5, 1.5, -1.5, -1.5, 0], 0.3, 1.0), flush=True)\n"
        "c.disconnect()\n"
    )
    with (
        running_twin(host, "--series", "cb3") as twin,
        Child("the client", [sys.executable, "-c", code]) as client,
    ):
        assert client.line(30.0) == "ready"
        time.sleep(0.5)
        twin.send(f"{line}\n")
        assert client.line(20.0) == "False"


@pytest.mark.extended
@pytest.mark.timeout(200)
def test_a_client_that_does_not_read_holds_nobody_up() -> None:
    host = address(8)
    with running_twin(host, "--series", "cb3") as twin, RawClient(host) as lazy, RawClient(host) as eager:
        lazy.stream(["actual_q"] * 100, 125.0)
        eager.stream(["timestamp"], 125.0)
        begun, first = time.monotonic(), eager.doubles()[0]
        while time.monotonic() - begun < 4.0:
            last = eager.doubles()[0]
        assert last - first > 2.0
        psutil.Process(twin.pid).memory_info()
        # what the lazy client finds is whole packages, the newest of them missing
        assert len(lazy.doubles()) == 600
