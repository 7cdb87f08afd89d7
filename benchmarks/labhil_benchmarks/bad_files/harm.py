"""Files that were written to harm: bombs in every container, paths that lead astray, names that steer."""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from io import BytesIO
from typing import Any

from labhil_benchmarks.bad_files import samples
from labhil_benchmarks.bad_files.bombs import (
    PROFILE_ROS2,
    ZEROS,
    cells,
    endless_view,
    hdf5_bomb,
    hdf5_links,
    laughs,
    lying_zip,
    mat,
    matrix,
    mcap_of,
    nested_chunks,
    packed_into,
    parquet_bomb,
    wide_sheet,
)
from labhil_benchmarks.bad_files.inside import CHANNEL, chunk, record, rename_device
from labhil_benchmarks.bad_files.kinds import IMPORT, RECORDING_COMMANDS, Case
from labhil_benchmarks.bad_files.spoil import CONTROLS, TEXTS

NAMES = (
    CONTROLS.replace("\x00", ""),
    "[red]a[/nope]",
    "<script>alert(1)</script>",
    "a" * 60_000,
    "../../outside",
)

Files = Mapping[str, bytes]


def harmful_cases() -> list[Callable[[], Case]]:
    """Return the cases as functions that make them."""
    ways = (_recordings, _tables, _bags, _documents, _simulators, _names)
    makers = [maker for way in ways for maker in way()]
    return [partial(_numbered_case, number, make) for number, make in enumerate(makers)]


def _numbered_case(number: int, make: Callable[[], Made]) -> Case:
    return Case("made to harm", number, *make())


Content = bytes | Callable[[], bytes]
Made = tuple[Files, tuple[str, ...], str]


def _case(files: Mapping[str, Content], command: tuple[str, ...], bad: str) -> Callable[[], Made]:
    """A case whose large files are made when it is its turn."""

    def make() -> Made:
        return (
            {name: content if isinstance(content, bytes) else content() for name, content in files.items()},
            command,
            bad,
        )

    return make


def _import_case(name: str, content: Content, rig: str = samples.PLAIN_RIG) -> Callable[[], Made]:
    return _case({name: content, "rig.toml": rig.encode()}, (IMPORT[0], name, *IMPORT[1:]), name)


def _recordings() -> Iterator[Callable[[], Made]]:
    for packing in ("zstd", "lz4"):
        for claimed in (None, 1000, 2**40):
            bomb = partial(_chunk_of, ZEROS, packing, claimed)
            for command in RECORDING_COMMANDS[:3]:
                yield _case({"a.mcap": bomb}, command, "a.mcap")
    tiny = record(CHANNEL, bytes(16)) * 2_000_000
    many = b"".join(record(CHANNEL, struct.pack("<HHIII", k, 0, 0, 0, 0)) for k in range(60_000))
    for inside in (tiny, many):
        for command in RECORDING_COMMANDS[:3]:
            yield _case({"a.mcap": partial(_chunk_of, inside, "zstd", None)}, command, "a.mcap")
    fit = json.dumps(samples.results()["fit"]).encode()
    for command in RECORDING_COMMANDS:
        yield _case({"a.mcap": nested_chunks, "fit.json": fit}, command, "a.mcap")


def _chunk_of(content: bytes, packing: str, claimed: int | None) -> bytes:
    return mcap_of(chunk(content, packing, claimed))


TEXT_TABLES: tuple[Callable[[], bytes], ...] = (
    lambda: b"t,servo_angle,ball_position\n" + b"1," * 10_000_000,
    lambda: b't,servo_angle,ball_position\n1,2,"' + b"9" * 3_000_000 + b'"\n',
    lambda: b't,servo_angle,ball_position\n"' + b'","' * 1_000_000 + b'"\n',
    lambda: b"t,servo_angle,ball_position\n" + b",\n" * 3_000_000,
    lambda: b"\xff\xfe" + b"\x00" * 10_000_000,
    lambda: b" " * 20_000_000 + b"1",
    lambda: b"9" * 5_000_000 + b"\n" + b"1.2.3" * 1_000_000,
    lambda: b"t servo_angle ball_position\n" + b"1 2 3\n" * 3_000_000,
    lambda: b"t,servo_angle,ball_position\n" + b"(" * 1_000_000 + b",1,2\n",
)


