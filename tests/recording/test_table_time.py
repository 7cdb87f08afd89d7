"""The time of a table: no row is lost where a clock pauses, wraps, repeats or is written as a date."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from labhil.errors import TableError
from labhil.recording import describe_import, import_table
from labhil.recording.timeline import increasing_stretches
from labhil.rig import parse_rig

N = 600
STEP = 0.01
K = np.arange(N)
VOLTAGE = 5.0 * np.sign(np.sin(0.05 * K))
SPEED = np.round(20.0 * np.sin(0.03 * K + 0.2), 4)


def rig(toml="", kind="dc_motor"):
    return parse_rig(f'[rig]\nkind = "{kind}"\n{toml}', Path("rig.toml"))


def imported(folder, times, toml="", name="time", delimiter=","):
    lines = [delimiter.join((name, "voltage", "speed"))]
    lines += [delimiter.join(map(str, row)) for row in zip(times, VOLTAGE, SPEED, strict=False)]
    path = folder / "data.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return import_table(path, rig(toml))


def described(table):
    return "\n".join(describe_import(table))


def steps(table):
    return np.diff(table.t)


@pytest.mark.parametrize("rate", [100.0, 500.0, 1000.0])
@pytest.mark.parametrize("hole", [0.3, 1.7, 90.0, 7200.0])
def test_a_hole_loses_no_row_and_is_listed_with_its_line(tmp_path, rate, hole):
    times = K / rate
    times[250:] += hole
    table = imported(tmp_path, times)
    assert len(table) == N
    assert not any(table.dropped.values())
    assert f"1 hole: {hole + 1 / rate:.6g} s before line 252" in described(table)


def test_many_holes_are_counted_and_the_longest_listed(tmp_path):
    times = K * STEP
    for number, place in enumerate(range(50, 500, 50)):
        times[place:] += 1.5 + number
    table = imported(tmp_path, times)
    assert len(table) == N
    assert "9 holes, the longest 7.51 s before line 352, 8.51 s before line 402, 9.51 s before line 452" in (
        described(table)
    )


def test_bursts_lose_no_row(tmp_path):
    table = imported(tmp_path, (K // 4) * 60.0 + (K % 4) * STEP)
    assert len(table) == N


def test_a_wrong_stamp_beside_a_hole_is_dropped_alone(tmp_path):
    times = K * STEP
    times[300:] += 40.0
    times[300] = 0.5
    table = imported(tmp_path, times)
    assert table.row.tolist() == [k for k in range(N) if k != 300]
    assert "dropped: 1 rows with a time that does not follow the others, the first in line 302" in (
        described(table)
    )


def test_a_damaged_block_is_dropped_and_what_comes_before_it_stays():
    garbage = [-0.1, 0.8, 0.0, 2.7e154, -0.03, 47.6, 0.0, 0.0, 0.0]
    times = np.concatenate(([3047.7], garbage, 3048.05 + K * STEP))
    (run,) = increasing_stretches(times)
    assert run.tolist() == [0, *range(10, 10 + N)]


def test_a_stamp_at_an_end_that_is_nowhere_near_is_dropped(tmp_path):
    for place in (0, N - 1):
        times = K * STEP + 100.0
        times[place] = 0.0 if place == 0 else 1.7e9
        times[1:-1] += 1.7e9 if place == 0 else 0.0
        times[-1] += 1.7e9 if place == 0 else 0.0
        table = imported(tmp_path, times)
        assert (len(table), table.dropped["time"]) == (N - 1, 1)


# wraps -------------------------------------------------------------------------------------------------


def test_the_day_is_over_at_midnight(tmp_path):
    seconds = (86398.0 + K * STEP) % 86400.0
    table = imported(tmp_path, [f"{s:.2f}" for s in seconds])
    assert len(table) == N
    assert steps(table) == pytest.approx(STEP, abs=1e-6)
    assert "line 202: the clock of a day passes midnight; this is undone" in described(table)


@pytest.mark.parametrize(("unit", "bits"), [(1e-6, 32), (1e-3, 32), (1e-3, 16), (1e-6, 16)])
@pytest.mark.parametrize("signed", [False, True])
def test_counters_begin_anew(tmp_path, unit, bits, signed):
    per_row = round(STEP / unit)
    counts = (2**bits - 200 * per_row - 17 + K * per_row) % 2**bits
    if signed:
        counts = np.where(counts >= 2 ** (bits - 1), counts - 2**bits, counts)
        counts = (counts + 2 ** (bits - 1) + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)
    toml = f'[channels]\nt={{column="time",scale={unit}}}\nvoltage={{column=1}}\nspeed={{column=2}}'
    table = imported(tmp_path, counts.astype(int), toml)
    assert len(table) == N
    assert steps(table) == pytest.approx(STEP, abs=1e-9)
    if bits == 32 and not signed:
        assert "a counter of 32 bits restarts; this is undone" in described(table)


def test_seconds_of_a_counter_that_the_logger_scaled_begin_anew(tmp_path):
    seconds = (4294.967296 - 1.5 + K * STEP) % 4294.967296
    table = imported(tmp_path, [f"{s:.6f}" for s in seconds])
    assert steps(table) == pytest.approx(STEP, abs=1e-5)


@pytest.mark.parametrize("first", [0.0, 3.0, 86000.0])
def test_a_restart_is_refused_with_its_line_and_a_choice(tmp_path, first):
    times = np.concatenate([first + K[:350] * STEP, first + K[:250] * STEP])
    with pytest.raises(TableError, match=r"line 352 \(the clock restarts: a reboot.*\[table\] part = 1"):
        imported(tmp_path, times)
    with pytest.raises(TableError, match="line 352"):
        imported(tmp_path, times, '[table]\nbad_rows = "fail"')
    for part, rows in ((1, list(range(350))), (2, list(range(350, N)))):
        table = imported(tmp_path, times, f"[table]\npart = {part}")
        assert table.row.tolist() == rows
        assert table.dropped["part"] == N - len(rows)
        assert f"part {part} is taken" in described(table)
    assert len(imported(tmp_path, times, '[table]\nbad_rows = "drop"')) == 350
    with pytest.raises(TableError, match="expected a part from 1 to 2"):
        imported(tmp_path, times, "[table]\npart = 3")


def test_a_clock_that_was_set_back_is_refused_with_its_cause(tmp_path):
    times = 500.0 + K * STEP
    times[300:] -= 2.0
    with pytest.raises(TableError, match=r"line 302 \(the clock was set back\)"):
        imported(tmp_path, times)


@pytest.mark.parametrize(
    ("times", "cause"),
    [
        (K[::-1] * STEP, "running backwards"),
        (np.random.default_rng(1).permutation(K) * STEP, "sorted by time"),
    ],
)
def test_rows_out_of_order_are_refused(tmp_path, times, cause):
    with pytest.raises(TableError, match=cause):
        imported(tmp_path, times)


# repeated stamps ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [2, 3, 5, 10, 100])
@pytest.mark.parametrize("begun", [0, 1])
def test_rows_of_a_stamp_are_spread_evenly(tmp_path, count, begun):
    table = imported(tmp_path, ((K + begun) // count) * count * STEP)
    assert len(table) == N
    assert steps(table) == pytest.approx(STEP, rel=1e-6)
    assert f"time repeats ({count} rows a stamp): rows are spread evenly" in described(table)


def test_a_hole_between_repeated_stamps_stays(tmp_path):
    times = (K // 5) * 0.05
    times[300:] += 2.0
    table = imported(tmp_path, times)
    assert len(table) == N
    assert "1 hole: 2.01 s before line 302" in described(table)


def uneven():
    return np.repeat(np.arange(N) * 0.05, np.random.default_rng(3).integers(3, 7, N))[:N]


def test_uneven_numbers_of_rows_a_stamp_are_refused_with_a_way_out(tmp_path):
    with pytest.raises(TableError, match=r"3 to 6 rows a stamp.*\[table\] rate = \d+.*bad_rows") as caught:
        imported(tmp_path, uneven())
    rate = float(str(caught.value).split("rate = ")[1].split()[0])
    assert rate == pytest.approx(90.0, rel=0.1)
    table = imported(tmp_path, uneven(), "[table]\nrate = 90.0")
    assert len(table) == N
    assert steps(table) == pytest.approx(1 / 90.0)
    dropped = imported(tmp_path, uneven(), '[table]\nbad_rows = "drop"')
    assert len(dropped) == len(np.unique(uneven()))


def test_copies_of_rows_are_not_spread(tmp_path):
    path = tmp_path / "data.csv"
    rows = [f"{(k // 3) * 0.03:.2f},{VOLTAGE[k // 3]},{SPEED[k // 3]}" for k in K]
    path.write_text("t,voltage,speed\n" + "\n".join(rows))
    with pytest.raises(TableError, match="3 rows a stamp, copies of the same row"):
        import_table(path, rig())
    assert len(import_table(path, rig('[table]\nbad_rows = "drop"'))) == N // 3


def test_a_few_repeated_stamps_are_dropped_and_counted(tmp_path):
    times = K * STEP
    times[100], times[400] = times[99], times[399]
    table = imported(tmp_path, times)
    assert (len(table), table.dropped["time"]) == (N - 2, 2)


# dates -------------------------------------------------------------------------------------------------

START = datetime(2026, 3, 29, 1, 59, 58)
STAMPS = [START + timedelta(seconds=k * STEP) for k in range(N)]
MS = [stamp.microsecond // 1000 for stamp in STAMPS]
DATES = {
    "ISO": [stamp.isoformat(" ", "microseconds") for stamp in STAMPS],
    "ISO with T and Z": [stamp.isoformat(timespec="milliseconds") + "Z" for stamp in STAMPS],
    "ISO with a zone": [stamp.isoformat(timespec="milliseconds") + "+02:00" for stamp in STAMPS],
    "compact": [f"{stamp:%Y%m%dT%H%M%S}.{ms:03d}" for stamp, ms in zip(STAMPS, MS, strict=True)],
    "German": [f"{stamp:%d.%m.%Y %H:%M:%S},{ms:03d}" for stamp, ms in zip(STAMPS, MS, strict=True)],
    "day first": [f"{stamp:%d/%m/%Y %H:%M:%S}.{ms:03d}" for stamp, ms in zip(STAMPS, MS, strict=True)],
    "American": [f"{stamp:%m/%d/%Y %I:%M:%S}.{ms:03d} AM" for stamp, ms in zip(STAMPS, MS, strict=True)],
    "MATLAB": [f"{stamp:%d-%b-%Y %H:%M:%S}.{ms:03d}" for stamp, ms in zip(STAMPS, MS, strict=True)],
    "time of day": [f"{stamp:%H:%M:%S}.{ms:03d}" for stamp, ms in zip(STAMPS, MS, strict=True)],
    "time of day, decimal comma": [
        f"{stamp:%H:%M:%S},{ms:03d}" for stamp, ms in zip(STAMPS, MS, strict=True)
    ],
    "minutes": [f"{stamp:%M:%S}.{ms:03d}" for stamp, ms in zip(STAMPS, MS, strict=True)],
    "timedelta": [f"0 days {stamp:%H:%M:%S}.{ms:03d}" for stamp, ms in zip(STAMPS, MS, strict=True)],
}


@pytest.mark.parametrize("name", DATES)
def test_dates_and_times_of_day_are_times(tmp_path, name):
    table = imported(tmp_path, DATES[name], delimiter=";")
    assert len(table) == N
    assert steps(table) == pytest.approx(STEP, abs=1e-6)
    zone = 7200.0 if name == "ISO with a zone" else 0.0
    if "time of day" not in name and name not in {"minutes", "timedelta"}:
        assert table.time_origin == pytest.approx(1774749598.0 - zone)


def test_times_of_day_pass_midnight(tmp_path):
    late = [datetime(2026, 3, 28, 23, 59, 57) + timedelta(seconds=k * STEP) for k in range(N)]
    for form in ("%H:%M:%S.%f", "%I:%M:%S.%f %p"):
        table = imported(tmp_path, [stamp.strftime(form) for stamp in late])
        assert len(table) == N
        assert steps(table) == pytest.approx(STEP, abs=1e-6)
        assert "passes midnight; this is undone" in described(table)


def test_the_end_of_summer_time_is_undone(tmp_path):
    stamps = [STAMPS[k] - timedelta(hours=1 if k > 250 else 0) for k in range(N)]
    table = imported(tmp_path, [stamp.isoformat() for stamp in stamps])
    assert len(table) == N
    assert steps(table) == pytest.approx(STEP, abs=1e-6)
    assert "summer time" in described(table)


def test_the_order_of_day_and_month_is_the_one_that_spans_less(tmp_path):
    late = [datetime(2026, 5, 4, 23, 59, 57) + timedelta(seconds=k * STEP) for k in range(N)]
    for form in ("%d/%m/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f"):
        assert steps(imported(tmp_path, [stamp.strftime(form) for stamp in late])) == pytest.approx(
            STEP, abs=1e-6
        )


def test_a_date_is_no_value_of_a_signal(tmp_path):
    path = tmp_path / "data.csv"
    rows = [f"{k * STEP:.2f},2026-03-29 00:00:{k % 60:02d},1.0" for k in K]
    path.write_text("t,voltage,speed\n" + "\n".join(rows))
    with pytest.raises(
        TableError, match=r"found '2026-03-29 00:00:00' \(a date or a time of day, which counts"
    ):
        import_table(path, rig())


@pytest.mark.parametrize("form", ["xlsx", "parquet"])
def test_texts_that_are_dates_are_times_in_cells_too(tmp_path, form):
    path = tmp_path / f"data.{form}"
    if form == "parquet":
        pq.write_table(pa.table({"time": DATES["ISO"], "voltage": VOLTAGE, "speed": SPEED}), path)
    else:
        book = openpyxl.Workbook()
        book.active.append(["time", "voltage", "speed"])
        for row in zip(DATES["ISO"], VOLTAGE.tolist(), SPEED.tolist(), strict=True):
            book.active.append(row)
        book.save(path)
    table = import_table(path, rig())
    assert len(table) == N
    assert steps(table) == pytest.approx(STEP, abs=1e-6)
    assert "date and time" in described(table)


# which column, and in which unit -----------------------------------------------------------------------


def two_columns(folder, time, timestamp, toml=""):
    path = folder / "data.csv"
    rows = [f"{a},{b},{u},{v}" for a, b, u, v in zip(time, timestamp, VOLTAGE, SPEED, strict=True)]
    path.write_text("time,timestamp,voltage,speed\n" + "\n".join(rows))
    return import_table(path, rig(toml))


@pytest.mark.parametrize("last", [400, N])
def test_a_counter_loses_to_a_clock(tmp_path, last):
    counter = [str(k + 1) if k < last else "" for k in K]
    table = two_columns(tmp_path, counter, 1000.0 + K * STEP)
    assert len(table) == N
    assert table.stream.rate == pytest.approx(100.0)
    assert "time: column 'timestamp' (s), 100 Hz, no holes; 'time' is not used: it" in described(table)


def test_of_two_clocks_the_first_counts_and_an_entry_for_t_decides(tmp_path):
    assert "time: column 'time'" in described(two_columns(tmp_path, K * STEP, 1000.0 + K * 0.02))
    toml = '[channels]\nt={column="timestamp"}\nvoltage={column="voltage"}\nspeed={column="speed"}'
    assert "time: column 'timestamp'" in described(two_columns(tmp_path, K * STEP, 1000.0 + K * 0.02, toml))


@pytest.mark.parametrize(
    ("unit", "seconds", "origin"),
    [
        ("ms", 1e-3, 0),
        ("ms", 1e-3, 1774749598000),
        ("µs", 1e-6, 0),
        ("days", 86400.0, 739704.5),
        ("ns", 1e-9, 0),
    ],
)
def test_an_unlikely_rate_earns_a_note_with_the_likely_unit(tmp_path, unit, seconds, origin):
    table = imported(tmp_path, [repr(origin + k * STEP / seconds) for k in range(N)])
    (note,) = [line for line in describe_import(table) if "are times in s?" in line]
    assert f"in {unit} they would come at 100 Hz" in note
    (line,) = [part for part in note.split("[channels] ") if part.startswith("t = ")]
    toml = f'[channels]\n{line}\nvoltage={{column="voltage"}}\nspeed={{column="speed"}}'
    again = imported(tmp_path, [repr(origin + k * STEP / seconds) for k in range(N)], toml)
    assert again.stream.rate == pytest.approx(100.0, rel=0.02)
    assert "are times in s?" not in described(again)


def test_a_likely_rate_earns_none(tmp_path):
    assert "are times in s?" not in described(imported(tmp_path, K * STEP))
    assert "counter of rows" in described(imported(tmp_path, K))
