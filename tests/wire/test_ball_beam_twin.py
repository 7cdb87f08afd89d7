"""The twin as a program: what it is told, what it keeps to itself, how it ends."""

import json

import numpy as np
import pytest

from labhil.driver import TwinOptions
from labhil.errors import UnknownNameError, UsageError
from labhil.link import (
    ChannelScale,
    Config,
    Decoder,
    Frame,
    Hello,
    MessageType,
    SetCommand,
    State,
    StateFlag,
    encode,
)
from labhil.serial_twin.firmware import COMMAND_TIMEOUT, Firmware
from labhil.serial_twin.settings import TwinSettings
from labhil.serial_twin.twin import write_answer
from labhil_sim_ball_beam import TWIN
from labhil_sim_ball_beam.rig import LEVEL, make_board


@pytest.fixture
def firmware():
    return Firmware(make_board(ChannelScale(0.5 / 1024, 512.0), 1.0, 0.0, 1e-6))


def say(firmware: Firmware, kind: MessageType, payload: bytes = b"", now: float = 0.0) -> list[Frame]:
    return Decoder().feed(firmware.receive(encode(Frame(kind, 5, 0, payload)), now))


def flags(firmware: Firmware) -> int:
    (message,) = firmware.samples(np.array([[512, LEVEL]], dtype=np.uint16))
    (frame,) = Decoder().feed(message)
    return State.unpack(frame.payload).flags


def test_the_watchdog_levels_the_beam_and_a_new_command_wakes_it(firmware):
    say(firmware, MessageType.SET, SetCommand((LEVEL + 1000,)).pack(), now=1.0)
    firmware.watch(0.99 + COMMAND_TIMEOUT)
    assert firmware.output == LEVEL + 1000
    say(firmware, MessageType.HEARTBEAT, now=1.2)
    firmware.watch(1.19 + COMMAND_TIMEOUT)
    assert firmware.output == LEVEL + 1000
    firmware.watch(1.21 + COMMAND_TIMEOUT)
    assert firmware.output == LEVEL
    assert flags(firmware) & StateFlag.SAFE
    say(firmware, MessageType.SET, SetCommand((LEVEL - 500,)).pack(), now=2.0)
    assert firmware.output == LEVEL - 500
    assert not flags(firmware) & StateFlag.SAFE


def test_a_heartbeat_does_not_undo_safe(firmware):
    say(firmware, MessageType.SET, SetCommand((LEVEL + 1000,)).pack())
    say(firmware, MessageType.SAFE)
    say(firmware, MessageType.HEARTBEAT)
    assert firmware.output == LEVEL
    assert flags(firmware) & StateFlag.SAFE


def test_garbage_and_broken_payloads_do_not_keep_the_watchdog_quiet(firmware):
    say(firmware, MessageType.SET, SetCommand((LEVEL + 1000,)).pack(), now=1.0)
    firmware.receive(b"\x00garbage\x00", 1.2)
    say(firmware, MessageType.CONFIG, b"\x01", now=1.2)
    firmware.watch(1.1 + COMMAND_TIMEOUT)
    assert firmware.output == LEVEL


def test_the_pulse_has_whole_microseconds_and_ends_at_ninety_degrees(firmware):
    say(firmware, MessageType.SET, SetCommand((LEVEL + 1006,)).pack())
    assert firmware.output == LEVEL + 1010
    say(firmware, MessageType.SET, SetCommand((0xFFFF,)).pack())
    assert firmware.output == LEVEL + 5000


def test_a_boot_forgets_the_configuration_and_is_told_apart(firmware):
    say(firmware, MessageType.CONFIG, Config(300).pack())
    assert flags(firmware) & StateFlag.CONFIGURED
    (before,) = say(firmware, MessageType.HELLO_REQUEST)
    firmware.boot(0.0)
    (after,) = say(firmware, MessageType.HELLO_REQUEST)
    assert not flags(firmware) & StateFlag.CONFIGURED
    assert Hello.unpack(before.payload).boot_id != Hello.unpack(after.payload).boot_id
    assert Hello.unpack(after.payload).answers == 5


def test_the_answer_holds_everything_and_only_on_request(tmp_path):
    path = tmp_path / "answer.json"
    options = TwinOptions(seed=7, terms=("coulomb_friction",), parameters={"coulomb_friction.level": 0.2})
    write_answer(path, TwinSettings.of(options, TWIN.settable))
    answer = json.loads(path.read_text(encoding="utf-8"))
    assert answer["terms"] == ["coulomb_friction"]
    assert answer["parameters"]["coulomb_friction.level"] == 0.2
    assert answer["parameters"]["ball_mass"] == 0.261
    assert "viscous_friction.coefficient" not in answer["parameters"]
    with pytest.raises(UsageError, match="cannot be written"):
        write_answer(tmp_path / "no" / "where.json", TwinSettings.of(options, TWIN.settable))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (TwinOptions(wire="smoke"), "wire 'smoke' does not exist"),
        (TwinOptions(speed=0.0), "speed must be"),
        (TwinOptions(terms=("stribeck",)), "did you mean 'stribeck_friction'"),
        (TwinOptions(parameters={"latancy": 1.0}), "did you mean 'latency'"),
        (TwinOptions(terms=(), parameters={"dead_zone.left": 1.0}), "belongs to dead_zone"),
        (TwinOptions(parameters={"drop_rate": 2.0}), "drop_rate"),
        (TwinOptions(parameters={"latency": -1.0}), "latency"),
    ],
)
def test_options_that_make_no_twin_are_refused_before_anything_opens(options, message):
    with pytest.raises((UsageError, UnknownNameError), match=message):
        TWIN.serve(options, lambda address: pytest.fail(f"opened {address}"))


def test_every_name_is_documented():
    terms, parameters = TWIN.terms(), TWIN.parameters()
    assert all(terms.values())
    assert {name.partition(".")[0] for name in parameters if "." in name} == set(terms)
    assert {"seed", "terms"}.isdisjoint(parameters)


def test_a_twin_without_terms_is_the_bare_rig():
    assert TwinSettings.of(TwinOptions(terms=()), TWIN.settable).terms == ()
    assert TwinSettings.of(TwinOptions(), TWIN.settable).terms == (
        "viscous_friction",
        "coulomb_friction",
        "stribeck_friction",
    )


@pytest.mark.extended
@pytest.mark.parametrize("wire", ["pty", "tcp"])
def test_a_twin_ends_with_its_parent_though_nobody_ever_connected(wire, ball_beam_twin):
    # leaving the block closes the pipe on its standard input, and checks how it ended
    with ball_beam_twin(wire) as (address, process):
        assert address.startswith("/dev/" if wire == "pty" else "socket://127.0.0.1:")
        assert process.poll() is None
