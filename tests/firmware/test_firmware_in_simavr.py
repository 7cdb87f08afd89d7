"""The firmware itself, on a simulated Arduino Mega with a plant around it, through the real drivers."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from patient_labhil import COMMAND as PATIENT_LABHIL

from labhil.errors import ConnectError, DeviceResetError
from labhil.signals import Batch
from labhil.testing import DriverContract
from labhil_ball_beam import BallBeamDriver
from labhil_dc_motor import DcMotorDriver
from labhil_solenoid import SolenoidDriver

pytestmark = pytest.mark.extended

DRIVERS = {"ball_beam": BallBeamDriver, "solenoid": SolenoidDriver, "dc_motor": DcMotorDriver}
AWAY = {
    "ball_beam": {"servo_angle": 0.3},
    "solenoid": {"coil_current_command": 1.0},
    "dc_motor": {"voltage": -4.0},
}
TIMEOUT = 0.3
WATCHDOG_TIMER = 0.06
SLACK = 0.03
"""A sample period, a servo pulse, and the turns of the simulator between two bytes, s."""


@pytest.fixture(scope="class")
def board_of_class(simulated_board, request):
    with simulated_board(request.cls.driver.spec.name) as board:
        yield board.address


class OnTheBoard(DriverContract):
    @pytest.fixture
    def driver_address(self, board_of_class):
        return board_of_class


class TestBallBeam(OnTheBoard):
    driver = BallBeamDriver
    excursion = AWAY["ball_beam"]


class TestSolenoid(OnTheBoard):
    driver = SolenoidDriver
    excursion = AWAY["solenoid"]


class TestDcMotor(OnTheBoard):
    driver = DcMotorDriver
    excursion = AWAY["dc_motor"]


@pytest.fixture(params=list(DRIVERS))
def rig(request):
    return request.param


@pytest.fixture
def board(simulated_board, rig):
    with simulated_board(rig) as board:
        yield board


@pytest.fixture
def driver(board, rig):
    with DRIVERS[rig](board.address) as driver:
        driver.connect()
        yield driver


def drive(driver, values, seconds: float) -> Batch:
    """Command these values for some seconds of the device's clock; gives the samples."""
    batches = []
    deadline = time.monotonic() + 10.0 * seconds + 10.0
    while True:
        assert time.monotonic() < deadline, "the device fell silent"
        driver.command(values)
        batches.append(driver.read(0.05))
        ends = [t for batch in (batches[0], batches[-1]) for t in (*batch.t_hw_ns[:1], *batch.t_hw_ns[-1:])]
        if ends and ends[-1] - ends[0] >= seconds * 1e9:
            return Batch.joined(batches, driver.spec.stream.width)


