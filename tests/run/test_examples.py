"""The scripts and notebooks under examples/, and the code of docs/tutorials/python.md, run as they stand."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted(path.name for path in (ROOT / "examples").glob("*.py"))


COMPUTING = ("diagnose.py", "pendulum.py")
"""Scripts that fit for a minute."""
NOTEBOOKS = sorted(path.name for path in (ROOT / "examples" / "notebooks").glob("*.ipynb"))


def code_cells(name):
    """The cells of a notebook that hold code."""
    notebook = json.loads((ROOT / "examples" / "notebooks" / name).read_text(encoding="utf-8"))
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


@pytest.fixture
def folder(tmp_path):
    """A folder in which the shipped files stand where the scripts look for them."""
    for name in ("recordings", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def run(*arguments, folder):
    return subprocess.run(
        [sys.executable, "-P", *arguments], cwd=folder, capture_output=True, text=True, check=False
    )


def test_there_are_examples_and_the_readme_names_each():
    assert len(SCRIPTS) >= 3
    told = (ROOT / "examples" / "README.md").read_text(encoding="utf-8")
    assert all(f"[{name}]({name})" in told for name in SCRIPTS)


@pytest.mark.extended
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long if name in COMPUTING else ()) for name in SCRIPTS]
)
def test_the_script_runs(name, folder):
    done = run(f"examples/{name}", folder=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_is_named_and_has_no_outputs(name):
    assert f"[{name}](notebooks/{name})" in (ROOT / "examples" / "README.md").read_text(encoding="utf-8")
    cells = code_cells(name)
    assert cells
    assert [cell for cell in cells if cell["outputs"] or cell["execution_count"] is not None] == []


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_the_notebook_runs_from_its_first_cell_to_its_last(name, folder):
    done = run("-c", "\n\n".join("".join(cell["source"]) for cell in code_cells(name)), folder=folder)
    assert done.returncode == 0, done.stderr
    assert "stribeck_friction" in done.stdout


@pytest.mark.extended
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "page", ["docs/tutorials/python.md", "README.md", "docs/tutorials/your-own-rig-in-python.md"]
)
def test_the_code_of_the_page_runs(page, folder):
    text = (ROOT / page).read_text(encoding="utf-8")
    code = "\n".join(re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE))
    assert "import labhil as lh" in code
    done = run("-c", code, folder=folder)
    assert done.returncode == 0, f"{code}\n{done.stderr}"
