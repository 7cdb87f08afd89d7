"""The drivers of solenoid and motor against their twins: the contract, what is fitted, what is counted."""

import numpy as np
import pytest

from labhil.driver import Driver, TwinOptions
from labhil.errors import (
    CommandRefusedError,
    ExperimentFileError,
    ProtocolError,
    RigFileError,
    UnknownNameError,
    UsageError,
)
from labhil.experiment.controller import Controller
from labhil.experiment.experiment import Stabilise, Step, TimedStep
from labhil.link import ChannelScale, Hello
from labhil.plugins import load_twin
from labhil.rig_sections import Limit
from labhil.serial_rig.rig import Scaler
from labhil.service.host import refuse_unwatched
from labhil.service.messages import HostConfig
from labhil.signals import Batch
from labhil.testing import DriverContract
from labhil_dc_motor import DcMotorDriver
from labhil_dc_motor.driver import RIG as MOTOR
from labhil_solenoid import SolenoidDriver
from labhil_solenoid.driver import RIG as SOLENOID

EXCURSION = {"solenoid": {"coil_current_command": 0.5}, "dc_motor": {"voltage": 2.0}}
DRIVERS = {"solenoid": SolenoidDriver, "dc_motor": DcMotorDriver}


@pytest.fixture(scope="class")
def twin_of_class(twin_of, request):
    wire, speed, parameters = request.cls.twin
    with twin_of(request.cls.driver.spec.name, wire, speed, **parameters) as (address, _):
        yield address


class OnTheTwin(DriverContract):
    @pytest.fixture
    def driver_address(self, twin_of_class):
        return twin_of_class


@pytest.mark.extended
class TestSolenoid(OnTheTwin):
    driver = SolenoidDriver
    excursion = EXCURSION["solenoid"]
    twin = ("tcp", 1.0, {"load_cell": 1.0})


@pytest.mark.extended
class TestSolenoidAtTenKilohertz(OnTheTwin):
    driver = SolenoidDriver
    excursion = EXCURSION["solenoid"]
    twin = ("pty", 1.0, {"sample_rate": 10_000.0, "samples_per_frame": 20.0})


@pytest.mark.extended
class TestMotor(OnTheTwin):
    driver = DcMotorDriver
    excursion = EXCURSION["dc_motor"]
    twin = ("pty", 5.0, {"temperature_sensor": 1.0})


@pytest.mark.parametrize("kind", DRIVERS)
@pytest.mark.extended
def test_the_contract_in_short(kind, twin_of):
    class Contract(DriverContract):
        driver = DRIVERS[kind]
        excursion = EXCURSION[kind]

    contract = Contract()
    contract.test_the_declaration_is_complete()
    with twin_of(kind) as (address, _), DRIVERS[kind](address) as driver:
        assert isinstance(driver, Driver)
        driver.connect()
        contract.test_samples_are_numbered_and_timed(driver)
        contract.test_safe_is_reached_and_kept(driver)
        contract.test_an_unknown_command_is_refused(driver)
        contract.test_a_device_left_alone_goes_safe(driver)


def told(driver: Driver, name: str) -> Hello:
    """The HELLO of a device where nothing is fitted that may be missing."""
    rig = driver.rig
    channels = tuple(
        ChannelScale(0.0 if signal.name in rig.optional else 0.5, 10.0) for signal in rig.spec.stream.signals
    )
    return Hello(1, (1, 0, 0), name, "", 1, 2, 250.0, 1.0, channels)


@pytest.mark.parametrize("kind", DRIVERS)
def test_what_is_not_fitted_is_absent(kind):
    driver = DRIVERS[kind]("nowhere")
    hello = told(driver, kind)
    spec = driver.rig.spec_of(hello)
    assert driver.rig.mismatch(hello) == ""
    assert set(spec.stream.names()) == set(driver.spec.stream.names()) - driver.rig.optional
    assert spec.stream.rate == 250.0
    raw = np.full((1, spec.stream.width), 12, dtype=np.uint16)
    np.testing.assert_array_equal(Scaler(driver.rig, hello).values(raw), 1.0)
    assert driver.rig.mismatch(told(driver, "ball_beam")).startswith(f"expected the device '{kind}'")


def test_a_channel_that_must_be_there_is_missed():
    hello = told(DcMotorDriver("nowhere"), "dc_motor")
    without = Hello(
        1, (1, 0, 0), "dc_motor", "", 1, 2, 100.0, 1.0, (ChannelScale(0.0, 0.0), *hello.channels[1:])
    )
    assert "expected the channel speed" in MOTOR.mismatch(without)
    assert "expected 5 channels" in SOLENOID.mismatch(
        Hello(1, (1, 0, 0), "solenoid", "", 1, 2, 100.0, 1.0, hello.channels[:2])
    )


def test_what_needs_a_channel_that_is_not_fitted_is_refused():
    driver = SolenoidDriver("nowhere")
    driver.spec = SOLENOID.spec_of(told(driver, "solenoid"))
    limited = HostConfig("coil", "solenoid", "nowhere", {"magnetic_force": Limit(max=80.0)})
    with pytest.raises(RigFileError, match=r"limits\.magnetic_force.* no such channel"):
        refuse_unwatched(driver, limited)
    refuse_unwatched(driver, HostConfig("coil", "solenoid", "nowhere", {"coil_current": Limit(max=3.0)}))
    step = Step(
        device="coil", signal="coil_current_command", excitation="hold", level=0.5, duration=1.0,
        stabilise=Stabilise(on="magnetic_force", kp=1.0),
    )  # fmt: skip
    with pytest.raises(ExperimentFileError, match="no such channel"):
        Controller([TimedStep(0, step, 0.0)], driver.spec.stream, driver.spec.safe)