def read_on(driver, seconds: float) -> None:
    """Read without a word for some seconds."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        driver.read(0.05)


def test_the_pins_are_safe_soon_after_the_last_word(board, driver, rig):
    drive(driver, AWAY[rig], 0.3)
    assert board.report()["safe_since"] == 0
    read_on(driver, 2.0)
    assert TIMEOUT - SLACK < board.silence_before_safety() < TIMEOUT + SLACK


def test_the_pins_are_safe_at_once_when_told(board, driver, rig):
    drive(driver, AWAY[rig], 0.3)
    driver.safe()
    read_on(driver, 0.5)
    assert board.silence_before_safety() < SLACK


def test_a_cable_pulled_out_is_a_wire_that_is_gone(board, driver, rig):
    drive(driver, AWAY[rig], 0.2)
    board.process.send_signal(signal.SIGKILL)
    with pytest.raises(ConnectError, match=board.address):
        while True:
            driver.read(0.2)


def test_a_host_that_dies_leaves_safe_pins(board, driver, rig):
    drive(driver, AWAY[rig], 0.2)
    driver._port.close()  # the descriptor goes, nothing is said
    time.sleep(1.0)
    assert TIMEOUT - SLACK < board.silence_before_safety() < TIMEOUT + SLACK


def test_a_reset_in_the_middle_is_another_boot(board, driver, rig):
    boot = driver._hello.boot_id
    drive(driver, AWAY[rig], 0.2)
    board.tell("reset")
    with pytest.raises(DeviceResetError):
        drive(driver, AWAY[rig], 5.0)
    assert driver.connect().boot_id > boot


def test_a_loop_that_hangs_is_reset_to_safety(board, driver, rig):
    drive(driver, AWAY[rig], 0.3)
    began = int(board.tell(f"hang {board.symbol('session_watch')}"))
    with pytest.raises(DeviceResetError):
        drive(driver, AWAY[rig], 5.0)
    report = board.report()
    assert report["watchdog_resets"] == 1
    assert report["safe_since"] - began < (WATCHDOG_TIMER + 2 * SLACK) * 16e6
    driver.connect()
    drive(driver, AWAY[rig], 0.3)
    assert board.report()["safe_since"] == 0


def test_a_bench_that_no_longer_samples_is_reset_to_safety(board, driver, rig):
    drive(driver, AWAY[rig], 0.3)
    board.tell("deafen")
    with pytest.raises(DeviceResetError):
        drive(driver, AWAY[rig], 5.0)
    assert board.report()["watchdog_resets"] == 1


def test_nothing_is_lost_in_quiet_times(board, driver, rig):
    # a host that stalls while it connects asks several times at once, for more than the line can hold
    before = board.line_losses()
    batch = drive(driver, AWAY[rig], 4.0)
    assert np.all(np.diff(batch.seq) == 1)
    period = 1e9 / driver.spec.stream.rate
    assert np.all(np.abs(np.diff(batch.t_hw_ns) - period) < 0.1 * period)
    counters = driver.counters
    assert (counters.lost, counters.crc_errors, counters.resyncs) == (0, 0, 0)
    assert board.line_losses() == before


def test_noise_on_the_line_costs_nothing_but_itself(board, driver, rig):
    random = np.random.default_rng(3)
    for _ in range(20):
        driver._port.send(random.bytes(200))
        drive(driver, AWAY[rig], 0.05)
    assert driver.counters.lost == 0
    assert board.report()["safe_since"] == 0


@pytest.fixture
def ball_beam(simulated_board):
    with simulated_board("ball_beam") as board, BallBeamDriver(board.address) as driver:
        driver.connect()
        yield board, driver


def test_the_servo_goes_straight_from_sample_to_sample(ball_beam):
    board, driver = ball_beam
    drive(driver, {"servo_angle": 0.0}, 0.2)
    batch = drive(driver, {"servo_angle": np.pi / 10}, 0.2)
    pulses = board.report()["pulses_us"]
    last = max(k for k, pulse in enumerate(pulses) if abs(pulse - 1500.0) < 0.1)
    # 100 µs within one sample period, two pulses in it
    assert pulses[last + 1 : last + 4] == pytest.approx([1550.0, 1600.0, 1600.0], abs=0.6)
    angles = batch.values[:, 1]
    assert set(np.round(angles, 3)) <= {0.0, 0.314}


def test_a_ball_is_balanced_through_wire_and_pins(ball_beam):
    board, driver = ball_beam
    before, angle = None, 0.0
    deadline = time.monotonic() + 15.0
    seen = []
    while time.monotonic() < deadline:
        driver.command({"servo_angle": float(np.clip(angle, -1.0, 1.0))})
        for position, _ in driver.read(0.1).values:
            speed = 0.0 if before is None else (position - before) * 100.0
            before = position if before is None else before + 0.3 * (position - before)
            angle = -4.0 * position - 1.0 * speed
            seen.append(position)
    assert len(seen) > 500
    assert np.max(np.abs(seen[-100:])) < 0.02
    assert abs(board.report()["value"]) < 0.02


RUN = """
[experiment]
name = "on-the-board"
[devices.bench]
plugin = "ball_beam"
address = "{address}"
rig = "bench.toml"
[[steps]]
device = "bench"
signal = "servo_angle"
excitation = "two_sine"
frequencies = [0.28, 0.39]
amplitude = 0.3
stabilise = {{ on = "ball_position", kp = 7.0, kd = 3.0 }}
duration = 6.0
"""
RIG = """
[rig]
kind = "ball_beam"
[limits]
servo_angle = { min = -1.2, max = 1.2, rate = 12.0 }
"""


def test_a_run_records_it(simulated_board, tmp_path):
    (tmp_path / "bench.toml").write_text(RIG, encoding="utf-8")
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path))
    with simulated_board("ball_beam") as board:
        (tmp_path / "run.toml").write_text(RUN.format(address=board.address), encoding="utf-8")
        done = subprocess.run(
            [*PATIENT_LABHIL, "run", "run.toml", "--json"],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert board.report()["safe_since"]
    result = json.loads(done.stdout)
    assert result["exit_status"] == 0
    state = next(stream for stream in result["streams"] if stream["stream"] == "state")
    assert state["gaps"] == 0
    assert state["samples"] >= 550


def test_the_coil_current_comes_to_the_command(simulated_board):
    with simulated_board("solenoid") as board, SolenoidDriver(board.address) as driver:
        driver.connect()
        drive(driver, {"coil_current_command": 0.5}, 0.2)
        batch = drive(driver, {"coil_current_command": 1.5}, 0.2)
        current, _, voltage, command = batch.values.T
        start = int(np.argmax(command > 1.4))
        error = current[start:] - 1.5
        # 12 V on 20 mH and 4 Ω give 1 A in 2.7 ms; then an exponential of 1 ms
        assert np.max(np.abs(error[15:])) < 0.02
        assert np.max(error) < 0.05
        assert np.mean(voltage[-50:]) == pytest.approx(6.0, abs=0.05)
        assert board.report()["value"] == pytest.approx(1.5, abs=0.01)
        # what the loop had gathered is forgotten when the coil is switched off
        drive(driver, {"coil_current_command": 0.0}, 0.1)
        again = drive(driver, {"coil_current_command": 0.3}, 0.1)
        assert np.max(again.values[:, 0]) < 0.35


def test_the_motor_turns_and_is_counted(simulated_board):
    with simulated_board("dc_motor") as board, DcMotorDriver(board.address) as driver:
        driver.connect()
        drive(driver, {"voltage": -6.0}, 0.5)
        batch = drive(driver, {"voltage": -6.0}, 1.0)
        speed, _, angle, voltage = batch.values.T
        assert voltage == pytest.approx(-6.0, abs=0.01)
        true = board.report()["value"]
        assert np.mean(speed) == pytest.approx(true, rel=0.01)
        turned = angle[-1] - angle[0]
        assert turned == pytest.approx(true * (batch.t_hw_ns[-1] - batch.t_hw_ns[0]) * 1e-9, rel=0.01)
