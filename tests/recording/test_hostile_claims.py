"""Files that claim more than they can hold, name things to harm a terminal, or crash what reads them."""

import json
import os
import signal
import sys
import threading
import time
import zipfile
from io import BytesIO, StringIO
from pathlib import Path

import h5py
import openpyxl
import pytest
from mcap.writer import CompressionType, Writer
from rich.table import Table as RichTable
from rich.text import Text

from labhil.analysis.import_check import check_table
from labhil.codec import Codec, stream_from_json, stream_to_json
from labhil.errors import ProtocolError, RecordingError, TableError
from labhil.physics.rigs import record_of
from labhil.recording import read_recording
from labhil.recording.formats import isolated
from labhil.recording.recover import recover
from labhil.recording.tables import import_table
from labhil.report.html.report import report_page
from labhil.rig import parse_rig
from labhil.rig_sections import Table
from labhil.signals import Direction, Signal, Stream
from labhil.terminal import printable, printable_json, printable_name, terminal

sys.path.insert(0, str(Path(__file__).parent))
from samples_of_a_bench import RIG, STATE, batch

ROWS = 200
TABLE_RIG = parse_rig('[rig]\nkind = "ball_beam"\n', Path("rig.toml"))


def written(path, *, topic="/bench/state", device="bench", count=60, values=1.0, event=b"{}", more=b""):
    """A recording by mcap's own writer; ``more`` is one more message, in its own chunk."""
    file = BytesIO()
    writer = Writer(file, compression=CompressionType.ZSTD, chunk_size=1 << 30)
    writer.start(profile="")
    writer.add_attachment(0, 0, "rig.toml", "application/toml", RIG.encode())
    told = {"labhil.stream": stream_to_json(STATE), **({"device": device} if device else {})}
    channel = writer.register_channel(topic, "protobuf", 0, told)
    samples = batch(0, count)
    samples.values[:] *= values
    for k, payload in enumerate(Codec(STATE).encode(samples)):
        writer.add_message(channel, int(samples.t_acq_ns[k]), payload, 0, k)
    events = writer.register_channel("/bench/event", "json", 0, {"device": "bench"})
    writer.add_message(events, int(batch(0, 1).t_acq_ns[0]), event, 0)
    if more:
        writer._Writer__finalize_chunk()
        writer.add_message(events, int(batch(0, 1).t_acq_ns[0]), more, 0)
    writer.finish()
    path.write_bytes(file.getvalue())
    return path


@pytest.mark.parametrize("more", [bytes(60_000_000), b'{"a": 1}' * 4_000_000], ids=["zeros", "text"])
def test_a_chunk_that_claims_too_much_is_never_unpacked_and_the_rest_is_recovered(tmp_path, more):
    path = written(tmp_path / "a.mcap", more=more)
    assert path.stat().st_size < 20_000
    with pytest.raises(RecordingError, match="may claim; `labhil recover`"):
        read_recording(path)
    result = recover(path, tmp_path / "b.mcap")
    assert (result.saved, len(result.losses)) == (61, 1)
    assert len(read_recording(tmp_path / "b.mcap").stream_with("ball_position")) == 60


def test_a_topic_without_device_is_refused_and_the_metadata_may_name_it(tmp_path):
    with pytest.raises(RecordingError, match="expected a topic /device/stream"):
        read_recording(written(tmp_path / "a.mcap", topic="state", device=None))
    assert read_recording(written(tmp_path / "b.mcap", topic="state")).streams[0].device == "bench"


def test_an_event_that_is_nested_deeply_is_kept_as_text(tmp_path):
    recording = read_recording(written(tmp_path / "a.mcap", event=b"[" * 50_000))
    assert recording.events[0].body["text"].startswith("[[[")


def test_a_stream_that_no_device_has_is_refused():
    whole = json.loads(stream_to_json(STATE))
    for change in (
        {"rate": 0.0},
        {"rate": float("nan")},
        {"signals": [{**whole["signals"][0], "width": 10**9}]},
    ):
        with pytest.raises(ProtocolError, match="not the declaration of a stream"):
            stream_from_json(json.dumps({**whole, **change}))
    wide = Stream("wide", (Signal("x", "m", Direction.OUTPUT, width=60_000),), 1.0)
    stamps = b"".join(bytes([tag]) + bytes(8) for tag in (9, 17, 25))
    with pytest.raises(ProtocolError, match="expected messages of"):
        Codec(wide).decode([stamps] * 100)


def test_a_stream_without_samples_has_a_page(tmp_path):
    path = written(tmp_path / "a.mcap", count=0)
    assert "ball_position" in str(report_page(path))


@pytest.mark.parametrize("factor", [1e305, 1e-200])
def test_values_that_no_model_can_calculate_with_are_refused_and_have_a_page(tmp_path, factor):
    path = written(tmp_path / "a.mcap", values=factor)
    with pytest.raises(RecordingError, match="expected values"):
        record_of(read_recording(path), TABLE_RIG.kind)
    assert report_page(path)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("factor", [1e305, 1e-200])
def test_an_import_of_such_values_names_them_and_calculates_nothing(tmp_path, factor):
    rows = "".join(f"{k / 100},{factor * (k % 7 + 1)},{factor * (k % 5 - 9)}\n" for k in range(ROWS))
    (tmp_path / "a.csv").write_text("t,servo_angle,ball_position\n" + rows)
    table, lines = check_table(import_table(tmp_path / "a.csv", TABLE_RIG))
    assert len(table) == ROWS
    assert len(lines) == 1 and "servo_angle: expected values" in lines[0]


