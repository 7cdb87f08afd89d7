"""MCAP files of other programs, by mcap's own writer: JSON, protobuf, CDR and ROS 1, found by dotted path."""

import json
import struct
import sys
import tracemalloc
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import labhil as lh
from labhil.bounds import ImplausibleError
from labhil.errors import LabhilError, MissingExtraError, TableError, UsageError
from labhil.recording import describe_import, import_table, read_recording, write_import
from labhil.recording.formats.mcap_decoders import MessageFormat, make_decoder
from labhil.recording.formats.mcap_file import read_mcap
from labhil.rig import parse_rig

START_NS = 1_700_000_000 * 10**9
STEP_NS = 20_000_000
COUNT = 40


def rig(x, u, more="", kind="ball_beam"):
    text = f'[rig]\nkind = "{kind}"\n{more}\n[channels]\n'
    return parse_rig(
        f'{text}ball_position = {{ column = "{x}" }}\nservo_angle = {{ column = "{u}" }}\n', Path("rig.toml")
    )


def mcap(path, topics, *, count=COUNT, profile="", chunk_size=2000, use_chunking=True, late_ns=0):
    """Topics: name → (encoding, schema name, schema encoding, schema, payload of message k)."""
    file = BytesIO()
    writer = Writer(file, chunk_size=chunk_size, use_chunking=use_chunking)
    writer.start(profile=profile, library="another program")
    channels = {}
    for topic, (encoding, name, schema_encoding, schema, _) in topics.items():
        number = writer.register_schema(name, schema_encoding, schema) if schema_encoding else 0
        channels[topic] = writer.register_channel(topic, encoding, number)
    for k in range(count):
        for topic, (*_, payload) in topics.items():
            t_ns = START_NS + k * STEP_NS
            writer.add_message(channels[topic], t_ns + late_ns, payload(k), t_ns, k)
    writer.finish()
    path.write_bytes(file.getvalue())
    return path


def as_json(value):
    return ("json", "", "", b"", lambda k: json.dumps(value(k)).encode())


BENCH = as_json(lambda k: {"ball": {"x": 0.1 * k}, "servo": [-0.1 * k, 7], "note": "x"})
EXPECTED = np.column_stack([-0.1 * np.arange(COUNT), 0.1 * np.arange(COUNT)])  # inputs are first


def file_set(name="bench.State", *, order=1):
    """A descriptor with a nested message, a repeated one with names, a map, a Timestamp and bytes."""
    file = descriptor_pb2.FileDescriptorProto(
        name="bench.proto", package="bench", syntax="proto3", dependency=["google/protobuf/timestamp.proto"]
    )
    kinds = descriptor_pb2.FieldDescriptorProto

    def message(title, *fields):
        made = file.message_type.add(name=title)
        for number, (field, kind, label, type_name) in enumerate(fields, 1):
            made.field.add(name=field, number=number, type=kind, label=label, type_name=type_name or None)
        return made

    one, many = kinds.LABEL_OPTIONAL, kinds.LABEL_REPEATED
    message("Joint", ("name", kinds.TYPE_STRING, one, ""), ("angle", kinds.TYPE_DOUBLE, one, ""))
    state = message(
        "State",
        ("timestamp", kinds.TYPE_MESSAGE, one, ".google.protobuf.Timestamp"),
        ("joints", kinds.TYPE_MESSAGE, many, ".bench.Joint"),
        ("raw", kinds.TYPE_FLOAT, many, ""),
        ("picture", kinds.TYPE_BYTES, one, ""),
        ("gain", kinds.TYPE_MESSAGE, many, ".bench.State.GainEntry"),
        ("counts", kinds.TYPE_INT64, one, ""),
    )
    entry = state.nested_type.add(name="GainEntry")
    entry.options.map_entry = True
    entry.field.add(name="key", number=1, type=kinds.TYPE_STRING, label=one)
    entry.field.add(name="value", number=2, type=kinds.TYPE_DOUBLE, label=one)
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    return descriptor_pb2.FileDescriptorSet(file=[stamp, file][::order])


def as_protobuf(*, order=1, late_s=0.5):
    files = file_set(order=order)
    pool = descriptor_pool.DescriptorPool()
    for file in file_set().file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("bench.State"))

    def payload(k):
        message = kind(raw=[-0.1 * k, 7.0], picture=b"\xff" * 50, counts=2**40 + k, gain={"a": 0.1 * k})
        t_ns = START_NS + k * STEP_NS - round(late_s * 1e9)
        message.timestamp.seconds, message.timestamp.nanos = divmod(t_ns, 10**9)
        joints = [("ball", 0.1 * k), ("servo", -0.1 * k)]
        for name, angle in joints[:: 1 if k % 2 else -1]:
            message.joints.add(name=name, angle=angle)
        return message.SerializeToString()

    return ("protobuf", "bench.State", "protobuf", files.SerializeToString(), payload)