def _tables() -> Iterator[Callable[[], Made]]:
    for text in TEXT_TABLES:
        yield _import_case("a.csv", text)
    workbook = samples.tables()["a.xlsx"]
    for name in ("xl/sharedStrings.xml", "xl/worksheets/sheet1.xml", "xl/styles.xml", "more.xml"):
        yield _import_case("a.xlsx", partial(packed_into, workbook, {name: ZEROS}))
        yield _import_case("a.xlsx", partial(packed_into, workbook, {name: laughs("sst")}))
    yield _import_case("a.xlsx", wide_sheet)
    yield _import_case("a.xlsx", lambda: lying_zip(workbook))
    yield _import_case("a.mat", lambda: mat(zlib.compress(struct.pack("<II", 14, len(ZEROS)) + ZEROS)))
    yield _import_case("a.mat", lambda: mat(zlib.compress(matrix(2**31 - 1, 2**31 - 1))))
    yield _import_case("a.mat", lambda: mat(zlib.compress(matrix(30_000, 1000) + ZEROS[:240_000_000])))
    yield _import_case("a.mat", lambda: mat(cells(5000)))
    yield _import_case("a.h5", hdf5_bomb)
    yield _import_case("b.h5", hdf5_links)
    yield _import_case("a.parquet", parquet_bomb)


def _bags() -> Iterator[Callable[[], Made]]:
    def case(storage: str, change: Callable[[dict[str, bytes], str], None]) -> Callable[[], Made]:
        def make() -> Made:
            files = dict(samples.bags()[storage])
            change(files, next(name for name in files if name != "metadata.yaml"))
            inside = {f"bag/{name}": content for name, content in files.items()}
            return {**inside, "rig.toml": samples.BAG_RIG.encode()}, (IMPORT[0], "bag", *IMPORT[1:]), "bag"

        return make

    def packed_file(files: dict[str, bytes], data: str) -> None:
        import zstandard

        files[data] = zstandard.ZstdCompressor().compress(ZEROS)
        text = files["metadata.yaml"].decode()
        text = text.replace("compression_format: ''", "compression_format: zstd")
        text = text.replace('compression_format: ""', "compression_format: zstd")
        text = text.replace("compression_mode: ''", "compression_mode: FILE")
        files["metadata.yaml"] = text.replace('compression_mode: ""', "compression_mode: FILE").encode()

    def laughs(files: dict[str, bytes], _: str) -> None:
        lines = ["a0: &a0 [x, x]"] + [f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]" for k in range(1, 40)]
        files["metadata.yaml"] = "\n".join(lines).encode() + b"\n" + files["metadata.yaml"]

    def nested(files: dict[str, bytes], _: str) -> None:
        files["metadata.yaml"] = b"[" * 100_000

    def away(files: dict[str, bytes], data: str) -> None:
        files["metadata.yaml"] = files["metadata.yaml"].replace(data.encode(), b"/dev/zero")

    def endless(files: dict[str, bytes], data: str) -> None:
        files[data] = endless_view(files[data])

    def bomb(files: dict[str, bytes], data: str) -> None:
        files[data] = mcap_of(chunk(ZEROS, "zstd"), PROFILE_ROS2)

    for storage in ("mcap", "sqlite3"):
        for change in (packed_file, laughs, nested, away):
            yield case(storage, change)
    yield case("sqlite3", endless)
    yield case("mcap", bomb)


