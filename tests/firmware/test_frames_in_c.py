"""The firmware's C against the golden vectors, against Python's decoder, and against rubbish."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from labhil.link import Config, Decoder, Frame, Hello, MessageType, SetCommand, State, StateFlag, encode

GOLDEN = json.loads((Path(__file__).parents[1] / "wire" / "golden_frames.json").read_text(encoding="utf-8"))
LEVEL = 15000
COUNTERS = ("frames", "crc_errors", "resyncs", "other_versions", "last_other_version")


@pytest.fixture(scope="module")
def frames_in_c(host_program):
    return host_program("frames", "frame.c")


def decoded_in_c(program: Path, data: bytes) -> tuple[list[Frame], dict[str, int]]:
    done = subprocess.run([program, "decode"], input=data, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    *lines, last = done.stdout.decode().splitlines()
    found = []
    for line in lines:
        kind, seq, t_us, payload = line.split(" ")
        found.append(Frame(int(kind), int(seq), int(t_us), bytes.fromhex(payload)))
    words = last.split()
    return found, {name: int(value) for name, value in zip(words[::2], words[1::2], strict=True)}


def agree(program: Path, data: bytes) -> list[Frame]:
    """Both decoders find the same in these bytes; gives what that is."""
    decoder = Decoder()
    expected = decoder.feed(data)
    found, counters = decoded_in_c(program, data)
    assert found == expected
    expected_counters = {name: getattr(decoder, name) % 0x10000 for name in COUNTERS}
    if not expected_counters["other_versions"]:
        del expected_counters["last_other_version"], counters["last_other_version"]
    assert counters == expected_counters
    return found


def test_golden_frames_both_ways(frames_in_c):
    wire = bytes.fromhex("".join(vector["hex"] for vector in GOLDEN["frames"]))
    found = agree(frames_in_c, wire)
    assert [MessageType(frame.type).name for frame in found] == [v["type"] for v in GOLDEN["frames"]]
    lines = "".join(f"{f.type} {f.seq} {f.t_us} {f.payload.hex()}\n" for f in found)
    done = subprocess.run([frames_in_c, "encode"], input=lines, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [vector["hex"] for vector in GOLDEN["frames"]]


@pytest.mark.parametrize("vector", GOLDEN["refused"], ids=lambda vector: vector["name"])
def test_golden_broken_frames_are_refused(frames_in_c, vector):
    found, counters = decoded_in_c(frames_in_c, b"\x00" + bytes.fromhex(vector["hex"]))
    assert found == []
    assert counters["crc_errors"] == vector["crc_errors"]
    assert counters["other_versions"] == vector["other_versions"]


def test_every_length_of_payload_both_ways(frames_in_c):
    random = np.random.default_rng(1)
    sent = [Frame(9, size, 2**32 - size - 1, random.bytes(size)) for size in range(244)]
    sent += [Frame(9, size, 0, bytes(size)) for size in range(244)]
    assert agree(frames_in_c, b"".join(encode(frame) for frame in sent)) == sent
    lines = "".join(f"{f.type} {f.seq} {f.t_us} {f.payload.hex()}\n" for f in sent)
    done = subprocess.run([frames_in_c, "encode"], input=lines, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [encode(frame).hex() for frame in sent]


def rubbish(random: np.random.Generator) -> bytes:
    """Noise, zeros, broken frames, frames without end, and good ones in between."""
    frame = encode(Frame(int(random.integers(256)), 1, 2, random.bytes(random.integers(200))))
    match random.integers(7):
        case 0:
            return random.bytes(random.integers(1, 600))
        case 1:
            broken = bytearray(frame)
            broken[random.integers(len(broken))] = random.integers(256)
            return bytes(broken)
        case 2:
            return frame[random.integers(len(frame)) :]
        case 3:
            return frame[: random.integers(len(frame))]
        case 4:
            # long runs without a delimiter, about as long as a frame may be
            return bytes(random.integers(1, 256, random.integers(250, 260), dtype=np.uint8)) + b"\x00"
        case 5:
            return bytes([random.integers(1, 256)]) * int(random.integers(1, 300)) + b"\x00"
        case _:
            return frame


def test_rubbish_is_survived_and_counted_as_in_python(frames_in_c):
    random = np.random.default_rng(20261121)
    found = agree(frames_in_c, b"".join(rubbish(random) for _ in range(4000)))
    assert len(found) > 400
    agree(frames_in_c, random.bytes(200_000))


def test_a_last_block_that_claims_more_than_there_is_reads_nothing_beyond(frames_in_c):
    # pieces of every length; the longest fills the decoder's buffer to its last byte
    pieces = [
        bytes([size - 1, *b"\x07" * (size - 2), 2 + excess]) for size in range(2, 255) for excess in (0, 9)
    ]
    good = encode(Frame(MessageType.HEARTBEAT, 1, 2))
    assert len(agree(frames_in_c, b"\x00".join([*pieces, good]))) == 1


class Talk:
    """A script for the firmware's session; ``play`` gives (command, flags) after each line that asks."""

    def __init__(self, program: Path) -> None:
        self.program = program
        self.lines: list[str] = []

    def hear(self, at: float, kind: MessageType, payload: bytes = b"") -> None:
        self.bytes(at, encode(Frame(kind, 5, 0, payload)))

    def bytes(self, at: float, data: bytes) -> None:
        self.lines.append(f"{round(at * 1e6) % 2**32} hear {data.hex()}")

    def look(self, at: float) -> None:
        """The main loop comes by, and a sample is sent."""
        self.lines += [f"{round(at * 1e6) % 2**32} {verb}" for verb in ("watch", "sample")]

    def play(self) -> tuple[list[Hello], list[tuple[int, int]]]:
        done = subprocess.run(
            [self.program], input="\n".join(self.lines), capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        hellos, looks = [], []
        decoder = Decoder()
        for line in done.stdout.splitlines():
            command, _, sent = line.partition(" ")
            for frame in decoder.feed(bytes.fromhex(sent)):
                if frame.type == MessageType.HELLO:
                    hellos.append(Hello.unpack(frame.payload))
                else:
                    looks.append((int(command), State.unpack(frame.payload).flags))
        return hellos, looks


CONFIGURED, SAFE, EXPIRED = StateFlag.CONFIGURED, StateFlag.SAFE, StateFlag.EXPIRED
AWAY = SetCommand((LEVEL + 1000,)).pack()


@pytest.fixture(scope="module")
def session_in_c(host_program):
    return host_program("talk", "session.c", "frame.c")


@pytest.fixture
def talk(session_in_c):
    return Talk(session_in_c)


def test_it_says_who_it_is_at_boot_and_when_asked(talk):
    talk.hear(0.0, MessageType.HELLO_REQUEST)
    hellos, _ = talk.play()
    assert [hello.answers for hello in hellos] == [0, 5]
    assert hellos[0].device == "ball_beam"
    assert hellos[0].serial == "0123456789abcdef"
    assert (hellos[0].boot_id, hellos[0].sample_rate, hellos[0].speed) == (7, 100.0, 1.0)
    assert [(c.scale, c.zero) for c in hellos[0].channels] == [(0.5, 512.0), (0.001, 15000.0)]


def test_silence_makes_it_safe_and_a_heartbeat_does_not_wake_it(talk):
    talk.hear(1.0, MessageType.CONFIG, Config(200).pack())
    talk.hear(1.0, MessageType.SET, AWAY)
    talk.look(1.19)
    talk.hear(1.19, MessageType.HEARTBEAT)
    talk.look(1.38)
    talk.look(1.40)
    talk.hear(1.41, MessageType.HEARTBEAT)
    talk.look(1.41)
    talk.hear(1.42, MessageType.SET, AWAY)
    talk.look(1.42)
    _, looks = talk.play()
    assert looks == [
        (LEVEL + 1000, CONFIGURED),
        (LEVEL + 1000, CONFIGURED),
        (LEVEL, CONFIGURED | SAFE),
        (LEVEL, CONFIGURED | SAFE),
        (LEVEL + 1000, CONFIGURED),
    ]


def test_nothing_but_whole_messages_is_a_sign_of_life(talk):
    talk.hear(1.0, MessageType.SET, AWAY)
    talk.bytes(1.2, b"\x00garbage\x00")
    talk.hear(1.2, MessageType.CONFIG, b"\x01")
    talk.hear(1.2, MessageType.SET, b"\x01")
    talk.look(1.31)
    assert talk.play()[1] == [(LEVEL, SAFE)]


def test_no_host_can_switch_the_watchdog_off(talk):
    talk.hear(1.0, MessageType.CONFIG, Config(0xFFFF).pack())
    talk.hear(1.0, MessageType.SET, AWAY)
    talk.look(2.99)
    talk.look(3.01)
    assert [flags for _, flags in talk.play()[1]] == [CONFIGURED, CONFIGURED | SAFE]


def test_an_output_that_lasts_too_long_ends_until_safe(talk):
    talk.hear(0.0, MessageType.CONFIG, Config(300, 3).pack())
    for step in range(1, 40):
        talk.hear(0.1 * step, MessageType.SET, AWAY)
        talk.look(0.1 * step)
    talk.hear(4.0, MessageType.SAFE)
    talk.look(4.0)
    talk.hear(4.1, MessageType.SET, AWAY)
    talk.look(4.1)
    _, looks = talk.play()
    lasted = sum(command != LEVEL for command, _ in looks[:39])
    assert lasted in (29, 30)
    assert looks[38] == (LEVEL, CONFIGURED | SAFE | EXPIRED)
    assert looks[39:] == [(LEVEL, CONFIGURED | SAFE), (LEVEL + 1000, CONFIGURED)]


def test_the_device_has_a_limit_of_its_own_and_a_break_starts_the_count_anew(talk):
    talk.hear(0.0, MessageType.CONFIG, Config(2000, 0).pack())
    for second in range(1, 16):
        at_rest = second == 8
        talk.hear(second, MessageType.SET, SetCommand((LEVEL,)).pack() if at_rest else AWAY)
        talk.look(second)
    for second in range(16, 21):
        talk.hear(second, MessageType.SET, AWAY)
        talk.look(second)
    flags = [flags for _, flags in talk.play()[1]]
    assert flags == [CONFIGURED] * 18 + [CONFIGURED | SAFE | EXPIRED] * 2


def test_the_clock_wraps_and_nothing_happens(talk):
    wrap = 2**32 * 1e-6
    for step in range(-5, 6):
        talk.hear(wrap + 0.1 * step, MessageType.SET, AWAY)
        talk.look(wrap + 0.1 * step + 0.05)
    assert talk.play()[1] == [(LEVEL + 1000, 0)] * 11


def test_any_talk_is_survived(talk):
    random = np.random.default_rng(5)
    for k in range(2000):
        kind = MessageType(int(random.integers(1, 9)))
        talk.hear(0.01 * k, kind, random.bytes(random.integers(8)))
        talk.look(0.01 * k)
    _, looks = talk.play()
    assert len(looks) == 2000
    assert all((command == LEVEL) >= bool(flags & SAFE) for command, flags in looks)