MSG = "std_msgs/Header header\nfloat64 x\nfloat64[] raw\nstring note\n"
SEPARATOR = "=" * 80 + "\n"
DEFINITIONS = (
    f"{MSG}{SEPARATOR}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{SEPARATOR}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
MSG1 = "Header header\nfloat64 x\nfloat64[] raw\nstring note\n"
DEFINITIONS1 = f"{MSG1}{SEPARATOR}MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"


def as_ros(encoding="cdr"):
    first = encoding == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(MSG1 if first else MSG, "bench_msgs/msg/State"))
    state, header, time = (
        store.types[kind]
        for kind in ("bench_msgs/msg/State", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )

    def payload(k):
        stamp = time(*divmod(START_NS + k * STEP_NS - 500_000_000, 10**9))
        head = header(k, stamp, "") if first else header(stamp, "")
        message = state(head, 0.1 * k, np.array([-0.1 * k, 7.0]), "x")
        write = store.serialize_ros1 if first else store.serialize_cdr
        return bytes(write(message, state.__msgtype__))

    text, kind = (DEFINITIONS1, "ros1msg") if first else (DEFINITIONS, "ros2msg")
    name = "bench_msgs/State" if first else "bench_msgs/msg/State"
    return (encoding, name, kind, text.encode(), payload)


FORMS = {
    "json": (BENCH, "/bench.ball.x", "bench.servo[0]", 0.0),
    "protobuf": (as_protobuf(), "bench.joints.ball.angle", "/bench.raw.0", -0.5),
    "protobuf, files the other way": (
        as_protobuf(order=-1), "bench.joints[ball].angle", "/bench.joints.servo.angle", -0.5,
    ),
    "cdr": (as_ros(), "/bench.x", "/bench.raw[0]", -0.5),
    "ros1": (as_ros("ros1"), "/bench.x", "/bench.raw[0]", -0.5),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_signals_are_found_by_dotted_path_in_every_encoding(tmp_path, form):
    topic, x, u, late = FORMS[form]
    table = import_table(mcap(tmp_path / "a.mcap", {"/bench": topic}), rig(x, u))
    assert table.values == pytest.approx(EXPECTED, abs=1e-6)
    assert table.t == pytest.approx(np.arange(COUNT) * STEP_NS * 1e-9, abs=1e-6)
    assert table.time_origin == pytest.approx(START_NS * 1e-9 + late, abs=1e-6)
    assert not sum(table.dropped.values())
    clock = {"json": "at which the file's recorder", "protobuf": "is their timestamp"}
    lines = "\n".join(describe_import(table))
    assert clock.get(form.partition(",")[0], "the stamps in their headers") in lines
    recording = read_recording(write_import(table, tmp_path / "b.mcap"))
    assert len(recording.stream_with("ball_position")) == COUNT


def test_it_is_read_in_one_step_from_python(tmp_path):
    path = mcap(tmp_path / "a.mcap", {"/bench": BENCH})
    rules = rig("ball.x", "servo[0]")
    recording = lh.read(path, rig=rules)
    assert recording["ball_position"] == pytest.approx(EXPECTED[:, 1])
    assert lh.read(recording.save(tmp_path / "saved.mcap"))["servo_angle"] == pytest.approx(EXPECTED[:, 0])
    with pytest.raises(UsageError, match="an MCAP file of another program needs a rig"):
        lh.read(path)


@pytest.mark.parametrize("chunked", [True, False])
def test_chunks_or_none_and_a_path_alone_where_one_topic_has_it(tmp_path, chunked):
    topics = {"/state.of.bench": BENCH, "/other": as_json(lambda k: {"y": k})}
    path = mcap(tmp_path / "a.mcap", topics, use_chunking=chunked)
    assert import_table(path, rig("ball.x", "servo[0]")).values == pytest.approx(EXPECTED)
    full = rig("/state.of.bench.ball.x", "state.of.bench.servo.0")
    assert import_table(path, full).values == pytest.approx(EXPECTED)


def test_numbers_on_several_topics_are_taken_at_the_times_of_the_first(tmp_path):
    topics = {"/uu": as_json(lambda k: [-0.1 * k]), "/xx": as_json(lambda k: 0.1 * k), "/b": as_protobuf()}
    table = import_table(mcap(tmp_path / "a.mcap", topics), rig("/xx.value", "uu.value[0]"))
    assert table.values == pytest.approx(EXPECTED)
    assert any("/uu is another topic" in line for line in describe_import(table))
    table = import_table(tmp_path / "a.mcap", rig("/b.gain.a", "/b.joints.servo.angle"))
    assert table.values == pytest.approx(EXPECTED, abs=1e-6)


@pytest.mark.parametrize(
    "stamp",
    [
        lambda s, ns: {"sec": s, "nsec": ns},
        lambda s, ns: {"secs": s, "nsecs": ns},
        lambda s, ns: f"{np.datetime64(s * 10**9 + ns, 'ns')}"[:26] + "Z",
        lambda s, ns: f"{np.datetime64(s * 10**9 + ns, 'ns')}"[:26],
    ],
)
def test_stamps_in_json_are_the_time(tmp_path, stamp):
    def message(k):
        return {"timestamp": stamp(*divmod(START_NS + k * STEP_NS, 10**9)), "x": k, "u": -k}

    path = mcap(tmp_path / "a.mcap", {"/s": as_json(message)}, late_ns=10**9)
    table = import_table(path, rig("/s.x", "/s.u"))
    assert table.time_origin == pytest.approx(START_NS * 1e-9, abs=1e-5)
    assert table.t == pytest.approx(np.arange(COUNT) / 50, abs=1e-5)
    more = 't = { column = "received" }\n'
    received = parse_rig(rig("/s.x", "/s.u").text + more, Path("rig.toml"))
    assert import_table(path, received).time_origin == pytest.approx(START_NS * 1e-9 + 1.0, abs=1e-5)
    sent = parse_rig(rig("/s.x", "/s.u").text + more.replace("received", "/s.publish_time"), Path("rig.toml"))
    assert import_table(path, sent).time_origin == pytest.approx(START_NS * 1e-9, abs=1e-5)


def test_messages_that_cannot_be_decoded_are_bad_rows_and_counted(tmp_path):
    whole = BENCH[-1]
    topics = {"/bench": (*BENCH[:-1], lambda k: b"{" if k in (0, 7) else whole(k))}
    path = mcap(tmp_path / "a.mcap", topics, count=400)
    table = import_table(path, rig("ball.x", "servo[0]", "[table]\nbad_rows = 'drop'"))
    assert (len(table), table.dropped["not_finite"]) == (398, 2)
    assert any("2 messages of /bench cannot be decoded; the first: Expect" in n for n in table.notes)


def test_what_is_no_column_is_named_with_the_reason(tmp_path):
    topics = {
        "/bench": BENCH,
        "/flat": ("flatbuffer", "Flat", "flatbuffer", b"x", lambda k: b"\0"),
        "/bare": ("protobuf", "", "", b"", lambda k: b"\0"),
        "/bad": ("protobuf", "a.B", "protobuf", b"\xff\xff", lambda k: b"\0"),
        "/odd": ("cdr", "a/msg/B", "ros2msg", b"this is no definition", lambda k: bytes(8)),
    }
    path = mcap(tmp_path / "a.mcap", topics)
    assert len(import_table(path, rig("ball.x", "servo[0]"))) == COUNT
    with pytest.raises(TableError) as refused:
        import_table(path, rig("/flat.x", "servo[0]"))
    text = str(refused.value)
    assert "expected a column '/flat.x'" in text and "/bench.ball.x" in text
    assert "/flat is no column: its encoding 'flatbuffer' is not read" in text
    assert "/bare is no column: its messages are protobuf, but the file holds no descriptor of them" in text
    assert "/bad is no column: the descriptor of a.B cannot be used" in text
    assert "/odd is no column: the definition of a/msg/B cannot be used" in text
    del topics["/bench"]
    with pytest.raises(TableError, match=r"expected an MCAP file with messages in json.*/flat is no column"):
        import_table(mcap(tmp_path / "b.mcap", topics), rig("/flat.x", "servo[0]"))


def test_without_rosbags_json_is_read_and_cdr_names_the_extra(tmp_path, monkeypatch):
    path = mcap(tmp_path / "a.mcap", {"/bench": BENCH, "/ros": as_ros()})
    only = mcap(tmp_path / "b.mcap", {"/ros": as_ros()})
    for name in [name for name in sys.modules if name.partition(".")[0] == "rosbags"]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert len(read_mcap(path, ["ball.x"]).lines) == COUNT
    with pytest.raises(MissingExtraError, match=r"/ros.*rosbags.*pip install 'labhil\[formats\]'"):
        read_mcap(only, ["/ros.x"])


@pytest.mark.parametrize("cut", [1, 40, 400])
def test_a_cut_file_is_refused_in_words(tmp_path, cut):
    path = mcap(tmp_path / "a.mcap", {"/bench": BENCH})
    path.write_bytes(path.read_bytes()[:-cut])
    with pytest.raises(TableError, match=r"expected a whole MCAP file, found one .*mcap recover"):
        import_table(path, rig("ball.x", "servo[0]"))


def test_a_file_that_claims_too_much_or_has_a_name_for_every_number_is_refused(tmp_path):
    topics = {"/a": ("json", "", "", b"", lambda k: b'"' + b" " * 60_000_000 + b'"')}
    with pytest.raises(TableError, match="a chunk claims"):
        import_table(mcap(tmp_path / "a.mcap", topics, count=1), rig("/a.x", "/a.u"))
    many = as_json(lambda k: {f"x{k}_{j}": j for j in range(60)})
    with pytest.raises(ImplausibleError, match="/a hold more than 4096 different numbers"):
        read_mcap(mcap(tmp_path / "b.mcap", {"/a": many}, count=100), ["/a.x"])


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=12,
)


@settings(max_examples=60, deadline=None)
@given(values=st.lists(JSON, min_size=1, max_size=4))
def test_any_json_is_read_or_refused_in_words(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("json") / "a.mcap"
    mcap(path, {"/a": as_json(lambda k: values[k])}, count=len(values))
    try:
        columns = read_mcap(path, ["/a.x"])
    except LabhilError as refused:
        assert str(path) in str(refused)
        return
    assert len(columns.names) == columns.width == len(columns.locations)
    assert all(
        columns.numbers(place).shape == (len(values),)
        for place in range(columns.width)
        if columns.locations[place][0] is not None
    )


@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=200), encoding=st.sampled_from(["json", "protobuf", "cdr", "ros1"]))
def test_payloads_of_any_bytes_raise_nothing_but_errors_of_their_libraries(data, encoding):
    form = {"json": BENCH, "protobuf": as_protobuf(), "cdr": as_ros(), "ros1": as_ros("ros1")}[encoding]
    decode = make_decoder(MessageFormat(form[0], form[1], form[2], form[3]), "a test")
    try:
        decode(data)
    except Exception as error:  # noqa: BLE001
        assert not isinstance(error, (MemoryError, SystemError))