TOML_TEXTS: tuple[Callable[[], bytes], ...] = (
    lambda: b"a = " + b"[" * 100_000,
    lambda: b"a = " + b"{a=" * 100_000,
    lambda: b".".join([b"a"] * 30_000) + b" = 1",
    lambda: b"[" + b".".join([b"a"] * 30_000) + b"]",
    lambda: b"a = {" + b'"a b" . ' * 30_000 + b"a = 1}",
    lambda: b"".join(b"[a%d]\n" % k for k in range(100_000)),
    lambda: b"a = [" + b"1," * 1_000_000 + b"]",
    lambda: b"a = " + b"9" * 1_000_000,
    lambda: b'a = "' + b"x" * 10_000_000 + b'"',
    lambda: b"a =" + b" " * 1_000_000,
    lambda: b"#" * 10_000_000,
    lambda: b"#" * 20_000_000,
)


def _documents() -> Iterator[Callable[[], Made]]:
    table = samples.comma_text().encode()
    rig = samples.RIG.encode()
    for text in TOML_TEXTS:
        yield _case({"a.csv": table, "rig.toml": text}, (IMPORT[0], "a.csv", *IMPORT[1:]), "rig.toml")
        yield _case({"e.toml": text}, ("run", "e.toml", "--dry-run"), "e.toml")
    for tree in _json_texts(samples.results()["fit"]):
        for command in (("report", "r.json", "-o", "out.html"), ("list", ".")):
            yield _case({"r.json": tree}, command, "r.json")
        into = ("patch", "r.json", "--into", "arm.xml", "-o", "out.xml")
        yield _case({"r.json": tree, "arm.xml": samples.ARM.encode()}, into, "r.json")
    for path in (text for text in TEXTS if text.startswith((".", "/"))):
        named = json.dumps(path)
        for rig_text in (
            f'[rig]\nkind = "solenoid"\n[known]\nforce_map = {named}\n',
            f'[rig]\nkind = "ur5"\n[known]\nlinks = {named}\n',
            f"[model]\nmujoco = {named}\n",
            f"[model]\nfmu = {named}\n",
        ):
            yield _import_case("rig.csv", table, rig_text)
        for old in ("rig.toml", "input.csv"):
            changed = samples.EXPERIMENT.replace(f'"{old}"', named).encode()
            files = {"e.toml": changed, "rig.toml": rig, "input.csv": b"1,2\n3,4\n"}
            yield _case(files, ("run", "e.toml", "--dry-run"), path)
        yield _case({"rig.toml": rig}, (IMPORT[0], path, *IMPORT[1:]), path)
        for what, *rest in (("info",), ("recover", "-o", "out.mcap"), ("report", "-o", "out.html")):
            yield _case({}, (what, path, *rest), path)


def _json_texts(fit: dict[str, Any]) -> Iterator[Callable[[], bytes]]:
    changes = (
        {"parameters": fit["parameters"] * 3000},
        {"covariance": [[1.0] * 1500] * 1500},
        {"terms": ["viscous_friction"] * 100_000},
        {"rig": "x" * 10_000_000},
        {"recordings": fit["recordings"] * 5000},
    )
    for change in changes:
        yield partial(lambda tree: json.dumps(tree).encode(), {**fit, **change})
    yield lambda: b"[" * 100_000
    yield lambda: b'{"a":' * 100_000
    yield lambda: json.dumps(fit)[:-1].encode() + b', "seconds": ' + b"9" * 5000 + b"}"
    yield lambda: b"1" * 1_000_000
    yield lambda: b"[" + b"[]," * 5_000_000 + b"[]]"
    yield lambda: b"[" + b"[]," * 50_000_000 + b"[]]"


