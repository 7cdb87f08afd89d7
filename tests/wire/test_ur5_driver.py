"""The UR5's driver against its twin: the contract, what it does when its client dies, what it refuses."""

import contextlib
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

from labhil.errors import CommandRefusedError, ConnectError, MissingExtraError, ProtocolError
from labhil.testing import DriverContract
from labhil_ur5 import Ur5Cb3Driver, Ur5Driver
from labhil_ur5.fault import fault_of
from labhil_ur5.motion import MotionState
from labhil_ur5.rtde import PackageParser

PROGRAM = """
import sys
from labhil.driver import TwinOptions
from labhil_sim_ur5 import TWIN
TWIN.serve(TwinOptions(host=sys.argv[1], seed=1), lambda address: print(address, flush=True))
"""
PORTS = (30004, 30003, 29999)
PATIENCE = 90.0
STILL = 1e-3


def free_host() -> str:
    """An address of the loopback network at which no controller is."""
    for number in range(256):
        host = f"127.{os.getpid() // 256 % 256}.{os.getpid() % 256}.{1 + number % 250}"
        with contextlib.ExitStack() as sockets:
            try:
                for port in PORTS:
                    sockets.enter_context(socket.socket()).bind((host, port))
            except OSError:
                continue
            return host
    raise AssertionError("no address is free")


@contextlib.contextmanager
def ur5_twin() -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Start the twin; gives its address and its process, and stops it in the end."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, free_host()],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path)),
    )
    assert process.stdin is not None and process.stdout is not None
    try:
        address = process.stdout.readline().strip()
        assert address, "the twin did not start"
        yield address, process
    finally:
        process.stdin.close()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


@pytest.fixture(scope="module")
def twin():
    with ur5_twin() as (address, _):
        yield address


@pytest.mark.extended
class TestUr5(DriverContract):
    driver = Ur5Driver
    excursion = {"target_q_0": 0.05}  # noqa: RUF012
    absent_address = "127.255.255.253"
    patience = PATIENCE
    tolerance = 1e-3

    @pytest.fixture
    def driver_address(self, twin):
        return twin

    def is_safe(self, driver, values):
        return bool(np.all(np.abs(values[driver.spec.stream.columns_of("target_qd")]) < STILL))


def latest(driver, name):
    columns = driver.spec.stream.columns_of(name)
    deadline = time.monotonic() + PATIENCE
    while not len(batch := driver.read(0.2)):
        assert time.monotonic() < deadline
    return batch.values[-1, columns]


def until(driver, reached, command=None):
    deadline = time.monotonic() + PATIENCE
    while not reached():
        assert time.monotonic() < deadline, driver.fault()
        if command is not None:
            driver.command(command)
        driver.read(0.01)


@pytest.mark.extended
def test_without_the_client_library_it_listens_and_says_what_moves_it(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "rtde_control", None)
    with ur5_twin() as (address, _), Ur5Driver(address) as driver:
        driver.connect()
        q = latest(driver, "target_q")
        with pytest.raises(
            MissingExtraError, match=r"commanding a UR arm needs .*'labhil\[ur5\]'.*Python up to 3\.12"
        ):
            until(driver, lambda: False, {"target_q_3": q[3] - 1})
        assert np.all(np.isfinite(latest(driver, "actual_q")))


@pytest.mark.extended
def test_it_listens_moves_and_stops(twin) -> None:
    """The short way through: what stands in `extended` in full."""
    with Ur5Driver(twin) as driver:
        info = driver.connect()
        assert info.firmware.startswith("5.")
        first = driver.read(0.5)
        assert np.all(np.isfinite(first.values[:, driver.spec.stream.columns_of("actual_q")]))
        begin = latest(driver, "target_q")
        until(
            driver, lambda: abs(latest(driver, "target_q")[3] - begin[3]) > 0.01, {"target_q_3": begin[3] - 1}
        )
        driver.safe()
        until(driver, lambda: bool(np.all(np.abs(latest(driver, "target_qd")) < STILL)))
        assert abs(latest(driver, "target_q")[3] - begin[3]) < 0.6
        with pytest.raises(CommandRefusedError, match="target_q_6"):
            driver.command({"target_q_6": 0.0})


