"""Frames: golden vectors, round trips, garbage, counters that wrap."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labhil.errors import ProtocolError
from labhil.link import (
    LONGEST_FRAME,
    ChannelScale,
    Config,
    Decoder,
    Frame,
    Hello,
    MessageType,
    Samples,
    SetCommand,
    State,
    Unwrapper,
    encode,
)

GOLDEN = json.loads((Path(__file__).parent / "golden_frames.json").read_text(encoding="utf-8"))

frames = st.builds(
    Frame,
    type=st.integers(0, 255),
    seq=st.integers(0, 0xFFFF),
    t_us=st.integers(0, 0xFFFFFFFF),
    payload=st.binary(max_size=200),
)


def build_payload(kind: MessageType, fields: dict) -> bytes:
    if kind is MessageType.HELLO:
        channels = tuple(ChannelScale(*pair) for pair in fields["channels"])
        return Hello(**{**fields, "firmware": tuple(fields["firmware"]), "channels": channels}).pack()
    if kind is MessageType.STATE:
        return State(fields["flags"], tuple(fields["raw"])).pack()
    if kind is MessageType.SAMPLES:
        return Samples(fields["flags"], fields["first"], np.array(fields["raw"], dtype=np.uint16)).pack()
    if kind is MessageType.SET:
        return SetCommand(tuple(fields["raw"])).pack()
    if kind is MessageType.CONFIG:
        return Config(**fields).pack()
    return b""


@pytest.mark.parametrize("vector", GOLDEN["frames"], ids=lambda vector: vector["name"])
def test_golden_frames_both_ways(vector):
    kind = MessageType[vector["type"]]
    payload = build_payload(kind, vector["payload"])
    frame = Frame(int(kind), vector["seq"], vector["t_us"], payload)
    assert encode(frame).hex() == vector["hex"]
    assert Decoder().feed(bytes.fromhex(vector["hex"])) == [frame]


@pytest.mark.parametrize(
    "vector", [v for v in GOLDEN["frames"] if v["type"] == "SAMPLES"], ids=lambda vector: vector["name"]
)
def test_golden_samples_are_read_back(vector):
    (frame,) = Decoder().feed(bytes.fromhex(vector["hex"]))
    samples = Samples.unpack(frame.payload)
    assert (samples.flags, samples.first) == (vector["payload"]["flags"], vector["payload"]["first"])
    assert samples.raw.tolist() == vector["payload"]["raw"]


@pytest.mark.parametrize("vector", GOLDEN["refused"], ids=lambda vector: vector["name"])
def test_golden_broken_frames_are_refused(vector):
    decoder = Decoder()
    assert decoder.feed(b"\x00" + bytes.fromhex(vector["hex"])) == []
    assert (decoder.crc_errors, decoder.other_versions) == (vector["crc_errors"], vector["other_versions"])


@given(st.lists(frames, max_size=8), st.data())
def test_frames_survive_any_splitting(sent, data):
    wire = b"".join(encode(frame) for frame in sent)
    decoder, received, position = Decoder(), [], 0
    while position < len(wire):
        size = data.draw(st.integers(1, 40))
        received += decoder.feed(wire[position : position + size])
        position += size
    assert received == sent
    assert (decoder.frames, decoder.crc_errors, decoder.resyncs) == (len(sent), 0, 0)


@given(st.lists(st.tuples(st.binary(max_size=600), frames), max_size=6))
def test_garbage_between_frames_costs_no_frame(pairs):
    decoder, received = Decoder(), []
    for garbage, frame in pairs:
        # the delimiter ends whatever the garbage began
        received += decoder.feed(garbage + b"\x00" + encode(frame))
    wanted = [frame for _, frame in pairs]
    assert [frame for frame in received if frame in wanted][-len(wanted) :] == wanted
    assert decoder.resyncs <= len(pairs)


@given(frames, st.integers(0, 10_000), st.integers(1, 255))
def test_a_damaged_byte_never_gives_another_frame(frame, place, flip):
    wire = bytearray(encode(frame))
    wire[place % len(wire)] ^= flip
    assert all(found == frame for found in Decoder().feed(bytes(wire) + b"\x00"))


def test_counters_tell_damage_from_joining_late():
    good = encode(Frame(MessageType.HEARTBEAT, 1, 2))
    decoder = Decoder()
    decoder.feed(good[4:])
    assert (decoder.crc_errors, decoder.resyncs) == (0, 0)
    decoder.feed(b"\x05nonsense\x00\x07more\x00" + good)
    assert (decoder.frames, decoder.crc_errors, decoder.resyncs) == (1, 2, 1)
    decoder.feed(b"\x01" * (LONGEST_FRAME * 3) + b"\x00" + good + good)
    assert (decoder.frames, decoder.crc_errors, decoder.resyncs) == (3, 3, 2)


@given(st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=50), st.integers(0, 0xFFFF))
def test_unwrapped_counters_go_on_where_the_wire_wraps(steps, start):
    unwrapper, value = Unwrapper(16), start
    assert unwrapper.unwrap(start) == start
    for step in steps:
        value += step
        assert unwrapper.unwrap(value & 0xFFFF) == value


@pytest.mark.parametrize("message", [Hello, Config, State, SetCommand, Samples])
def test_payloads_of_wrong_length_are_named(message):
    with pytest.raises(ProtocolError, match=r"expected .* found"):
        message.unpack(b"\x00" * (3 if message in (Config, SetCommand) else 4))


def test_hello_keeps_short_decimals():
    hello = Hello(7, (0, 1, 2), "ball_beam", "x" * 16, 1, 2, 100.0, 2.7, (ChannelScale(0.1, 512.0),))
    assert Hello.unpack(hello.pack()) == hello
    assert struct.unpack("<f", struct.pack("<f", 2.7))[0] != 2.7