@settings(max_examples=40, deadline=None)
@given(place=st.integers(0, 10**6), bits=st.integers(1, 255))
def test_a_damaged_file_is_read_or_refused_in_words(tmp_path_factory, place, bits):
    folder = tmp_path_factory.mktemp("damaged")
    topics = {"/bench": BENCH, "/ros": as_ros(), "/proto": as_protobuf()}
    data = bytearray(mcap(folder / "a.mcap", topics, count=6).read_bytes())
    data[8 + place % (len(data) - 8)] ^= bits
    (folder / "b.mcap").write_bytes(data)
    try:
        read_mcap(folder / "b.mcap", ["/bench.ball.x", "/ros.x", "/proto.raw[0]"])
    except (LabhilError, ImplausibleError) as refused:
        assert str(refused)


@pytest.mark.parametrize("field", [1, 9 + 32])  # of the record, and of the chunk's content
def test_a_damaged_length_of_a_chunk_reserves_no_memory(tmp_path, field):
    path = mcap(tmp_path / "a.mcap", {"/bench": BENCH}, count=6)
    with path.open("rb") as file:
        (chunk, *_) = make_reader(file).get_summary().chunk_indexes
    data = bytearray(path.read_bytes())
    data[chunk.chunk_start_offset + field + 4] ^= 6  # 24 GiB more
    path.write_bytes(data)
    tracemalloc.start()
    try:
        read_mcap(path, ["/bench.ball.x"])
    except (LabhilError, ImplausibleError) as refused:
        assert str(refused)
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak < 32 << 20