@pytest.mark.extended
def test_a_client_that_dies_is_replaced_while_samples_go_on(twin) -> None:
    with Ur5Driver(twin) as driver:
        driver.connect()
        until(driver, lambda: driver._motion.state is MotionState.IDLE, {"standard_digital_outputs": 5.0})
        q = latest(driver, "target_q")
        until(driver, lambda: driver._motion.state is MotionState.MOVING, {"target_q_0": q[0] + 0.5})
        os.kill(driver._motion.pid, signal.SIGKILL)
        before = driver.read(0.5).seq[-1]
        until(driver, lambda: "client was lost" in driver.fault())
        # the arm is stopped by the controller's watchdog, or by the dashboard
        until(driver, lambda: bool(np.all(np.abs(latest(driver, "target_qd")) < STILL)))
        assert abs(latest(driver, "target_q")[0] - q[0]) < 0.4
        until(driver, lambda: driver.fault() == "")
        assert driver.read(0.5).seq[-1] > before + 100
        assert driver.counters.resets == 1
        assert driver._motion.starts == 2
        until(driver, lambda: latest(driver, "target_q")[0] > q[0] + 0.09, {"target_q_0": q[0] + 0.1})


@pytest.mark.extended
def test_a_client_that_hangs_is_replaced(twin) -> None:
    with Ur5Driver(twin) as driver:
        driver.connect()
        q = latest(driver, "target_q")
        until(driver, lambda: driver._motion.state is MotionState.IDLE, {"target_q_0": q[0]})
        os.kill(driver._motion.pid, signal.SIGSTOP)
        until(driver, lambda: "said nothing" in driver.fault())
        until(driver, lambda: driver.fault() == "")
        assert driver._motion.starts == 2


@pytest.mark.extended
def test_a_path_is_followed_and_ends_on_it(twin) -> None:
    with Ur5Driver(twin) as driver:
        driver.connect()
        begin = latest(driver, "target_q")
        until(driver, lambda: driver._motion.state is MotionState.IDLE, {"target_q_0": begin[0]})
        start_ns, at_ns, seen = None, 0, []
        while start_ns is None or at_ns < start_ns + 4e9:
            batch = driver.read(0.1)
            if not len(batch):
                continue
            seen.append(batch)
            at_ns = int(batch.t_hw_ns[-1])
            start_ns = start_ns or at_ns
            angle = begin[0] + 0.2 * np.sin(np.pi * (at_ns - start_ns) * 1e-9 / 2) ** 2
            driver.command_at({"target_q_0": float(angle)}, at_ns)
        driver.safe()
        columns = driver.spec.stream.columns_of("target_q").start
        moved = np.concatenate([batch.values[:, columns] for batch in seen]) - begin[0]
        assert moved.max() == pytest.approx(0.2, abs=0.02)
        assert moved.min() > -0.01


def test_somebody_else_and_nobody_at_the_address() -> None:
    with pytest.raises(ConnectError, match=r"127\.255\.255\.253"):
        Ur5Driver("127.255.255.253").connect()


@pytest.mark.extended
def test_the_other_series_is_told_which_plugin_it_needs(twin) -> None:
    with pytest.raises(ProtocolError, match="plugin 'ur5'"):
        Ur5Cb3Driver(twin).connect()


def test_packages_are_cut_wherever_the_bytes_are_split() -> None:
    stream = b"".join(struct.pack(">HB", 3 + len(body), ord("U")) + body for body in (b"", b"a", b"bc" * 300))
    for size in (1, 2, 7, 1000):
        packages = PackageParser("somewhere")
        found = [
            body
            for start in range(0, len(stream), size)
            for _, body in packages.feed(stream[start : start + size])
        ]
        assert found == [b"", b"a", b"bc" * 300]
    with pytest.raises(ProtocolError, match="is this a UR"):
        list(PackageParser("somewhere").feed(b"\0\1V"))


def test_what_stops_an_arm_is_named() -> None:
    assert fault_of({"safety_mode": 1.0, "robot_mode": 7.0}, commanded=True) == ""
    assert "protective stop" in fault_of({"safety_mode": 3.0, "robot_mode": 7.0}, commanded=True)
    assert "emergency stop" in fault_of({"safety_mode": 7.0, "robot_mode": 3.0}, commanded=False)
    assert "powered off" in fault_of({"safety_mode": 1.0, "robot_mode": 3.0}, commanded=True)
    assert fault_of({"safety_mode": 1.0, "robot_mode": 3.0}, commanded=False) == ""
