"""The cells of a table: numbers in any notation, stated units, slower channels, and how many may be bad."""

from pathlib import Path

import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from labhil.errors import RigFileError, TableError
from labhil.recording import describe_import, import_table
from labhil.recording.formats.notation import Notation
from labhil.recording.units import parse_unit, unit_in_name
from labhil.rig import parse_rig

N = 300
K = np.arange(N)
T = K * 0.01
VOLTAGE = np.round(5.0 * np.sin(0.05 * K), 3)
SPEED = np.round(2000.0 * np.sin(0.03 * K + 0.2), 2)


def rig(toml="", kind="dc_motor"):
    return parse_rig(f'[rig]\nkind = "{kind}"\n{toml}', Path("rig.toml"))


def imported(folder, lines, toml="", file="data.csv", kind="dc_motor"):
    path = folder / file
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return import_table(path, rig(toml, kind))


def table_of(speeds, delimiter=",", write=str, header=("t", "voltage", "speed")):
    rows = zip(map(write, T.tolist()), map(write, VOLTAGE.tolist()), speeds, strict=True)
    return [delimiter.join(header), *(delimiter.join(row) for row in rows)]


def described(table):
    return "\n".join(describe_import(table))


def grouped(x, thousands=".", decimal=",", digits=2):
    return f"{x:,.{digits}f}".replace(",", "§").replace(".", decimal).replace("§", thousands)


# numbers -----------------------------------------------------------------------------------------------


def in_brackets(x):
    return f"({-x})" if x < 0 else str(x)


MINUS = {
    "U+2212": lambda x: str(x).replace("-", "\u2212"),
    "full width": lambda x: str(x).replace("-", "\uff0d"),
    "brackets": in_brackets,
    "behind": lambda x: f"{-x}-" if x < 0 else str(x),
    "Fortran": lambda x: f"{x:.6e}".replace("e", "D"),
}


@pytest.mark.parametrize("name", MINUS)
def test_every_way_to_write_a_minus_is_read(tmp_path, name):
    table = imported(tmp_path, table_of([MINUS[name](x) for x in SPEED.tolist()]))
    assert len(table) == N
    assert table.values[:, 1] == pytest.approx(SPEED)


@pytest.mark.parametrize(
    ("thousands", "decimal", "delimiter"),
    [(".", ",", ";"), (",", ".", ";"), ("'", ".", ","), (" ", ",", ";"), (" ", ".", ","), (".", ",", "\t")],
)
def test_thousands_are_grouped_by_the_stated_mark(tmp_path, thousands, decimal, delimiter):
    lines = table_of(
        [grouped(x, thousands, decimal) for x in SPEED.tolist()],
        delimiter,
        lambda x: str(x).replace(".", decimal),
    )
    toml = f'[table]\ndecimal = "{decimal}"\nthousands = "{thousands}"'
    table = imported(tmp_path, lines, toml)
    assert table.values[:, 1] == pytest.approx(SPEED)
    with pytest.raises(TableError, match=r"""thousands = ".*" it is"""):
        imported(tmp_path, lines, f'[table]\ndecimal = "{decimal}"')


@pytest.mark.parametrize("blank", ["\u00a0", "\u202f", "\u2009"])
def test_a_blank_that_groups_digits_is_named_whichever_it_is(tmp_path, blank):
    lines = table_of([grouped(x, blank, ".") for x in SPEED.tolist()])
    with pytest.raises(TableError, match=r'with \[table\] thousands = " " it is'):
        imported(tmp_path, lines)
    assert imported(tmp_path, lines, '[table]\nthousands = " "').values[:, 1] == pytest.approx(SPEED)


@pytest.mark.parametrize("digits", [0, 2])
def test_under_a_decimal_comma_a_point_is_never_a_decimal_point(tmp_path, digits):
    speeds = [grouped(x, digits=digits) for x in SPEED.tolist()]
    lines = table_of(speeds, ";", lambda x: str(x).replace(".", ","))
    first = next(number for number, text in enumerate(speeds) if "." in text)
    with pytest.raises(TableError, match=rf"line {first + 2}: column 'speed'.*thousands = \"\.\"") as caught:
        imported(tmp_path, lines, '[table]\ndecimal = ","')
    assert 'decimal = "."' not in str(caught.value)
    table = imported(tmp_path, lines, '[table]\ndecimal = ","\nthousands = "."')
    assert table.values[:, 1] == pytest.approx(np.round(SPEED, digits))


def test_one_mark_cannot_be_two():
    with pytest.raises(RigFileError, match="decimal and thousands are both ','"):
        rig('[table]\ndecimal = ","\nthousands = ","')


