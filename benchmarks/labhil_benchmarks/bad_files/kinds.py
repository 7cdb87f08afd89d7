"""Which files are spoilt how, and which command reads them: a case is a folder of files and a command."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from random import Random
from typing import Any

from labhil.toml_text import to_toml
from labhil_benchmarks.bad_files import samples
from labhil_benchmarks.bad_files.inside import spoil_database, spoil_mat, spoil_mcap, spoil_zip
from labhil_benchmarks.bad_files.random_text import random_csv, random_json, random_toml
from labhil_benchmarks.bad_files.spoil import spoil_bytes, spoil_encoding, spoil_tree

IMPORT = ("import", "--rig", "rig.toml", "-o", "out.mcap")


@dataclass(frozen=True, slots=True)
class Case:
    """Files by their names in a folder, a command run there, and which of them is the bad one.

    ``gate`` is whether status 1 is an answer of the command, not a failure.
    """

    kind: str
    number: int
    files: Mapping[str, bytes]
    command: tuple[str, ...]
    bad: str
    gate: bool = False


Make = Callable[[Random, int], Case]


def _pick(number: int, ways: Sequence[Callable[[], bytes]]) -> bytes:
    return ways[number % len(ways)]()


def text_table(draw: Random, number: int) -> Case:
    """A text table, spoilt or made at random."""
    ways = [
        lambda: spoil_encoding(samples.comma_text(), draw),
        lambda: spoil_encoding(samples.semicolon_text(), draw),
        lambda: random_csv(draw),
    ]
    rig = samples.PLAIN_RIG if number % 3 != 1 else samples.PLAIN_RIG + 'decimal = ","\n'
    return _table("text table", number, "a.csv", _pick(number, ways), rig)


def _table(kind: str, number: int, name: str, data: bytes, rig: str = samples.PLAIN_RIG) -> Case:
    return Case(kind, number, {name: data, "rig.toml": rig.encode()}, (IMPORT[0], name, *IMPORT[1:]), name)


def _binary_table(kind: str, names: Sequence[str]) -> Make:
    def make(draw: Random, number: int) -> Case:
        name = names[number % len(names)]
        inside = {"a.xlsx": spoil_zip, "packed.mat": spoil_mat}.get(name, spoil_bytes)
        spoil = inside if number // 2 % 2 else spoil_bytes
        return _table(kind, number, name, spoil(samples.tables()[name], draw))

    return make


def bag(draw: Random, number: int) -> Case:
    """A ROS 2 bag of either storage: its file, inside of it, or its description."""
    storage = ("mcap", "sqlite3")[number % 2]
    files = dict(samples.bags()[storage])
    data = next(name for name in files if name != "metadata.yaml")
    what = number // 2 % 3
    if what == 0:
        files[data] = spoil_bytes(files[data], draw)
    elif what == 1:
        files[data] = (spoil_mcap if storage == "mcap" else spoil_database)(files[data], draw)
    else:
        files["metadata.yaml"] = spoil_encoding(files["metadata.yaml"].decode(), draw)
    inside = {f"bag/{name}": content for name, content in files.items()}
    command = (IMPORT[0], "bag", *IMPORT[1:])
    return Case("ROS 2 bag", number, {**inside, "rig.toml": samples.BAG_RIG.encode()}, command, "bag")


RECORDING_COMMANDS: tuple[tuple[str, ...], ...] = (
    ("info", "a.mcap"),
    ("recover", "a.mcap", "-o", "out.mcap"),
    ("export", "a.mcap", "-o", "out.csv"),
    ("info", "a.mcap", "--json", "out.json"),
    ("recover", "a.mcap", "--keep-doubtful", "-o", "out.mcap"),
    ("export", "a.mcap", "-o", "out.xlsx"),
    ("list", "."),
    ("export", "a.mcap", "-o", "out.mat"),
    ("export", "a.mcap", "-o", "out.parquet"),
    ("export", "a.mcap", "-o", "out.rosbag2"),
    ("report", "a.mcap", "-o", "out.html"),
    ("verify", "a.mcap", "--model", "fit.json"),
    ("fit", "a.mcap"),
)


def recording(draw: Random, number: int) -> Case:
    """A recording, spoilt outside or inside with every checksum right."""
    whole = samples.recordings()[("imported", "run")[number // 2 % 2]]
    data = (spoil_mcap if number % 3 else spoil_bytes)(whole, draw)
    command = RECORDING_COMMANDS[number % len(RECORDING_COMMANDS)]
    files = {"a.mcap": data, "fit.json": json.dumps(samples.results()["fit"]).encode()}
    return Case("recording", number, files, command, "a.mcap", gate=command[0] == "verify")


def _document(text: str, tree: Any, write: Callable[[Any], str], draw: Random, number: int) -> bytes:
    if number % 2:
        return write(spoil_tree(tree, draw)).encode("utf-8", "surrogatepass")
    return spoil_encoding(text, draw)


def _toml(tree: Any) -> str:
    try:
        return to_toml(_without_none(tree))
    except (TypeError, AttributeError, RecursionError):
        return "a = [" * 50


def _without_none(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {str(key): _without_none(value) for key, value in tree.items() if value is not None}
    return [_without_none(one) for one in tree if one is not None] if isinstance(tree, list) else tree


def _parse(text: str) -> Any:
    import tomllib

    return tomllib.loads(text)


def rig(draw: Random, number: int) -> Case:
    """A rig file, spoilt, changed key by key, or made at random."""
    if number % 5 == 4:
        data = random_toml(draw, samples.RIG)
    else:
        data = _document(samples.RIG, _parse(samples.RIG), _toml, draw, number)
    files = {"a.csv": samples.comma_text().encode(), "rig.toml": data}
    return Case("rig file", number, files, (IMPORT[0], "a.csv", *IMPORT[1:]), "rig.toml")


def experiment(draw: Random, number: int) -> Case:
    """An experiment file, or the table that drives one of its steps."""
    table = samples.input_text().encode()
    text: bytes = samples.EXPERIMENT.encode()
    bad = "e.toml"
    if number % 5 == 3:
        table, bad = spoil_encoding(samples.input_text(), draw), "input.csv"
    elif number % 5 == 4:
        text = random_toml(draw, samples.EXPERIMENT)
    else:
        text = _document(samples.EXPERIMENT, _parse(samples.EXPERIMENT), _toml, draw, number)
    files = {"e.toml": text, "rig.toml": samples.RIG.encode(), "input.csv": table}
    return Case("experiment file", number, files, ("run", "e.toml", "--dry-run"), bad)


def result(draw: Random, number: int) -> Case:
    """The JSON of a fit or a diagnosis, as a result to show, to list, or as a model."""
    what = ("fit", "diagnosis")[number // 2 % 2]
    tree = samples.results()[what]
    if number % 7 == 6:
        data = random_json(draw, tree)
    else:
        data = _document(json.dumps(tree), tree, json.dumps, draw, number)
    command = (
        ("report", "r.json", "-o", "out.html"),
        ("list", "."),
        ("verify", "a.mcap", "--model", "r.json"),
        ("list", ".", "--json", "out.json"),
    )[number % 4]
    files = {"r.json": data}
    if command[0] == "verify":
        files["a.mcap"] = samples.whole_recording()
    return Case("result file", number, files, command, "r.json", gate=command[0] == "verify")


def model(draw: Random, number: int) -> Case:
    """A file that a rig file names: a MuJoCo file, a URDF file, an FMU, a force map, or an arm's links."""
    kind = number % 5
    table = {"a.csv": samples.comma_text().encode()}
    command = (IMPORT[0], "a.csv", *IMPORT[1:])
    if kind <= 1:
        text = (samples.ARM, samples.URDF)[kind]
        line = '\ninputs = { servo_angle = "ball_position" }' if kind else ""
        rig_text = f'[model]\nmujoco = "arm.xml"{line}\n'
        files = {"arm.xml": spoil_encoding(text, draw), "rig.toml": rig_text.encode()}
        return Case("MuJoCo or URDF file", number, {**table, **files}, command, "arm.xml")
    if kind == 2:
        fmu_file = samples.fmu()
        rig_text = '[model]\nfmu = "a.fmu"\n'
        data = b"" if fmu_file is None else (spoil_zip if number % 3 else _spoil_ends)(fmu_file, draw)
        return Case("FMU", number, {**table, "a.fmu": data, "rig.toml": rig_text.encode()}, command, "a.fmu")
    if kind == 3:
        files = {"map.csv": spoil_encoding(samples.FORCES, draw)}
        return _fit_case("force map", number, "solenoid", 'force_map = "map.csv"', files)
    data = _document(samples.LINKS, _parse(samples.LINKS), _toml, draw, number)
    return _fit_case("links of an arm", number, "ur5", 'links = "links.toml"', {"links.toml": data})


