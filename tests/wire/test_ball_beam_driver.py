"""The ball-and-beam driver against its twin, and against things that are no ball and beam."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import tty
from pathlib import Path

import numpy as np
import pytest

from labhil.driver import Driver
from labhil.errors import CommandRefusedError, ConnectError, DeviceResetError, ProtocolError
from labhil.link import ChannelScale, Decoder, Frame, Hello, MessageType, encode
from labhil.serial_rig.port import Port
from labhil.signals import Batch
from labhil.testing import DriverContract
from labhil_ball_beam import BallBeamDriver

SPEED = 10.0
GOLDEN = json.loads((Path(__file__).parent / "golden_frames.json").read_text(encoding="utf-8"))
VERSION_2 = next(bytes.fromhex(v["hex"]) for v in GOLDEN["refused"] if v["name"] == "protocol version 2")


@pytest.fixture(scope="class")
def twin_on_pty(ball_beam_twin):
    with ball_beam_twin("pty", SPEED) as (address, _):
        yield address


@pytest.fixture(scope="class")
def twin_on_tcp(ball_beam_twin):
    with ball_beam_twin("tcp", SPEED) as (address, _):
        yield address


class TestOnPseudoTerminal(DriverContract):
    driver = BallBeamDriver
    excursion = {"servo_angle": 0.1}  # noqa: RUF012

    @pytest.fixture
    def driver_address(self, twin_on_pty):
        return twin_on_pty


class TestOnTcp(DriverContract):
    driver = BallBeamDriver
    excursion = {"servo_angle": -0.1}  # noqa: RUF012
    absent_address = "socket://127.0.0.1:9"

    @pytest.fixture
    def driver_address(self, twin_on_tcp):
        return twin_on_tcp


def collect(driver: BallBeamDriver, count: int, angle: float = 0.0) -> Batch:
    """At least ``count`` samples, the twin being commanded all the while."""
    batches = []
    while sum(len(batch) for batch in batches) < count:
        driver.command({"servo_angle": angle})
        batches.append(driver.read(1.0))
        assert len(batches[-1]), "the twin fell silent"
    return Batch(
        np.concatenate([batch.seq for batch in batches]),
        np.concatenate([batch.t_acq_ns for batch in batches]),
        np.concatenate([batch.t_hw_ns for batch in batches]),
        np.concatenate([batch.values for batch in batches]),
    )


def test_it_is_a_driver():
    assert isinstance(BallBeamDriver("nowhere"), Driver)


@pytest.mark.extended
def test_the_ball_rolls_the_way_the_beam_is_tilted(ball_beam_twin):
    with ball_beam_twin("pty", SPEED) as (address, _), BallBeamDriver(address) as driver:
        driver.connect()
        position, angle = collect(driver, 300, angle=0.5).values.T
    assert angle[-1] == pytest.approx(0.5, abs=np.pi / 2000)
    assert position[0] == pytest.approx(0.0, abs=0.003)
    assert position[-1] == pytest.approx(0.25, abs=0.003)


@pytest.mark.extended
def test_no_sample_is_lost_at_ten_times_the_speed(ball_beam_twin):
    with ball_beam_twin("pty", 10.0) as (address, _), BallBeamDriver(address) as driver:
        info = driver.connect()
        batch = collect(driver, 1500)
        assert info.speed == 10.0
        assert np.all(np.diff(batch.seq) == 1)
        assert np.all(np.diff(batch.t_hw_ns) == 10_000_000)
        assert (driver.counters.lost, driver.counters.crc_errors, driver.counters.resyncs) == (0, 0, 0)


@pytest.mark.extended
def test_lost_samples_leave_holes_that_are_counted(ball_beam_twin):
    with ball_beam_twin("pty", SPEED, drop_rate=0.2) as (address, _), BallBeamDriver(address) as driver:
        driver.connect()
        batch = collect(driver, 300)
        holes = int(np.sum(np.diff(batch.seq) - 1))
        assert holes == driver.counters.lost > 20
        np.testing.assert_array_equal(np.diff(batch.t_hw_ns), 10_000_000 * np.diff(batch.seq))


@pytest.mark.extended
def test_the_clock_goes_on_where_the_wire_wraps(ball_beam_twin):
    almost = 2**32 * 1e-6 - 0.5
    with ball_beam_twin("pty", SPEED, clock_start=almost) as (address, _), BallBeamDriver(address) as driver:
        driver.connect()
        batch = collect(driver, 300)
    assert np.all(np.diff(batch.t_hw_ns) == 10_000_000)
    assert batch.t_hw_ns[-1] > 2**32 * 1000


@pytest.mark.extended
def test_a_reset_is_reported_after_the_samples_before_it(ball_beam_twin):
    with ball_beam_twin("pty", SPEED, fault_reset_at=1.0) as (address, _), BallBeamDriver(address) as driver:
        driver.connect()
        seen = 0
        with pytest.raises(DeviceResetError, match=r"expected boot .* found boot"):
            while True:
                driver.command({"servo_angle": 0.0})
                seen += len(driver.read(1.0))
        assert seen >= 100
        assert driver.counters.resets == 1
        with pytest.raises(DeviceResetError):
            driver.read(0.1)
        driver.connect()
        assert len(collect(driver, 10)) >= 10


def test_garbage_in_between_is_counted_and_survived(ball_beam_twin):
    with (
        ball_beam_twin("pty", SPEED, fault_garbage_at=0.5) as (address, _),
        BallBeamDriver(address) as driver,
    ):
        driver.connect()
        batch = collect(driver, 200)
        assert driver.counters.crc_errors >= 1
        assert driver.counters.resyncs == 1
        assert len(batch) >= 200


@pytest.mark.extended
def test_silence_is_an_empty_batch(ball_beam_twin):
    with (
        ball_beam_twin("pty", SPEED, fault_silence_at=0.5) as (address, _),
        BallBeamDriver(address) as driver,
    ):
        driver.connect()
        driver.command({"servo_angle": 0.0})
        while len(driver.read(0.5)):
            pass
        assert len(driver.read(0.1)) == 0


@pytest.mark.extended
def test_a_twin_that_dies_is_a_wire_that_is_gone(ball_beam_twin):
    for wire in ("pty", "tcp"):
        with ball_beam_twin(wire, SPEED) as (address, process), BallBeamDriver(address) as driver:
            driver.connect()
            process.send_signal(signal.SIGTERM)
            assert process.wait(10) == 0
            with pytest.raises(ConnectError, match=address):
                while True:
                    driver.read(0.2)


def test_a_port_belongs_to_one_program(ball_beam_twin):
    with ball_beam_twin("pty", SPEED) as (address, _), BallBeamDriver(address) as driver:
        driver.connect()
        with pytest.raises(ConnectError, match="another program"):
            BallBeamDriver(address).connect()
        assert len(driver.read(1.0))


def test_the_servo_turns_no_further_than_it_can():
    with pytest.raises(CommandRefusedError, match=r"1\.5708"):
        BallBeamDriver("nowhere").command({"servo_angle": 1.6})


@contextlib.contextmanager
def impostor(answer):
    """A pty whose other end answers every piece of input with ``answer(bytes)``."""
    master, device = os.openpty()
    tty.setraw(device)
    os.set_blocking(master, False)
    ending = threading.Event()

    def talk():
        while not ending.wait(0.02):
            with contextlib.suppress(BlockingIOError):
                os.write(master, answer(os.read(master, 4096)))

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield os.ttyname(device)
    finally:
        ending.set()
        thread.join()
        os.close(master)
        os.close(device)


def refused(address: str) -> str:
    """What the driver says of somebody who does not speak the protocol."""
    with pytest.raises(ProtocolError) as caught, BallBeamDriver(address) as driver:
        driver.connect()
    return str(caught.value)


@pytest.mark.extended
def test_garbage_alone_is_named():
    with impostor(lambda _: b"position=12 mm\r\n") as address:
        message = refused(address)
    assert address in message
    assert "expected frames" in message
    assert b"position".hex(" ") in message


def test_another_device_is_named():
    decoder = Decoder()

    def answer(data):
        channels = (ChannelScale(1.0, 0.0),) * 2
        requests = [frame for frame in decoder.feed(data) if frame.type == MessageType.HELLO_REQUEST]
        hellos = [Hello(r.seq, (1, 0, 0), "solenoid", "7", 1, 2, 100.0, 1.0, channels) for r in requests]
        return b"".join(encode(Frame(MessageType.HELLO, 0, 0, hello.pack())) for hello in hellos)

    with impostor(answer) as address:
        message = refused(address)
    assert "expected the device 'ball_beam', found 'solenoid'" in message


def test_another_version_is_named():
    with impostor(lambda _: b"\x00" + VERSION_2) as address:
        message = refused(address)
    assert "expected protocol version 1, found 2" in message


@pytest.mark.extended
def test_a_silent_port_is_named():
    with impostor(lambda _: b"") as address, pytest.raises(ConnectError, match="nothing came"):
        BallBeamDriver(address).connect()


def test_a_port_without_descriptor_works_too():
    port = Port("loop://")
    try:
        assert port.receive(0.01) == b""
        port.send(b"there and back")
        received = b""
        while received != b"there and back":
            received += port.receive(1.0)
    finally:
        port.close()


def test_an_address_that_is_no_port_is_refused_with_what_there_is():
    for address in ("nonsense://x", "socket://127.0.0.1:notaport", "/dev/null"):
        with pytest.raises(ConnectError, match="serial port"):
            BallBeamDriver(address).connect()


def test_the_contract_says_that_it_needs_pytest():
    program = "import sys; sys.modules['pytest'] = None; import labhil.testing"
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path))
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=False
    )
    assert run.returncode != 0
    assert "'pytest'" in run.stderr.splitlines()[-1]
