"""Guides are complete: files that they show can be planned, and of those they name one knows the origin."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from labhil.campaign.policies import check_policies
from labhil.experiment.experiment import load_experiment
from labhil.experiment.lab import load_lab
from labhil.experiment.plan import make_plan
from labhil.experiment.points import is_campaign, points_of

ROOT = Path(__file__).parents[2]
HOW_TO = ROOT / "docs" / "how-to"
FENCE = re.compile(r"^[ ]*```\w*\n.*?^[ ]*```", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"(?<![\w/.*$-])(?:[\w-]+/)*[\w-]+\.(?:csv|fmu|json|mat|mcap|npz|py|toml|urdf|xml)\b")
MADE = re.compile(r"(?:-o|--out|--json|--html|--plot|--answer)[ =](\S+)")
TOML = re.compile(r"^```toml\n(.*?)^```", re.DOTALL | re.MULTILINE)


def save(page: str, folder: Path) -> dict[str, Path]:
    """Save the files of a page, each by the section that it begins with."""
    names = {"[rig]": "rig.toml", "[experiment]": "experiment.toml", "[lab]": "lab.toml"}
    saved = {}
    for text in TOML.findall((HOW_TO / page).read_text(encoding="utf-8")):
        name = names[text.splitlines()[0]]
        assert name not in saved, f"{page} has two files that begin alike"
        saved[name] = folder / name
        saved[name].write_text(text, encoding="utf-8")
    return saved


@pytest.mark.parametrize("page", ["sweep.md", "automate.md"])
def test_an_experiment_of_a_guide_can_be_planned_with_the_files_of_its_page(
    page: str, tmp_path: Path
) -> None:
    experiment = load_experiment(save(page, tmp_path)["experiment.toml"])
    runs = [point.experiment for point in points_of(experiment)] if is_campaign(experiment) else [experiment]
    assert all(make_plan(run).devices for run in runs)


def test_the_lab_of_a_guide_can_be_started_with_the_files_of_its_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "labhil/experiment/examples/ball_beam.toml", tmp_path)
    shutil.copy(ROOT / "examples/fit.json", tmp_path / "accepted.json")
    lab = load_lab(save("automate.md", tmp_path)["lab.toml"])
    check_policies(lab)


def unexplained_files(page: str) -> set[str]:
    """Files of a page's commands, files and programs that no command of it makes and no sentence names.

    A sentence counts where it stands before them, or next after them. Names in capitals (``REC.mcap``) stand
    for files of the reader's; what a command prints, below a line with ``$ labhil``, is not looked at.
    """
    prose, made, unknown, end = "", set[str](), set[str](), 0
    for fence in FENCE.finditer(page):
        prose += page[end : fence.start()]
        end = fence.end()
        lines = [line for line in fence[0].splitlines() if "$ labhil" not in fence[0] or "$ labhil" in line]
        said = prose + page[end:].lstrip().partition("\n\n")[0]
        text = "\n".join(lines)
        made |= set(MADE.findall(text))
        names = {name for name in FILE.findall(text) if not Path(name).stem.isupper()}
        unknown |= {name for name in names - made if f"`{name}`" not in said and not (ROOT / name).exists()}
    return unknown


@pytest.mark.parametrize("page", sorted(path.name for path in HOW_TO.glob("*.md")))
def test_a_guide_says_whence_each_file_comes_that_it_names(page: str) -> None:
    assert unexplained_files((HOW_TO / page).read_text(encoding="utf-8")) == set()


def test_a_file_from_nowhere_is_found() -> None:
    command = "```sh\nlabhil import log.csv --rig rig.toml -o log.mcap\nlabhil fit log.mcap REC.mcap\n```\n"
    assert unexplained_files(f"# Page\n\n{command}") == {"log.csv", "rig.toml"}
    assert unexplained_files(f"Your `log.csv`.\n\n{command}\nAnd `rig.toml`.\n\nMore.") == set()
    assert unexplained_files(f"Your `log.csv`.\n\n{command}\nMore.\n\nAnd `rig.toml`.") == {"rig.toml"}
    shipped = "```sh\nlabhil fit recordings/ball_beam_identify.mcap\n```\n"
    assert unexplained_files(shipped) == set()
