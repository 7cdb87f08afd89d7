"""Noise on a line, and what our decoders make of it: frames of the serial link, packages of RTDE."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from random import Random

import numpy as np

from labhil.errors import ProtocolError
from labhil.link import Config, Decoder, Frame, Hello, MessageType, Samples, SetCommand, State, encode
from labhil.serial_twin.firmware import Firmware
from labhil_sim_ball_beam.rig import SERVO, make_board
from labhil_sim_ur5.codec import FramingError
from labhil_sim_ur5.rtde import Conversation, Variables
from labhil_sim_ur5.variables import VERSIONS
from labhil_ur5.rtde import DATA, PackageParser, Recipe

PAYLOADS: tuple[Callable[[bytes], object], ...] = (
    Hello.unpack, State.unpack, Samples.unpack, SetCommand.unpack, Config.unpack,
)  # fmt: skip


@dataclass
class Heard:
    """What came of the bytes of one kind of noise.

    ``whole`` frames were sent and not touched, ``missed`` of them were not received; ``longest_miss`` is the
    most of them in a row, one after the other without a damage between. ``wrong`` frames were received and
    never sent; ``by_chance`` is how many of these a checksum of 16 bits lets through at most, on average.
    """

    bytes: int = 0
    sent: int = 0
    touched: int = 0
    whole: int = 0
    received: int = 0
    missed: int = 0
    longest_miss: int = 0
    wrong: int = 0
    refused: int = 0
    by_chance: float = 0.0
    faults: list[str] = field(default_factory=list)


def serial_frames(draw: Random) -> Iterator[bytes]:
    """Frames of a device, each of which differs from all others: samples one by one, and in rows."""
    for number in range(1 << 30):
        t_us = (number * 10_000) & 0xFFFFFFFF
        kind = number % 8
        if kind == 7:
            rows = np.frombuffer(draw.randbytes(80), dtype=np.uint16).reshape(20, 2)
            payload = Samples(1, number, rows).pack()
            yield encode(Frame(MessageType.SAMPLES, number, t_us, payload))
        else:
            raw = tuple(draw.randrange(1 << 16) for _ in range(2))
            yield encode(Frame(MessageType.STATE, number, t_us, State(1, raw).pack()))


def _flip_bits(wire: bytes, draw: Random) -> bytes:
    damaged = bytearray(wire)
    for _ in range(draw.choice((1, 1, 2, 5))):
        damaged[draw.randrange(len(damaged))] ^= 1 << draw.randrange(8)
    return bytes(damaged)


def _burst(wire: bytes, draw: Random) -> bytes:
    start = draw.randrange(len(wire))
    return wire[:start] + draw.randbytes(draw.randrange(1, 12)) + wire[start + draw.randrange(1, 12) :]


def _drop(wire: bytes, draw: Random) -> bytes:
    start = draw.randrange(len(wire))
    return wire[:start] + wire[start + draw.randrange(1, len(wire)) :]


def _insert(wire: bytes, draw: Random) -> bytes:
    place = draw.randrange(len(wire) + 1)
    more = draw.choice((b"\x00", b"\x00\x00", b"\xff", draw.randbytes(draw.randrange(1, 300)), wire[:5]))
    return wire[:place] + more + wire[place:]


def _swap(wire: bytes, draw: Random) -> bytes:
    a, b = sorted((draw.randrange(len(wire)), draw.randrange(len(wire))))
    return wire[a:b] + wire[:a] + wire[b:]


def _noise(wire: bytes, draw: Random) -> bytes:
    return draw.randbytes(len(wire))


DAMAGE: dict[str, Callable[[bytes, Random], bytes]] = {
    "bits flipped": _flip_bits,
    "bursts": _burst,
    "bytes lost": _drop,
    "bytes inserted": _insert,
    "blocks swapped": _swap,
    "frames of noise": _noise,
}


def noisy_frames(count: int, damage: Callable[[bytes, Random], bytes], seed: int) -> Heard:
    """Send about ``count`` bytes of frames of which a third is damaged, and note what is received."""
    draw, heard, decoder = Random(seed), Heard(), Decoder()
    decoder.feed(b"\x00")
    lately: deque[bytes] = deque(maxlen=8)
    missed = 0
    for frame in serial_frames(draw):
        # a damage may leave the frame as it was
        wire = damage(frame, draw) if draw.random() < 1 / 3 else frame
        lately.append(frame)
        received = _take(decoder, wire, heard)
        heard.bytes += len(wire)
        heard.sent += 1
        heard.received += len(received)
        # one whose delimiter is late comes with the next
        heard.wrong += sum(other not in lately for other in received)
        if wire == frame:
            heard.whole += 1
            missed = 0 if frame in received else missed + 1
            heard.missed += frame not in received
            heard.longest_miss = max(heard.longest_miss, missed)
        else:
            heard.touched += 1
            missed = 0
        if heard.bytes >= count:
            break
    heard.refused = decoder.crc_errors
    heard.by_chance = decoder.crc_errors / 2**16
    return heard


def _take(decoder: Decoder, wire: bytes, heard: Heard) -> list[bytes]:
    """Feed a decoder, and return what it takes for frames as they would stand on the wire."""
    try:
        return [encode(frame) for frame in decoder.feed(wire)]
    except Exception as error:  # noqa: BLE001 - whatever it raises is a fault
        heard.faults.append(f"{error!r:.200} on {wire.hex()}")
        return []


def random_bytes(count: int, seed: int) -> Heard:
    """Feed a decoder with bytes at random, and a good frame after each piece, which has to come through."""
    draw, heard, decoder = Random(seed), Heard(), Decoder()
    frames = serial_frames(draw)
    missed = 0
    while heard.bytes < count:
        piece = draw.randbytes(draw.choice((1, 20, 300, 2000)))
        if draw.random() < 0.5:
            # few zeros make pieces of the length of frames
            piece = piece.replace(b"\x00", b"\x01")
        heard.wrong += len(_take(decoder, piece, heard))
        missed = 0
        for _ in range(2):
            frame = next(frames)
            mine = [one for one in _take(decoder, frame, heard) if one == frame]
            heard.whole += 1
            heard.received += len(mine)
            missed = 0 if mine else missed + 1
            heard.missed += not mine
            heard.longest_miss = max(heard.longest_miss, missed)
            heard.bytes += len(frame)
        heard.bytes += len(piece)
    heard.sent = heard.whole
    heard.refused = decoder.crc_errors
    heard.by_chance = decoder.crc_errors / 2**16
    return heard


def forged_frames(count: int, seed: int) -> Heard:
    """Frames with a right checksum and a payload at random: a device, and whoever reads one, refuse them.

    A device never raises; the readers of payloads raise ProtocolError and nothing else.
    """
    draw, heard = Random(seed), Heard()
    firmware = Firmware(make_board(SERVO, 1.0, 0.0, 1e-7))
    while heard.bytes < count:
        kind = draw.choice((*MessageType, 0, 255))
        payload = draw.randbytes(draw.choice((0, 1, 2, 4, 5, 7, 55, 63, 71, 200)))
        wire = encode(Frame(kind, draw.randrange(1 << 16), draw.randrange(1 << 32), payload))
        heard.bytes += len(wire)
        heard.sent += 1
        try:
            firmware.receive(wire, heard.sent * 0.01)
        except Exception as error:  # noqa: BLE001 - whatever it raises is a fault
            heard.faults.append(f"firmware: {error!r:.200} on {wire.hex()}")
        for unpack in PAYLOADS:
            try:
                unpack(payload)
                heard.received += 1
            except ProtocolError:
                heard.refused += 1
            except Exception as error:  # noqa: BLE001
                heard.faults.append(f"{unpack.__qualname__}: {error!r:.200} on {payload.hex()}")
    return heard


def rtde_packages(count: int, seed: int) -> Heard:
    """Packages of RTDE, which has no checksum, damaged: read as far as lengths fit, else refused in words.

    Both ends are tried: the driver's, which receives samples, and the twin's, which takes requests.
    """
    draw, heard = Random(seed), Heard()
    recipe = Recipe(1, struct.Struct(">d6d6dI"), {})
    ways = list(DAMAGE.values())
    packages, conversation = PackageParser("a robot"), Conversation(Variables(VERSIONS["5.11.1"]))
    while heard.bytes < count:
        number = heard.sent
        payload = bytes([1]) + recipe.layout.pack(
            number / 500, *(0.1 * k for k in range(12)), number & 0xFFFF
        )
        request = draw.choice((b"timestamp,actual_q", b"\x00\x02", struct.pack(">d", 500.0) + b"actual_q,x"))
        letter = draw.choice((*b"VvMUOISP", 0, 255))
        for body, ours in ((payload, True), (request, False)):
            wire = struct.pack(">HB", 3 + len(body), DATA if ours else letter) + body
            touched = draw.random() < 0.2
            wire = draw.choice(ways)(wire, draw) if touched else wire
            heard.bytes += len(wire)
            heard.touched += touched
            if ours:
                packages = _feed_driver(packages, recipe, wire, payload, heard)
            else:
                conversation = _feed_twin(conversation, wire, heard)
        heard.sent += 2
    return heard


def _feed_driver(
    packages: PackageParser, recipe: Recipe, wire: bytes, sent: bytes, heard: Heard
) -> PackageParser:
    """Let the driver's side take bytes; a new connection where it refuses them."""
    try:
        for letter, payload in packages.feed(wire):
            if letter == DATA:
                recipe.unpack(payload)
                heard.received += 1
                heard.wrong += payload != sent
    except ProtocolError:
        heard.refused += 1
        return PackageParser("a robot")
    except Exception as error:  # noqa: BLE001 - whatever else it raises is a fault
        heard.faults.append(f"driver: {error!r:.200} on {wire.hex()}")
        return PackageParser("a robot")
    return packages


def _feed_twin(conversation: Conversation, wire: bytes, heard: Heard) -> Conversation:
    """Let the twin's side take bytes; a new client where it refuses them."""
    try:
        conversation.receive(wire)
        conversation.received.clear()
    except FramingError:
        heard.refused += 1
    except Exception as error:  # noqa: BLE001 - whatever else it raises is a fault
        heard.faults.append(f"twin: {error!r:.200} on {wire.hex()}")
    else:
        return conversation
    conversation.close()
    return Conversation(Variables(VERSIONS["5.11.1"]))