@pytest.mark.parametrize(
    ("text", "decimal", "thousands", "value"),
    [
        ("1.234", ".", None, 1.234),
        ("1.234", ",", None, None),
        ("1.234", ",", ".", 1234.0),
        ("1.23", ",", ".", None),
        ("12.34,5", ",", ".", None),
        ("1.234.567,5", ",", ".", 1234567.5),
        ("1\u202f234,5", ",", " ", 1234.5),
        ("1\u2019234.5", ".", "'", 1234.5),
        ("\u2212(1)", ".", None, None),
        ("(-1)", ".", None, None),
        ("( 1.5 )", ".", None, -1.5),
        ("1_000", ".", None, None),
        ("--1", ".", None, None),
        ("5 V", ".", None, None),
        (",5", ",", None, 0.5),
        ("5,", ",", None, 5.0),
        ("-", ".", None, None),
        ("1,5E-03", ",", None, 1.5e-3),
    ],
)
def test_a_text_is_a_number_or_none(text, decimal, thousands, value):
    found = Notation(decimal, thousands)
    for number in (found.number(text), float(found.numbers([text])[0])):
        assert np.isnan(number) if value is None else number == value


QUOTED = [f'"{t:.2f}","{u:.3f}","{v:.2f}"' for t, u, v in zip(T, VOLTAGE, SPEED, strict=True)]
QUOTED = [
    "t,voltage,speed",
    *(row.replace(".", ",").replace('","', "§").replace("§", '","') for row in QUOTED),
]


@pytest.mark.parametrize("keys", ['decimal = ","', 'decimal = ","\ndelimiter = "comma"'])
def test_quoted_numbers_with_a_decimal_comma_between_commas(tmp_path, keys):
    table = imported(tmp_path, QUOTED, f"[table]\n{keys}")
    assert table.values[:, 1] == pytest.approx(SPEED)


def test_a_hint_that_is_followed_reads_the_table(tmp_path):
    for file, delimiter in (("data.csv", ";"), ("data.txt", "\t"), ("data.dat", "   ")):
        lines = table_of(
            [str(x).replace(".", ",") for x in SPEED], delimiter, lambda x: str(x).replace(".", ",")
        )
        with pytest.raises(TableError, match=r"with \[table\] decimal = \",\" it is 0"):
            imported(tmp_path, lines, file=file)
        assert imported(tmp_path, lines, '[table]\ndecimal = ","', file).values[:, 1] == pytest.approx(SPEED)
    with pytest.raises(TableError, match=r"with \[table\] decimal = \",\" it is 0"):
        imported(tmp_path, QUOTED)


# how many may be bad -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("bad", "refused"), [(1, False), (3, False), (4, True), (250, True)])
def test_up_to_one_per_cent_is_dropped_and_more_refused_with_the_first_text(tmp_path, bad, refused):
    speeds = SPEED.astype(str).astype(object)
    speeds[20 : 20 + bad] = "lost"
    lines = table_of(speeds)
    place = r"the first in line 22: column 'speed' \(speed\): expected a finite number, found 'lost'"
    if refused:
        with pytest.raises(TableError, match=rf"found {bad} of 300 .*{place}"):
            imported(tmp_path, lines)
    else:
        table = imported(tmp_path, lines)
        assert len(table) == N - bad
        assert table.first_bad["not_finite"].startswith("line 22: column 'speed'")
        assert f"dropped: {bad} rows with text, NaN or nothing in a mapped column" in described(table)
    assert len(imported(tmp_path, lines, '[table]\nbad_rows = "drop"')) == N - bad
    with pytest.raises(TableError, match=r"line 22: column 'speed' \(speed\)"):
        imported(tmp_path, lines, '[table]\nbad_rows = "fail"')


def test_lines_of_another_width_count_too(tmp_path):
    lines = table_of(SPEED.astype(str))
    lines[100:110] = ["1,2"] * 10
    with pytest.raises(TableError, match=r"found 10 of 300 .* line 101: expected 3 fields, found 2"):
        imported(tmp_path, lines)


# units -------------------------------------------------------------------------------------------------

UNITS_LINES = [
    "(ms),(mV),(rpm)",
    "[ms],[mV],[1/min]",
    "ms,mV,U/min",
    '"ms","mV","rpm"',
    "(ms) , (mV) , (rpm)",
]


def in_ms(first=(), header="t,voltage,speed"):
    rows = [f"{1e3 * t:.0f},{1e3 * u:.0f},{v}" for t, u, v in zip(T, VOLTAGE, SPEED, strict=True)]
    return [header, *first, *rows]