def _simulators() -> Iterator[Callable[[], Made]]:
    deep = "<body>" * 20_000 + "</body>" * 20_000
    many = '<replicate count="1000000" offset="1 0 0"><geom size="1"/></replicate>'
    more = '<replicate count="1000"><replicate count="1000"><geom size="1"/></replicate></replicate>'
    behind, before = "</worldbody>", "<worldbody>"
    field = '<hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/>'
    texture = '<texture name="t" type="2d" builtin="flat" width="60000" height="60000"/>'
    cable = '<composite type="cable" count="100000 1 1" size="1"><geom size="0.1"/></composite>'
    changes = (
        (behind, f"{deep}{behind}"),
        (behind, f"{many}{behind}"),
        (behind, f"{more}{behind}"),
        (before, f'<size memory="100T"/>{before}'),
        (before, f"<asset>{field}</asset>{before}"),
        (before, f"<asset>{texture}</asset>{before}"),
        (before, f'<include file="/dev/zero"/>{before}'),
        (before, f'<include file="arm.xml"/>{before}'),
        (before, f'<asset><mesh name="m" file="/dev/zero"/></asset>{before}'),
        (before, f"<keyframe>{'<key/>' * 100_000}</keyframe>{before}"),
        ("</body>", f"{cable}</body>"),
        ('mass="0.4"', 'mass="1e308"'),
        ('timestep="0.001"', 'timestep="1e-300"'),
        ('gear="1"', 'gear="inf"'),
    )
    rig = '[model]\nmujoco = "arm.xml"\n'
    table = samples.comma_text().encode()
    files = [samples.ARM.replace(*change).encode() for change in changes]
    files += [laughs("mujoco"), ZEROS[:30_000_000], b"<mujoco>" + b"<a>" * 1_000_000]
    command = (IMPORT[0], "a.csv", *IMPORT[1:])
    for content in files:
        yield _case({"a.csv": table, "arm.xml": content, "rig.toml": rig.encode()}, command, "arm.xml")
    fmu_file = samples.fmu()
    if fmu_file is None:
        return
    away = {"../../../../outside": b"x", "resources/../../../x": b"x"}
    description = zipfile.ZipFile(BytesIO(fmu_file)).read("modelDescription.xml")
    foreign = b'<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><fmiModelDescription modelName="&b;"/>'
    parts: list[dict[str, bytes]] = [
        {"resources/zeros": ZEROS},
        {"modelDescription.xml": ZEROS},
        {"modelDescription.xml": laughs("fmiModelDescription")},
        {"modelDescription.xml": foreign},
        {"modelDescription.xml": description.replace(b"<ScalarVariable", b"<ScalarVariable " * 1, 1) * 2},
        *({name: content} for name, content in away.items()),
    ]
    rig_of_fmu = b'[model]\nfmu = "a.fmu"\n'
    for part in parts:
        fmu = partial(packed_into, fmu_file, part)
        yield _case({"a.csv": table, "a.fmu": fmu, "rig.toml": rig_of_fmu}, command, "a.fmu")


def _names() -> Iterator[Callable[[], Made]]:
    imported = samples.recordings()["imported"]
    report = ("report", "r.json", "-o", "out.html")
    for name in NAMES:
        header = f't,servo_angle,ball_position,"{name}"\n'
        rows = "".join(f"{k / 20},{k % 7},0.{k % 3},{name}\n" for k in range(60))
        yield _import_case("a.csv", (header + rows).encode())
        for command in RECORDING_COMMANDS[:11]:
            yield _case({"a.mcap": rename_device(imported, name)}, command, "a.mcap")
        for tree in samples.results().values():
            for place in ("rig", "estimator", "verdict"):
                yield _case({"r.json": json.dumps({**tree, place: name}).encode()}, report, "r.json")
            changed = json.dumps(_with_names(tree, name)).encode()
            for command in (report, ("list", ".")):
                yield _case({"r.json": changed}, command, "r.json")


def _with_names(tree: Any, name: str) -> Any:
    """The tree with a name for every text in it but its schema."""
    if isinstance(tree, dict):
        return {key: value if key == "schema" else _with_names(value, name) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_with_names(one, name) for one in tree]
    return name if isinstance(tree, str) else tree
