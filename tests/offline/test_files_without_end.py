"""Files that have no end, say too much, or are larger than they look: refused, and soon."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import labhil as lh
from labhil import documents
from labhil.analysis.patch_source import read_patch_source
from labhil.analysis.schema import any_result_of
from labhil.documents import LARGEST, DocumentError, parse_toml, read_document
from labhil.errors import (
    ExperimentFileError,
    LabhilError,
    ModelFileError,
    TableError,
    UsageError,
)
from labhil.experiment.experiment import load_experiment
from labhil.experiment.plan import make_plan
from labhil.physics.terms import unkeyed
from labhil.recording import read_recording
from labhil.recording.recover import recover
from labhil.recording.tables import import_table
from labhil.report.html.report import report_page
from labhil.rig import load_rig, parse_rig
from labhil.simulators.fmu_file import FmuFile

ENDLESS = Path("/dev/zero")
RIG = parse_rig('[rig]\nkind = "ball_beam"\n', Path("rig.toml"))
FIT = json.loads(
    (Path(__file__).parents[1] / "tui" / "results" / "ball_beam_identify.fit.json").read_text(
        encoding="utf-8"
    )
)
ARM = """<mujoco model="rod"><option timestep="0.001"/><worldbody><body>
<joint name="hinge" axis="0 1 0"/><inertial pos="0 0 -0.1" mass="0.4" diaginertia="0.01 0.01 1e-3"/></body>
</worldbody><actuator><motor name="motor" joint="hinge" gear="1"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    "read",
    [
        load_rig,
        load_experiment,
        read_recording,
        report_page,
        lh.load,
        lambda path: import_table(path, RIG),
        lambda path: recover(path, Path("out.mcap")),
    ],
)
def test_a_device_without_an_end_is_no_file(read: object) -> None:
    assert callable(read)
    with pytest.raises(LabhilError, match="/dev/zero"):
        read(ENDLESS)


def test_an_experiment_that_names_a_device_without_an_end_is_refused(tmp_path: Path) -> None:
    text = (
        '[experiment]\nname = "a"\n[devices.bench]\nplugin = "ball_beam"\naddress = "twin"\n[[steps]]\n'
        'device = "bench"\nsignal = "servo_angle"\nexcitation = "file"\npath = "/dev/zero"\nduration = 1.0\n'
    )
    (tmp_path / "e.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ExperimentFileError, match="/dev/zero cannot be read"):
        make_plan(load_experiment(tmp_path / "e.toml"))


def test_a_document_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"#" * LARGEST)
    assert len(read_document(path)) == LARGEST
    path.write_bytes(b"#" * (LARGEST + 1))
    with pytest.raises(DocumentError, match=f"at most {LARGEST} bytes"):
        read_document(path)


@pytest.mark.parametrize(
    "text", ["{0} = 1", "[{0}]", "[[ {0} ]]", "a = {{ {0} = 1 }}", "a = {{b = 1, {0} = 1}}"]
)
def test_a_key_with_too_many_dots_is_refused_before_it_is_parsed(
    text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    dotted = ".".join(["a"] * 60)
    assert parse_toml(text.format(dotted))
    assert parse_toml(f'a = "{dotted}.{dotted}"\nb = """\n..\n"""')
    monkeypatch.setattr(documents.tomllib, "loads", lambda text: pytest.fail("it was parsed"))
    for part in ("a", '"a b"', "'a'", "a "):
        with pytest.raises(DocumentError, match="at most 64 levels"):
            parse_toml(text.format(".".join([part] * 20_000)))


def test_a_field_that_is_longer_than_fields_are_is_no_traceback(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text('t,servo_angle,ball_position\n1,2,"' + "9" * 200_000 + '"\n', encoding="utf-8")
    with pytest.raises(TableError, match="field larger than field limit"):
        import_table(path, RIG)


@pytest.mark.parametrize("change", [{"estimator": "a" * 5000}, {"parameters": FIT["parameters"] * 1000}])
def test_a_result_of_a_size_that_none_has_is_refused(change: dict[str, object]) -> None:
    assert any_result_of(FIT, "fit.json")
    with pytest.raises(ModelFileError, match="at most"):
        any_result_of({**FIT, **change}, "fit.json")


def test_a_long_name_is_cut_in_pictures(tmp_path: Path) -> None:
    rows = [{**row, "name": "a" * 4000} for row in FIT["parameters"]]
    (tmp_path / "a.json").write_text(json.dumps({**FIT, "parameters": rows}), encoding="utf-8")
    page = str(report_page(tmp_path / "a.json"))
    assert "a" * 72 + "…" in page


def test_a_term_that_is_no_name_stays_what_it_is() -> None:
    assert unkeyed("payload[3]") == ("payload", 3)
    for name in ("payload", "[red]a[/nope]", "a[", "a[1", "a[" + "9" * 5000 + "]"):
        assert unkeyed(name)[0] in (name, "a")


def test_json_that_is_nested_too_deeply_is_no_result_to_patch_from(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[" * 100_000, encoding="utf-8")
    with pytest.raises(ModelFileError, match="at most 64 levels"):
        read_patch_source(tmp_path / "a.json")


@pytest.mark.extended
def test_readers_work_under_a_limit_of_memory_set_for_good(tmp_path: Path) -> None:
    """`ulimit -v` is a bound that a process cannot lift again."""
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"t": [[0.0], [1.0], [2.0]]})
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))\n"
        "from labhil.recording.formats import isolated\n"
        "from labhil.rig_sections import Table\n"
        "from pathlib import Path\n"
        "limits = isolated.ReaderLimits(memory=8 << 30)\n"
        "print(len(isolated.read_isolated('mat', Path('a.mat'), Table(), (), limits).lines))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.stdout.strip(), done.stderr) == ("3", "")


@pytest.mark.extended
@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "</worldbody>",
            '<replicate count="30000" offset="1 0 0"><geom size="1"/></replicate></worldbody>',
            "takes (more|longer) than",
        ),
    ],
)
def test_a_mujoco_file_that_is_out_of_proportion_is_refused(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    assert lh.mujoco_simulator(tmp_path / "arm.xml").inputs == {"motor": "N·m"}
    (tmp_path / "arm.xml").write_text(ARM.replace(old, new), encoding="utf-8")
    with pytest.raises(UsageError, match=expected):
        lh.model(lh.mujoco_simulator(tmp_path / "arm.xml"))
    assert [path.name for path in tmp_path.iterdir()] == ["arm.xml"], "MuJoCo writes a log elsewhere"


def test_an_fmu_that_unpacks_to_too_much_is_never_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.fmu", "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("resources/zeros", bytes(60_000_000))
    with pytest.raises(UsageError, match="the FMU claims 60000000 bytes"):
        FmuFile(tmp_path / "a.fmu")


@pytest.mark.extended
@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('timestep="0.001"', 'timestep="1e-300"', 'timestep="1e-300"'),
        ('gear="1"', 'gear="inf"', "expected a simulator with finite accelerations"),
    ],
)
def test_a_mujoco_file_that_cannot_be_calculated_with_is_refused(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(ARM.replace(old, new), encoding="utf-8")
    t = np.arange(400) / 100.0
    with pytest.raises(UsageError, match=expected):
        lh.fit(lh.recording(t, {"motor": np.sin(t)}, {"hinge": np.cos(t)}, rig=path), rig=path)