def following(message):
    """The ``[channels]`` table that a message proposes."""
    return message[message.index("[channels]") :]


@pytest.mark.parametrize("line", UNITS_LINES)
def test_a_line_of_units_is_read_and_a_table_with_the_factors_proposed(tmp_path, line):
    with pytest.raises(TableError, match=r"t in ms .*voltage in mV .*speed in ") as caught:
        imported(tmp_path, in_ms([line]))
    table = imported(tmp_path, in_ms([line]), following(str(caught.value)))
    assert (len(table), table.rows) == (N, N)
    assert table.t == pytest.approx(T)
    assert table.values[:, 0] == pytest.approx(VOLTAGE, abs=1e-3)
    assert table.values[:, 1] == pytest.approx(SPEED * np.pi / 30)


def test_a_line_of_our_units_is_no_row(tmp_path):
    lines = table_of(SPEED.astype(str))
    table = imported(tmp_path, [lines[0], "(s),(V),(rad/s)", "", *lines[1:]])
    assert (len(table), table.rows) == (N, N)
    assert not any(table.dropped.values())


@pytest.mark.parametrize(
    "names", ["time [ms],u (mV),n (rpm)", "time_ms,u_mV,n_rpm", "t/ms,u in mV,n [1/min]"]
)
def test_units_in_names_are_read_where_channels_ask_for_them(tmp_path, names):
    channels = [f'{name} = {{ column = "{source}" }}' for name, source in
                zip(("t", "voltage", "speed"), names.split(","), strict=True)]  # fmt: skip
    toml = "[channels]\n" + "\n".join(channels)
    with pytest.raises(TableError, match=r"t in ms .*voltage in mV .*speed in ") as caught:
        imported(tmp_path, in_ms(header=names), toml)
    table = imported(tmp_path, in_ms(header=names), following(str(caught.value)))
    assert table.t == pytest.approx(T)
    assert table.values[:, 1] == pytest.approx(SPEED * np.pi / 30)
    stated = toml.replace(" }", ", scale = 1.0 }")
    assert imported(tmp_path, in_ms(header=names), stated).values[:, 1] == pytest.approx(SPEED)


@pytest.mark.parametrize("names", ["Time [s],U (V),n [rad/s]", "TIME (s),u,N", "time,U,n (rad/s)"])
def test_columns_are_found_without_their_units_and_in_any_case(tmp_path, names):
    lines = table_of(SPEED.astype(str))
    channels = '[channels]\nvoltage = { column = "u" }\nspeed = { column = "n" }\nt = { column = "time" }\n'
    assert imported(tmp_path, [names, *lines[1:]], channels).values[:, 1] == pytest.approx(SPEED)


@pytest.mark.parametrize("name", ["Time (ms)", "time_ms", "Time in ms"])
def test_a_time_column_that_states_its_unit_needs_no_entry(tmp_path, name):
    channels = '[channels]\nvoltage = { column = "voltage", scale = 1e-3 }\nspeed = { column = "speed" }\n'
    with pytest.raises(TableError, match=r"expected t in s, found t in ms"):
        imported(tmp_path, in_ms(header=f"{name},voltage,speed"), channels)


def test_the_exact_name_of_a_column_comes_first(tmp_path):
    lines = table_of(SPEED.astype(str))
    table = imported(tmp_path, ["t,voltage,speed,Speed (V)", *(f"{line},7.0" for line in lines[1:])])
    assert table.values[:, 1] == pytest.approx(SPEED)


def test_a_unit_of_another_quantity_earns_a_note(tmp_path):
    lines = table_of(SPEED.astype(str))
    table = imported(tmp_path, [lines[0], "s,V,V", *lines[1:]])
    assert "states V for speed, which is in rad/s" in described(table)


def test_an_axis_may_turn(tmp_path):
    rows = [f"{t:.2f},1.5,{x}" for t, x in zip(T, SPEED, strict=True)]
    with pytest.raises(TableError, match=r"position in deg") as caught:
        imported(tmp_path, ["t,drive_force,position", "s,Nm,deg", *rows], kind="axis")
    assert f'position = {{ column = "position", scale = {np.pi / 180!r} }}' in str(caught.value)


