"""What may be missing: extras by wing, and the one message that names them."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

from labhil.cli import main
from labhil.errors import MissingExtraError
from labhil.extras import PACKAGES, load_optional, missing_extra, require

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]
RECORDING = str(ROOT / "recordings" / "ball_beam_identify.mcap")
FIT = str(ROOT / "examples" / "fit.json")


def name_of(requirement: str) -> str:
    """The package of a requirement, as indexes write it."""
    return requirement.partition(">")[0].partition("=")[0].strip().replace("_", "-").lower()


@pytest.mark.extended
@pytest.mark.parametrize("module", PACKAGES)
def test_every_optional_package_is_in_the_extra_that_is_named(module: str) -> None:
    package = PACKAGES[module]
    assert name_of(package.name) in {name_of(each) for each in EXTRAS[package.extra]}
    brought_by = {name_of(each) for each in packages_distributions().get(module, [package.name])}
    assert name_of(package.name) in brought_by


def test_all_extras_are_together_in_one() -> None:
    (everything,) = EXTRAS["all"]
    named = everything.removeprefix("labhil[").removesuffix("]").split(",")
    assert sorted(named) == sorted(EXTRAS.keys() - {"all", "docs", "test"})


def test_the_demo_needs_no_extra_and_a_laptop_gets_no_robot_client() -> None:
    needed = {name_of(each) for each in PROJECT["dependencies"]}
    wings = {name_of(each) for wing in ("acquisition", "analysis", "plots") for each in EXTRAS[wing]}
    assert wings <= needed
    assert needed.isdisjoint({"ur-rtde", "statsmodels", "pandas", "mujoco"})


def test_a_robot_client_is_asked_for_only_where_it_has_wheels() -> None:
    for extra in ("ur5", "test"):
        (requirement,) = [each for each in EXTRAS[extra] if name_of(each) == "ur-rtde"]
        marker = requirement.partition("; ")[2]
        assert marker == (
            "python_version < '3.13' and sys_platform == 'linux' and platform_machine == 'x86_64'"
        )


def slim() -> dict[str, Any]:
    """What labhil-slim says of itself, from its build hook."""
    pytest.importorskip("hatchling")
    spec = spec_from_file_location("hatch_build", ROOT / "slim" / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    hook = module_from_spec(spec)
    spec.loader.exec_module(hook)
    said: dict[str, Any] = hook.metadata_of(PROJECT)
    return said


def test_a_slim_installation_needs_no_compiler_no_plots_and_no_bus() -> None:
    told = slim()
    needed = {name_of(each) for each in told["dependencies"]}
    assert needed == {"lz4", "mcap", "numpy", "protobuf", "pydantic", "rich", "typer", "zstandard"}
    wings = [each for wing in ("acquisition", "analysis", "plots", "tui") for each in EXTRAS[wing]]
    assert {*told["dependencies"], *wings} == set(PROJECT["dependencies"])
    assert told["entry-points"] == PROJECT["entry-points"]
    assert told["version"] == PROJECT["version"]
    assert told["optional-dependencies"]["all"][0].startswith("labhil-slim[")


def test_what_no_extra_brings_is_no_matter_of_extras() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        load_optional("no_such_module", "this")
    assert missing_extra(ModuleNotFoundError("no", name="no_such_module"), "this") is None


def test_a_note_says_what_else_one_has_to_know(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rtde_control", None)
    with pytest.raises(MissingExtraError, match=r"commanding .*'labhil\[ur5\]' \(it has wheels for Linux"):
        require("rtde_control", "commanding a UR arm")


@pytest.mark.extended
@pytest.mark.parametrize(
    ("missing", "arguments", "extra"),
    [
        ("numba", ("fit", RECORDING), "analysis"),
        ("scipy", ("diagnose", RECORDING), "analysis"),
        ("matplotlib", ("fit", RECORDING, "--plot", "fit.png"), "plots"),
        ("matplotlib", ("report", RECORDING, "-o", "page.html"), "plots"),
        ("textual", ("tui",), "tui"),
        ("cobs", ("run", str(ROOT / "recordings" / "ball_beam_identify.toml")), "acquisition"),
    ],
)
def test_a_command_names_the_extra_that_it_lacks(
    tmp_path: Path, missing: str, arguments: tuple[str, ...], extra: str
) -> None:
    """In a process in which the package cannot be imported, as where it is not installed."""
    code = f"import sys\nsys.modules[{missing!r}] = None\nfrom labhil.cli import main\nmain()\n"
    command = [sys.executable, "-P", "-c", code, *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert f"needs the package {PACKAGES[missing].name!r}, which is not installed" in done.stderr
    assert f"pip install 'labhil[{extra}]'" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.extended
@pytest.mark.parametrize(
    ("missing", "call", "extra"),
    [
        ("numba", f"lh.fit({RECORDING!r})", "analysis"),
        ("scipy", f"lh.diagnose({RECORDING!r})", "analysis"),
        ("numba", "lh.model('ball_beam').terms", "analysis"),
        ("numba", f"lh.load({FIT!r}).simulate({RECORDING!r})", "analysis"),
        ("scipy", f"lh.verify({RECORDING!r}, {FIT!r})", "analysis"),
        ("matplotlib", f"lh.read({RECORDING!r}).plot()", "plots"),
        ("matplotlib", f"lh.load({FIT!r}).plot_intervals()", "plots"),
    ],
)
def test_python_names_the_extra_that_it_lacks(tmp_path: Path, missing: str, call: str, extra: str) -> None:
    """An error of the tree, where the package cannot be imported."""
    code = (
        f"import sys\nsys.modules[{missing!r}] = None\nimport labhil as lh\n"
        f"try:\n    {call}\nexcept lh.errors.MissingExtraError as error:\n    print(error)\n"
    )
    command = [sys.executable, "-P", "-c", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (
        f"needs the package {missing!r}, which is not installed: pip install 'labhil[{extra}]'" in done.stdout
    )


def test_another_module_that_is_missing_is_a_fault_and_shown_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "labhil.recording.export", None)
    monkeypatch.setattr("sys.argv", ["labhil", "export", RECORDING, "-o", "x.csv"])
    with pytest.raises(ModuleNotFoundError, match=r"labhil\.recording\.export"):
        main()