def test_messages_nested_without_an_end_and_numbers_without_a_bound_are_read(tmp_path):
    deep = b'{"a":' * 20_000 + b"1" + b"}" * 20_000
    topics = {"/a": ("json", "", "", b"", lambda k: deep if k % 2 else b'{"x": 1' + b"0" * 400 + b"}")}
    columns = read_mcap(mcap(tmp_path / "a.mcap", topics, count=4), ["/a.x"])
    assert np.isinf(columns.numbers(columns.find("/a.x")[0])).tolist() == [True, False, True, False]


def test_a_file_by_hand_without_an_index_is_read(tmp_path):
    """A writer that keeps no summary, as small loggers do."""
    file = BytesIO()
    writer = Writer(file, compression=CompressionType.NONE, use_statistics=False, use_summary_offsets=False,
                    repeat_channels=False, repeat_schemas=False, use_chunking=False)  # fmt: skip
    writer.start()
    channel = writer.register_channel("bench", "json", 0)
    for k in range(COUNT):
        writer.add_message(channel, START_NS + k * STEP_NS, BENCH[-1](k), START_NS + k * STEP_NS)
    writer.finish()
    (tmp_path / "a.mcap").write_bytes(file.getvalue())
    assert struct.unpack("<Q", file.getvalue()[-28:-20]) == (0,)
    assert import_table(tmp_path / "a.mcap", rig("ball.x", "bench.servo[0]")).values == pytest.approx(
        EXPECTED
    )