def test_a_workbook_has_a_line_of_units_too(tmp_path):
    book = openpyxl.Workbook()
    book.active.append(["t", "voltage", "speed"])
    book.active.append(["(ms)", "(V)", "(rad/s)"])
    for row in zip((1e3 * T).tolist(), VOLTAGE.tolist(), SPEED.tolist(), strict=True):
        book.active.append(row)
    book.save(tmp_path / "data.xlsx")
    with pytest.raises(
        TableError, match=r'expected t in s, found t in ms .*\n.*\nt = \{ column = "t", scale = 0.001 \}'
    ):
        import_table(tmp_path / "data.xlsx", rig())


@pytest.mark.parametrize(
    "name", ["speed", "current_a", "torque_min", "speed_in", "angle (raw)", "x[0]", "voltage_m"]
)
def test_names_that_only_look_like_units_state_none(name):
    assert unit_in_name(name) is None


def test_units_know_their_factors():
    factors = {
        "µs": 1e-6,
        "mA": 1e-3,
        "°/s": np.pi / 180,
        "N·mm": 1e-3,
        "rad/s^2": 1.0,
        "cm": 1e-2,
        "min": 60.0,
    }
    for text, factor in factors.items():
        assert parse_unit(text).scale == pytest.approx(factor)
    assert parse_unit("K").offset == -273.15
    assert parse_unit("furlong") is None


# slower channels ---------------------------------------------------------------------------------------


def slow(values, every, first=0):
    return [str(x) if k % every == first else "" for k, x in enumerate(values.tolist())]


@pytest.mark.parametrize("every", [2, 3, 10])
def test_a_slower_input_is_held_and_no_row_is_lost(tmp_path, every):
    rows = zip(T, slow(VOLTAGE, every), SPEED, strict=True)
    table = imported(tmp_path, ["t,voltage,speed", *(",".join(map(str, row)) for row in rows)])
    assert len(table) == N
    assert table.values[:, 0] == pytest.approx(VOLTAGE[(K // every) * every])
    assert "voltage is slower" in described(table)


def test_a_slower_state_goes_along_lines_and_its_ends_are_counted(tmp_path):
    temperature = 20.0 + 0.1 * K
    cells = slow(temperature, 10, 3)
    rows = [f"{t:.2f},{u},{v},{c}" for t, u, v, c in zip(T, VOLTAGE, SPEED, cells, strict=True)]
    table = imported(tmp_path, ["t,voltage,speed,winding_temperature", *rows])
    assert table.row.tolist() == list(range(3, 294))
    assert table.values[:, -1] == pytest.approx(temperature[3:294])
    assert table.dropped["edge"] == 9
    assert table.dropped["not_finite"] == 0


def test_a_slower_output_is_refused_with_the_choices(tmp_path):
    rows = [f"{t:.2f},{u},{v}" for t, u, v in zip(T, VOLTAGE, slow(SPEED, 10), strict=True)]
    lines = ["t,voltage,speed", *rows]
    with pytest.raises(TableError, match=r"speed has a value in 30 of 300 rows, .*line 3.*bad_rows.*blanks"):
        imported(tmp_path, lines)
    assert len(imported(tmp_path, lines, '[table]\nbad_rows = "drop"')) == 30
    table = imported(tmp_path, lines, '[table]\nblanks = "fill"')
    assert len(table) == 291
    assert table.values[:, 1] == pytest.approx(np.interp(T[:291], T[::10], SPEED[::10]))


def test_text_in_a_slower_channel_is_no_blank(tmp_path):
    cells = slow(VOLTAGE, 2)
    cells[100:200] = ["lost"] * 100
    rows = [f"{t:.2f},{u},{v}" for t, u, v in zip(T, cells, SPEED, strict=True)]
    with pytest.raises(TableError, match="found 'lost'"):
        imported(tmp_path, ["t,voltage,speed", *rows])


def test_a_channel_that_fell_silent_is_not_filled(tmp_path):
    cells = VOLTAGE.astype(str).tolist()
    cells[100:200] = [""] * 100
    rows = [f"{t:.2f},{u},{v}" for t, u, v in zip(T, cells, SPEED, strict=True)]
    with pytest.raises(TableError, match=r"found 100 of 300 .*line 102: column 'voltage'"):
        imported(tmp_path, ["t,voltage,speed", *rows])


def test_nulls_in_parquet_are_blanks_too(tmp_path):
    voltage = [x if k % 10 == 0 else None for k, x in enumerate(VOLTAGE.tolist())]
    pq.write_table(pa.table({"t": T, "voltage": voltage, "speed": SPEED}), tmp_path / "data.parquet")
    table = import_table(tmp_path / "data.parquet", rig())
    assert len(table) == N
    assert table.values[:, 0] == pytest.approx(VOLTAGE[(K // 10) * 10])
