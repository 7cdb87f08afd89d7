"""What contributors, and services that build for them, read: workflows, templates, citation, changelog."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

import labhil

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PREFIX = "Programming Language :: Python :: "
PYTHONS = [name.removeprefix(PREFIX) for name in PROJECT["classifiers"] if name.startswith(f"{PREFIX}3.")]


def yaml_of(path: Path) -> Any:
    return YAML(typ="safe").load(path.read_text(encoding="utf-8"))


def commands_of(workflow: Any) -> list[str]:
    """Every line that a workflow hands to a shell."""
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    return [line.strip() for step in steps for line in step.get("run", "").splitlines()]


def test_the_tests_run_on_every_python_that_is_promised() -> None:
    workflow = yaml_of(ROOT / ".github" / "workflows" / "test.yml")
    assert workflow["jobs"]["test"]["strategy"]["matrix"]["python"] == PYTHONS
    assert PROJECT["requires-python"] == f">={PYTHONS[0]}"


def test_the_workflow_tests_with_the_command_of_the_readme() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    found = re.search(r"<!-- test command -->\s+```sh\n(.+?)\n```", readme)
    assert found
    ran = commands_of(yaml_of(ROOT / ".github" / "workflows" / "test.yml"))
    assert [part for part in found[1].split(" && ") if part not in ran] == []


def test_the_wheel_is_imported_on_three_systems() -> None:
    workflow = yaml_of(ROOT / ".github" / "workflows" / "wheel.yml")
    systems = workflow["jobs"]["install"]["strategy"]["matrix"]["os"]
    assert [system.partition("-")[0] for system in systems] == ["ubuntu", "macos", "windows"]
    assert any("import labhil" in line for line in commands_of(workflow))


@pytest.mark.parametrize("name", ["bug", "diagnosis", "proposal"])
def test_an_issue_template_asks_for_something(name: str) -> None:
    form = yaml_of(ROOT / ".github" / "ISSUE_TEMPLATE" / f"{name}.yml")
    assert form["name"] and form["description"]
    asked = [field["id"] for field in form["body"] if field.get("validations", {}).get("required")]
    assert asked
    assert len(asked) == len(set(asked))


def test_the_citation_names_this_version() -> None:
    citation = yaml_of(ROOT / "CITATION.cff")
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert citation["version"] == labhil.__version__ == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]


def test_the_changelog_keeps_to_its_form() -> None:
    lines = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()
    versions = [line for line in lines if line.startswith("## ")]
    assert versions[0] == "## [Unreleased]"
    assert all(re.fullmatch(r"## \[[\d.]+\] - \d{4}-\d\d-\d\d", line) for line in versions[1:])
    kinds = {line.removeprefix("### ") for line in lines if line.startswith("### ")}
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "benchmarks/README.md"])
def test_what_a_page_names_exists(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    linked = [target for target in re.findall(r"\]\(([^)]+)\)", text) if "://" not in target]
    rooms = re.findall(r"`((?:labhil|tests|docs|drivers|sim_drivers)/[\w/]*(?:\.\w+)?)`", text)
    folder = (ROOT / page).parent
    assert [name for name in linked if not (folder / name).exists()] == []
    assert [name for name in rooms if not (ROOT / name).exists()] == []