def _fit_case(kind: str, number: int, rig: str, known: str, files: dict[str, bytes]) -> Case:
    own = f'[rig]\nkind = "{rig}"\n[known]\n{known}\n'
    command = ("fit", "a.mcap", "--rig", "rig.toml", "--terms", "viscous_friction", "--estimator", "nlse")
    given = {"a.mcap": samples.fittable()[rig], "rig.toml": own.encode()}
    return Case(kind, number, {**given, **files}, (*command, "--holdout", "0"), next(iter(files)))


def _spoil_ends(data: bytes, draw: Random) -> bytes:
    """Bytes of a ZIP file's own lists spoilt, not those of the code in it, which is run as it is."""
    end = 400
    return data[:-end] + spoil_bytes(data[-end:], draw)


SHARES: tuple[tuple[Make, int], ...] = (
    (recording, 26),
    (text_table, 15),
    (_binary_table("workbook (XLSX)", ("a.xlsx",)), 7),
    (_binary_table("Parquet", ("plain.parquet", "packed.parquet")), 7),
    (_binary_table("MAT 4, 5", ("four.mat", "five.mat", "packed.mat", "packed.mat")), 9),
    (_binary_table("MAT 7.3 (HDF5)", ("seven.mat",)), 5),
    (bag, 8),
    (rig, 8),
    (experiment, 6),
    (result, 5),
    (model, 4),
)
"""Which cases are made, and how many of a hundred."""


def make_cases(count: int, seed: int) -> list[Callable[[], Case]]:
    """Return about ``count`` cases as functions that make them; each has a seed of its own."""
    return [
        partial(_make, make, f"{seed}/{place}/{number}", number)
        for place, (make, share) in enumerate(SHARES)
        for number in range(round(count * share / 100))
    ]


def _make(make: Make, seed: str, number: int) -> Case:
    return make(Random(seed), number)
