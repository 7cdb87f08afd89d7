"""The rules of the house: style, types, which room may import which, and what a process loads."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]
SCRIPTS = Path(sys.executable).parent

CHECKS = {
    "ruff check": [SCRIPTS / "ruff", "check", "."],
    "ruff format": [SCRIPTS / "ruff", "format", "--check", "."],
    "mypy": [SCRIPTS / "mypy"],
    "import-linter": [SCRIPTS / "lint-imports", "--no-cache"],
}
BENCHMARKS = ROOT / "benchmarks"

ANALYSIS = ("numba", "scipy.optimize", "matplotlib", "statsmodels")
ACQUISITION = ("zenoh", "serial", "labhil.bus", "labhil.service", "labhil.experiment", "labhil.plants")


@pytest.mark.extended
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.extended if name == "mypy" else ()) for name in CHECKS]
)
@pytest.mark.timeout(300)
def test_the_tree_is_in_order(name: str) -> None:
    command = [str(part) for part in CHECKS[name]]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{name}:\n{done.stdout}{done.stderr}"


def test_benchmarks_stand_above_what_they_measure() -> None:
    command = [str(SCRIPTS / "lint-imports"), "--no-cache"]
    done = subprocess.run(command, cwd=BENCHMARKS, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"


def test_a_page_says_which_command_made_every_figure() -> None:
    page = (BENCHMARKS / "README.md").read_text(encoding="utf-8")
    results = sorted(path for path in (BENCHMARKS / "results").rglob("*.json"))
    assert results
    assert [path.name for path in results if path.name not in page] == []
    scripts = sorted((BENCHMARKS / "measuring").glob("measure_*.py"))
    assert scripts
    assert [path.name for path in scripts if path.name not in page] == []


def test_no_benchmark_is_part_of_an_installation(tmp_path: Path) -> None:
    assert "ModuleNotFoundError" in isolated("import labhil_benchmarks", tmp_path).stderr


def test_the_hook_before_a_commit_makes_these_checks() -> None:
    hooks = YAML(typ="safe").load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    entries = [hook["entry"] for repository in hooks["repos"] for hook in repository["hooks"]]
    commands = [[f".venv/bin/{Path(tool).name}", *options] for tool, *options in CHECKS.values()]
    of_benchmarks = "sh -c 'cd benchmarks && ../.venv/bin/lint-imports --no-cache'"
    assert entries == [*(" ".join(command) for command in commands), of_benchmarks]


def test_nothing_called_drivers_lands_in_an_installation(tmp_path: Path) -> None:
    for name in ("drivers", "sim_drivers"):
        done = isolated(f"import {name}", tmp_path)
        assert "ModuleNotFoundError" in done.stderr


@pytest.mark.extended
def test_a_run_plan_loads_nothing_of_the_analysis(tmp_path: Path) -> None:
    code = (
        "import labhil.experiment.run, labhil.experiment.show\n"
        "from importlib.resources import files\n"
        "from labhil.experiment.experiment import load_experiment\n"
        "from labhil.experiment.plan import make_plan\n"
        "make_plan(load_experiment(files('labhil.experiment') / 'examples' / 'three_rigs.toml'))\n"
    )
    assert loaded(code, ANALYSIS, tmp_path) == []


def test_a_host_loads_nothing_of_the_analysis(tmp_path: Path) -> None:
    code = (
        "import labhil.service.host, labhil.plugins\n"
        "for name in ('ball_beam', 'dc_motor', 'solenoid'):\n    labhil.plugins.load_driver(name)\n"
    )
    assert loaded(code, ANALYSIS, tmp_path) == []


@pytest.mark.extended
def test_the_analysis_loads_no_bus_and_no_device(tmp_path: Path) -> None:
    rooms = ("recording", "physics", "identify", "diagnose", "analysis", "report")
    names = [name for room in rooms for name in modules_of(f"labhil.{room}")]
    assert loaded(f"import {', '.join(names)}", ACQUISITION, tmp_path) == []


@pytest.mark.extended
def test_neither_a_run_nor_a_fit_loads_the_terminal_ui(tmp_path: Path) -> None:
    code = (
        "import labhil.experiment.run, labhil.experiment.show, labhil.service.host, labhil.analysis.study\n"
        "import labhil.report.text, labhil.commands.acquisition, labhil.commands.analysis\n"
        "import labhil.commands.tui\n"
    )
    assert loaded(code, ("textual", "labhil.tui.app"), tmp_path) == []


@pytest.mark.extended
def test_the_screen_loads_nothing_that_works_for_it_elsewhere(tmp_path: Path) -> None:
    assert loaded("import labhil.tui.main", (*ANALYSIS, "labhil.experiment.run"), tmp_path) == []


def test_what_works_for_the_screen_loads_no_screen(tmp_path: Path) -> None:
    code = "import labhil.tui.run_process, labhil.campaign.studies.study, labhil.campaign.studies.curves\n"
    assert loaded(code, ("textual",), tmp_path) == []


def test_the_command_line_itself_loads_neither(tmp_path: Path) -> None:
    assert (
        loaded("import labhil.cli, labhil.command_line", (*ANALYSIS, *ACQUISITION, "numpy"), tmp_path) == []
    )


def test_importing_labhil_loads_nothing_of_either_wing(tmp_path: Path) -> None:
    suspects = (*ANALYSIS, *ACQUISITION, "numpy", "pydantic", "rich", "pandas")
    assert loaded("import labhil as lh\nassert 'fit' in dir(lh)", suspects, tmp_path) == []


@pytest.mark.extended
def test_acquiring_from_python_loads_no_analysis_and_reading_no_device(tmp_path: Path) -> None:
    code = "import labhil as lh\nlh.connect('dc_motor', 'twin')\nlh.run, lh.Experiment, lh.read"
    assert loaded(code, ANALYSIS, tmp_path) == []
    recording = ROOT / "recordings" / "ball_beam_test.mcap"
    code = f"import labhil as lh\nlh.read({str(recording)!r})['ball_position']\nlh.fit, lh.diagnose, lh.load"
    assert loaded(code, (*ACQUISITION, "numba", "matplotlib"), tmp_path) == []


def test_names_of_plugins_are_listed_without_importing_them(tmp_path: Path) -> None:
    code = "import labhil.plugins as p\nassert p.names(p.DRIVERS) and p.names(p.TWINS)\n"
    assert loaded(code, ("labhil_ball_beam", "labhil_sim_ball_beam"), tmp_path) == []


def modules_of(package: str) -> list[str]:
    """Return the names of a package and the modules in it, without importing them."""
    spec = importlib.util.find_spec(package)
    assert spec is not None
    directories = [Path(place) for place in spec.submodule_search_locations or []]
    files = sorted(file for directory in directories for file in directory.glob("*.py"))
    return [package, *(f"{package}.{file.stem}" for file in files if file.stem != "__init__")]


def loaded(code: str, suspects: tuple[str, ...], directory: Path) -> list[str]:
    """Run code in a process of its own; return which of the suspects it loaded."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", f"{code}\nimport sys\nprint(*sorted(sys.modules), sep='\\n')"],
        cwd=directory,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [name for name in done.stdout.split() if name in suspects]


def isolated(code: str, directory: Path) -> subprocess.CompletedProcess[str]:
    """Run code with nothing on the path but what is installed."""
    command = [sys.executable, "-I", "-c", code]
    return subprocess.run(command, cwd=directory, capture_output=True, text=True, check=False)


@pytest.mark.extended
def test_everything_that_is_printed_goes_through_the_one_way_out() -> None:
    printed = []
    for path in [
        file for room in ("labhil", "drivers", "sim_drivers") for file in (ROOT / room).rglob("*.py")
    ]:
        if path == ROOT / "labhil" / "terminal.py":
            continue
        calls = [
            node
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Call)
        ]
        names = [(call.lineno, call.func.id) for call in calls if isinstance(call.func, ast.Name)]
        printed += [f"{path.relative_to(ROOT)}:{line}" for line, name in names if name == "print"]
    assert not printed, "expected labhil.terminal's show or complain, found print( in " + ", ".join(printed)
