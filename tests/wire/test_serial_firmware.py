"""What the boards of solenoid and motor do, without a wire: frames of several samples, outputs that end."""

import numpy as np
import pytest

from labhil.link import (
    ChannelScale,
    Config,
    Decoder,
    Frame,
    MessageType,
    Samples,
    SetCommand,
    StateFlag,
    encode,
)
from labhil.serial_twin.converter import Converter, Counter
from labhil.serial_twin.firmware import Board, Firmware


@pytest.fixture
def firmware():
    scale = ChannelScale(1e-4, 0.0)
    board = Board("solenoid", (scale, scale), 0, lambda wanted: min(wanted, 27_000), 1000.0, per_frame=4)
    return Firmware(board)


def say(firmware: Firmware, kind: MessageType, payload: bytes = b"") -> None:
    firmware.receive(encode(Frame(kind, 5, 0, payload)), 0.0)


def sampled(firmware: Firmware, count: int) -> list[tuple[Frame, Samples]]:
    rows = np.arange(2 * count, dtype=np.uint16).reshape(count, 2)
    frames = Decoder().feed(b"".join(firmware.samples(rows)))
    return [(frame, Samples.unpack(frame.payload)) for frame in frames]


def test_samples_wait_until_a_frame_is_full_and_are_numbered_and_timed(firmware):
    assert sampled(firmware, 3) == []
    ((frame, some),) = sampled(firmware, 2)
    assert (frame.seq, frame.t_us, some.first, some.raw.shape) == (0, 0, 0, (4, 2))
    later = sampled(firmware, 8)
    assert [(frame.seq, frame.t_us, some.first) for frame, some in later] == [(1, 4000, 4), (2, 8000, 8)]


def test_an_output_that_lasts_too_long_ends_and_stays_ended_until_safe(firmware):
    say(firmware, MessageType.CONFIG, Config(300, 1).pack())
    say(firmware, MessageType.SET, SetCommand((30_000,)).pack())
    assert firmware.output == 27_000
    sampled(firmware, 996)
    assert firmware.output == 27_000
    (_, some) = sampled(firmware, 8)[-1]
    assert firmware.output == 0
    assert some.flags == StateFlag.CONFIGURED | StateFlag.SAFE | StateFlag.EXPIRED
    say(firmware, MessageType.SET, SetCommand((1000,)).pack())
    assert firmware.output == 0
    say(firmware, MessageType.SAFE)
    say(firmware, MessageType.SET, SetCommand((1000,)).pack())
    assert firmware.output == 1000


def test_an_output_with_breaks_goes_on(firmware):
    say(firmware, MessageType.CONFIG, Config(300, 1).pack())
    for _ in range(4):
        say(firmware, MessageType.SET, SetCommand((1000,)).pack())
        sampled(firmware, 900)
        assert firmware.output == 1000
        say(firmware, MessageType.SET, SetCommand((0,)).pack())
        sampled(firmware, 4)


def test_a_device_limits_by_itself_what_a_host_does_not():
    board = Board("dc_motor", (ChannelScale(1.0, 0.0),), 0, lambda wanted: wanted, 100.0, longest_output=2.0)
    firmware = Firmware(board)
    say(firmware, MessageType.CONFIG, Config(300, 0).pack())
    say(firmware, MessageType.SET, SetCommand((7,)).pack())
    for _ in range(201):
        firmware.samples(np.zeros((1, 1), dtype=np.uint16))
    assert firmware.output == 0


def test_a_converter_has_its_ends_and_a_counter_has_none():
    converter, counter = Converter(-1.0, 3.0, 12), Counter(0.5)
    values = np.array([-1.0, 0.0, 0.5, 2.999, 7.0, -9.0])
    back = [converter.scale.value(int(raw)) for raw in converter.raw(values)]
    np.testing.assert_allclose(back, [-1.0, 0.0, 0.5, 2.999, 3.0, -1.0], atol=1.01e-3)
    np.testing.assert_array_equal(counter.raw(np.array([0.0, 0.6, -0.1, 32768.2])), [0, 1, 65535, 0])