def sheet(path, stray=()):
    book = openpyxl.Workbook()
    for row in (["t", "servo_angle", "ball_position"], *([k / 10, k, -k] for k in range(ROWS))):
        book.active.append(row)
    for place in stray:
        book.active[place] = 1
    book.save(path)
    return path


def test_a_stray_cell_in_the_last_row_and_column_costs_nothing(tmp_path):
    begun = time.process_time()
    table = import_table(sheet(tmp_path / "a.xlsx", ["XFD1048576", "B1048570"]), TABLE_RIG)
    assert len(table) == ROWS
    assert time.process_time() - begun < 2.0


def test_a_sheet_that_is_almost_empty_is_no_table(tmp_path):
    path = sheet(tmp_path / "a.xlsx", [f"XFD{row}" for row in range(30, 230)])
    with pytest.raises(TableError, match="spread over"):
        import_table(path, TABLE_RIG)


def test_a_workbook_that_unpacks_to_too_much_or_is_of_another_version_is_refused(tmp_path):
    path = sheet(tmp_path / "a.xlsx")
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("xl/theme/more.xml", bytes(60_000_000))
    with pytest.raises(TableError, match="the workbook claims"):
        import_table(path, TABLE_RIG)
    broken = bytearray(sheet(path).read_bytes())
    broken[broken.index(b"PK\x01\x02") + 6] = 99
    path.write_bytes(broken)
    with pytest.raises(TableError, match="cut or damaged: zip file version"):
        import_table(path, TABLE_RIG)


def test_a_data_set_that_was_never_written_is_not_read(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("t", shape=(10**10,), dtype="f8", chunks=(1000,))
    with pytest.raises(TableError, match="'t' claims 80000000000 bytes"):
        import_table(tmp_path / "a.h5", TABLE_RIG)


def test_a_reader_that_crashes_takes_nobody_along_and_the_next_file_is_read(tmp_path):
    pipe = tmp_path / "a.mat"
    os.mkfifo(pipe)  # its reader waits there until it is struck
    isolated._PROCESS._running_child(60.0)
    crash = threading.Timer(0.3, lambda: os.kill(isolated._PROCESS._child.pid, signal.SIGSEGV))
    crash.start()
    with pytest.raises(TableError, match=r"its reader crashed \(SIGSEGV\)"):
        isolated.read_isolated("mat", pipe, Table(), ())
    crash.join()
    assert len(import_table(sheet(tmp_path / "a.xlsx"), TABLE_RIG)) == ROWS


@pytest.mark.extended
def test_a_reader_that_takes_too_much_time_or_memory_is_ended(tmp_path):
    path = sheet(tmp_path / "a.xlsx")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = [0.0, 1.0]
    with pytest.raises(TableError, match="an input is missing"):
        import_table(tmp_path / "a.h5", TABLE_RIG)  # its library is loaded
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("t", shape=(2 * 10**6,), dtype="f8", chunks=(10**6,))
    little_memory = isolated.ReaderLimits(memory=1 << 10, memory_per_byte=0)
    with pytest.raises(TableError, match="cannot be read"):
        isolated.read_isolated("hdf5", tmp_path / "a.h5", Table(), (), little_memory)
    pipe = tmp_path / "a.mat"
    os.mkfifo(pipe)
    with pytest.raises(TableError, match="longer than"):
        isolated.read_isolated("mat", pipe, Table(), (), isolated.ReaderLimits(wall_factor=0.02))
    assert len(import_table(path, TABLE_RIG)) == ROWS


HOSTILE = "a\x1b[31m\x07\x9b\u202eb\u2028c"


def test_nothing_that_steers_a_terminal_is_printed():
    assert printable(HOSTILE + "\n\tb") == "a\\x1b[31m\\x07\\x9b\\u202eb\\u2028c\n\tb"
    assert printable_name("a\nb") == "a\\nb"
    assert len(printable_name("a" * 1000)) < 200
    assert printable("\ud800Fₙ ± … μ 漢") == "\\ud800Fₙ ± … μ 漢"
    text = json.dumps({HOSTILE: "\U000e0041\u202e"}, ensure_ascii=False)
    assert json.loads(printable_json(text)) == json.loads(text)
    assert printable(printable_json(text)) == printable_json(text)


@pytest.mark.parametrize("colours", [True, False])
def test_a_table_on_the_terminal_shows_names_as_they_are(colours):
    out = StringIO()
    console = terminal(
        file=out, force_terminal=colours, width=100, color_system="truecolor" if colours else None
    )
    table = RichTable(title=HOSTILE)
    table.add_column(HOSTILE)
    table.add_row("[/nope] :smile: " + HOSTILE)
    console.print(table, Text(HOSTILE, style="bold"), "[red]" + HOSTILE, highlight=False)
    shown = out.getvalue()
    assert "[/nope] :smile: a\\x1b[31m\\x07\\x9b\\u202eb\\u2028c" in shown
    assert "[red]a" in shown
    assert not set("\x07\x9b\u202e\u2028") & set(shown)
    assert ("\x1b" in shown) == colours


def test_an_import_that_fails_leaves_what_is_there(tmp_path):
    out = tmp_path / "out.mcap"
    out.write_bytes(b"mine")
    with pytest.raises(RecordingError):
        recover(written(tmp_path / "a.mcap"), out)
    assert out.read_bytes() == b"mine"