def test_turns_are_counted_both_ways_and_across_frames():
    channels = (ChannelScale(0.0, 0.0),) * 5
    scales = [ChannelScale(1.0, 0.0)] * 3
    hello = Hello(1, (1, 0, 0), "dc_motor", "", 1, 2, 100.0, 1.0, (*scales, channels[3], scales[0]))
    scaler = Scaler(MOTOR, hello)
    walk = 60_000 + np.cumsum(np.r_[np.full(10, 20_000), np.full(25, -30_000)])
    seen = []
    for part in np.split(walk, [1, 7, 8, 20]):
        raw = np.zeros((len(part), 4), dtype=np.uint16)
        raw[:, 2] = part % (1 << 16)
        seen.append(scaler.values(raw)[:, 2])
    np.testing.assert_array_equal(np.diff(np.concatenate(seen)), np.diff(walk))


@pytest.mark.parametrize(
    ("driver", "values"),
    [(SolenoidDriver, {"coil_current_command": -0.1}), (SolenoidDriver, {"coil_current_command": 2.8}),
     (SolenoidDriver, {"coil_current": 1.0}), (DcMotorDriver, {"voltage": -12.5})],
)  # fmt: skip
def test_what_a_rig_cannot_do_is_refused_before_anything_is_sent(driver, values):
    with pytest.raises(CommandRefusedError, match="expected"):
        driver("nowhere").command(values)


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("solenoid", TwinOptions(parameters={"sample_rate": 20_000.0}), "sample_rate must lie"),
        ("solenoid", TwinOptions(parameters={"samples_per_frame": 2.5}), "whole number"),
        ("solenoid", TwinOptions(parameters={"lod_cell": 1.0}), "did you mean 'load_cell'"),
        ("solenoid", TwinOptions(parameters={"loop_time": 1e-5}), "loop_time"),
        ("dc_motor", TwinOptions(terms=("eddy_current",)), "does not exist"),
        ("dc_motor", TwinOptions(parameters={"stamp_jitter": 1.0}), "does not exist"),
        ("dc_motor", TwinOptions(terms=(), parameters={"brush_drop.voltage": 1.0}), "belongs to brush_drop"),
    ],
)
def test_options_that_make_no_twin_are_refused(kind, options, message):
    with pytest.raises((UsageError, UnknownNameError), match=message):
        load_twin(kind).serve(options, lambda address: pytest.fail(f"opened {address}"))


@pytest.mark.parametrize("kind", DRIVERS)
def test_every_name_is_documented(kind):
    twin = load_twin(kind)
    assert all(twin.terms().values())
    assert {name.partition(".")[0] for name in twin.parameters() if "." in name} == set(twin.terms())
    assert not any(name.startswith("hidden") for name in twin.parameters())


def collect(driver: Driver, count: int) -> Batch:
    batches = []
    while sum(len(batch) for batch in batches) < count:
        driver.command(EXCURSION[driver.spec.name])
        batches.append(driver.read(1.0))
        assert len(batches[-1]), "the twin fell silent"
    return Batch.joined(batches, driver.spec.stream.width)


@pytest.mark.extended
def test_lost_frames_are_lost_samples_and_the_clock_goes_on_where_it_wraps(twin_of):
    almost = 2**32 * 1e-6 - 0.5
    with (
        twin_of("solenoid", drop_rate=0.1, clock_start=almost) as (address, _),
        SolenoidDriver(address) as driver,
    ):
        driver.connect()
        batch = collect(driver, 2000)
    holes = np.diff(batch.seq) - 1
    assert int(np.sum(holes)) == driver.counters.lost > 50
    assert set(np.unique(holes % 5)) == {0}
    np.testing.assert_array_equal(np.diff(batch.t_hw_ns), 1_000_000 * np.diff(batch.seq))
    assert batch.t_hw_ns[-1] > 2**32 * 1000


@pytest.mark.extended
def test_an_output_that_lasts_too_long_is_a_fault_until_the_device_is_made_safe(twin_of):
    with (
        twin_of("dc_motor", "pty", 5.0, longest_output=3.0) as (address, _),
        DcMotorDriver(address) as driver,
    ):
        driver.connect()
        rows = 0
        while not driver.fault():
            rows += len(collect(driver, 10))
        assert 250 < rows < 450
        assert "ended it" in driver.fault()
        assert not driver.is_transient()
        driver.safe()
        collect(driver, 20)
        assert not driver.fault()


@pytest.mark.extended
def test_another_rig_on_the_port_is_named(twin_of):
    with (
        twin_of("dc_motor", "tcp") as (address, _),
        pytest.raises(ProtocolError, match="expected the device 'solenoid', found 'dc_motor'"),
    ):
        SolenoidDriver(address).connect()


@pytest.mark.extended
def test_an_encoder_counts_on_beyond_sixteen_bits(twin_of):
    with (
        twin_of("dc_motor", "pty", 10.0, encoder=100_000.0) as (address, _),
        DcMotorDriver(address) as driver,
    ):
        driver.connect()
        batch = collect(driver, 1000)
    names = driver.spec.stream.names()
    speed, angle = (batch.values[:, names.index(name)] for name in ("speed", "angle"))
    turned = np.sum(0.5 * (speed[1:] + speed[:-1]) * np.diff(batch.t_hw_ns) * 1e-9)
    assert angle[-1] - angle[0] == pytest.approx(turned, rel=0.02)
    assert angle[-1] - angle[0] > 2.0 * np.pi * 65_536 / 100_000.0
