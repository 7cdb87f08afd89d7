"""Files that guides show are complete: saved as the page says, their experiments and labs can be planned."""

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
