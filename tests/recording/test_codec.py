"""The bytes of a sample: equal to protobuf's own, and back again bit by bit."""

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from labhil.codec import Codec, stamps_of, stream_from_json, stream_to_json
from labhil.errors import ProtocolError
from labhil.signals import Batch, Direction, Signal, Stream

NAMES = st.lists(
    st.from_regex(r"[a-z][a-z0-9]{0,5}", fullmatch=True).filter(lambda name: name != "seq"),
    min_size=1,
    max_size=20,  # beyond field 15 a tag takes two bytes
    unique=True,
)
INT63 = st.integers(0, 2**63 - 1)


@st.composite
def streams(draw):
    signals = tuple(
        Signal(name, "m", Direction.OUTPUT, width=draw(st.sampled_from([1, 1, 2, 6, 17])))
        for name in draw(NAMES)
    )
    return Stream("state", signals, 100.0)


@st.composite
def samples(draw):
    stream = draw(streams())
    n = draw(st.integers(0, 5))
    stamps = [draw(hnp.arrays(np.int64, n, elements=INT63)) for _ in range(3)]
    values = draw(hnp.arrays(np.float64, (n, stream.width), elements=st.floats(width=64)))
    return stream, Batch(*stamps, values)


def runtime_class(codec):
    """The message as a stranger builds it, from nothing but the descriptor in the file."""
    files = descriptor_pb2.FileDescriptorSet.FromString(codec.descriptor_set())
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(codec.schema_name))


def runtime_message(codec, batch, row):
    message = runtime_class(codec)()
    message.seq, message.t_acq_ns, message.t_hw_ns = (
        int(stamp[row]) for stamp in (batch.seq, batch.t_acq_ns, batch.t_hw_ns)
    )
    for signal in codec.stream.signals:
        values = batch.values[row, codec.stream.columns_of(signal.name)].tolist()
        if signal.width == 1:
            setattr(message, signal.name, values[0])
        else:
            getattr(message, signal.name).extend(values)
    return message


def assert_same(one, two):
    assert np.array_equal(one.seq, two.seq)
    assert np.array_equal(one.t_acq_ns, two.t_acq_ns)
    assert np.array_equal(one.t_hw_ns, two.t_hw_ns)
    assert np.array_equal(one.values, two.values, equal_nan=True)


@pytest.mark.extended
@given(samples())
def test_bytes_equal_protobufs_own_and_come_back(sample):
    stream, batch = sample
    codec = Codec(stream)
    payloads = codec.encode(batch)
    assert payloads == [
        runtime_message(codec, batch, row).SerializeToString(deterministic=True) for row in range(len(batch))
    ]
    assert all(len(payload) == codec.size for payload in payloads)
    assert_same(codec.decode(payloads), batch)
    if payloads:
        assert np.array_equal(
            stamps_of(payloads), np.column_stack([batch.seq, batch.t_acq_ns, batch.t_hw_ns])
        )


@given(samples())
def test_messages_of_other_programs_are_read_too(sample):
    stream, batch = sample
    codec = Codec(stream)
    # protobuf allows fields in any order: three stamps of nine bytes each, moved to the end
    turned = [payload[27:] + payload[:27] for payload in codec.encode(batch)]
    assert_same(codec.decode(turned), batch)


@given(streams())
def test_a_declaration_survives_json(stream):
    assert stream_from_json(stream_to_json(stream)) == stream


def two_signals():
    return Stream("state", (Signal("x", "m", Direction.OUTPUT), Signal("q", "rad", Direction.OUTPUT, 2)), 1.0)


def test_what_is_left_out_is_nan():
    codec = Codec(two_signals())
    message = codec.message_class(seq=1, t_acq_ns=2, t_hw_ns=3)
    batch = codec.decode([message.SerializeToString()])
    assert np.isnan(batch.values).all()
    assert (batch.seq[0], batch.t_acq_ns[0], batch.t_hw_ns[0]) == (1, 2, 3)


@pytest.mark.parametrize(
    ("payload", "found"),
    [(b"", "no seq"), (b"\xff" * 53, "53 bytes"), (b"\x22\x08" + bytes(8), "10 bytes")],
)
def test_other_bytes_are_refused(payload, found):
    with pytest.raises(ProtocolError, match=found):
        Codec(two_signals()).decode([payload])


def test_a_vector_of_the_wrong_length_is_refused():
    codec = Codec(two_signals())
    message = codec.message_class(seq=1, t_acq_ns=2, t_hw_ns=3, q=[1.0, 2.0, 3.0])
    with pytest.raises(ProtocolError, match="q has 3 values, expected 2"):
        codec.decode([message.SerializeToString()])


def test_stamps_of_other_bytes_are_refused():
    with pytest.raises(ProtocolError, match="other tags"):
        stamps_of([b"\xff" * 40])
    with pytest.raises(ProtocolError, match="found one of 3 bytes"):
        stamps_of([b"abc"])


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"signals": [{"name": "x"}], "name": "s", "rate": 1}'])
def test_a_declaration_of_something_else_is_refused(text):
    with pytest.raises(ProtocolError, match="not the declaration"):
        stream_from_json(text)


@pytest.mark.parametrize("name", ["seq", "has space", "größe"])
def test_names_that_protobuf_cannot_bear_are_refused(name):
    with pytest.raises(ValueError, match="names must be identifiers"):
        Codec(Stream("state", (Signal(name, "m", Direction.OUTPUT),), 1.0))
