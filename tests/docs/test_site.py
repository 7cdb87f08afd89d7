"""The documents: their links, the pages made from the code, the README, and the site of them."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

import labhil
from labhil.command_line import app
from labhil.commands.help_pages import GUIDES

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(path.relative_to(ROOT).as_posix() for path in (*DOCS.rglob("*.md"), ROOT / "README.md"))
FENCED = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)


def generated() -> dict[str, str]:
    """What docs/generate_reference.py makes."""
    spec = spec_from_file_location("generate_reference", DOCS / "generate_reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    texts: dict[str, str] = module.generate()
    return texts


@pytest.mark.parametrize("page", PAGES)
def test_every_file_that_a_page_links_to_exists(page: str) -> None:
    text = FENCED.sub("", (ROOT / page).read_text(encoding="utf-8"))
    targets = [
        target.partition("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in target
    ]
    assert [target for target in targets if target and not ((ROOT / page).parent / target).exists()] == []


def anchors_of(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and the site make them."""
    headings = re.findall(r"^#+ (.+)$", FENCED.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading).strip().replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", PAGES)
def test_every_heading_that_a_page_links_to_exists(page: str) -> None:
    # the site cannot tell: it makes a link out of docs/ a download, without its anchor
    text = FENCED.sub("", (ROOT / page).read_text(encoding="utf-8"))
    links = re.findall(r"\]\(([^)\s#]*)#([^)\s]+)\)", text)
    missing = [
        f"{target}#{anchor}"
        for target, anchor in links
        if "://" not in target
        and anchor not in anchors_of((ROOT / page).parent / target if target else ROOT / page)
    ]
    assert missing == []


def test_the_pages_made_from_the_code_are_as_new_as_the_code() -> None:
    old = [
        name for name, text in generated().items() if (DOCS / "reference" / name).read_text("utf-8") != text
    ]
    assert old == [], "run: python docs/generate_reference.py"


def test_the_api_page_shows_every_public_name() -> None:
    text = (DOCS / "reference" / "python-api.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"^\.\. auto\w+:: labhil\.(\w+)", text, re.MULTILINE))
    assert set(labhil.__all__) - shown == {"errors"}  # the page of exit codes lists these
    described = set(re.findall(r"^\| `(\w+)` \| \w", text, re.MULTILINE))
    modules = {"errors", "devices", "physics"}
    assert set(labhil.__all__) - modules <= described, "each name has a line that says what it does"


def commands_of(group: Any, path: str = "labhil") -> dict[str, Any]:
    """Every command by how it is typed."""
    found: dict[str, Any] = {}
    for name, command in group.commands.items():
        found |= (
            commands_of(command, f"{path} {name}")
            if hasattr(command, "commands")
            else {f"{path} {name}": command}
        )
    return found


def test_every_commands_help_has_an_example_and_names_a_page_that_exists() -> None:
    commands = commands_of(get_command(app))
    assert set(GUIDES) <= set(commands)
    headings = (DOCS / "reference" / "cli.md").read_text(encoding="utf-8")
    for typed, command in commands.items():
        example, _, page = command.epilog.partition("\n\nPage: ")
        assert example.startswith(f"Example: {typed}"), typed
        file, _, anchor = page.partition("#")
        assert (ROOT / file).is_file(), typed
        assert not anchor or f"## {typed}\n" in headings


def test_decisions_are_numbered_without_a_gap_and_dated() -> None:
    records = sorted((DOCS / "explanation" / "decisions").glob("0*.md"))
    assert [int(path.name[:4]) for path in records] == list(range(1, len(records) + 1))
    head = re.compile(r"# (\d{4})\. .+\n\nDate: \d{4}-\d\d-\d\d\. Status: .+\.\n")
    for path in records:
        found = head.match(path.read_text(encoding="utf-8"))
        assert found, path.name
        assert found[1] == path.name[:4]


def test_the_readme_is_read_in_a_minute_or_three() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 700


@pytest.mark.parametrize(
    "folder", ["labhil", "drivers", "sim_drivers", "tests", "examples", "benchmarks", "slim"]
)
def test_a_page_that_the_code_names_exists(folder: str) -> None:
    files = [
        path for path in (ROOT / folder).rglob("*") if path.suffix in {".py", ".h", ".c", ".md", ".toml"}
    ]
    named = {
        (path.relative_to(ROOT).as_posix(), page)
        for path in files
        for page in re.findall(r"(?<![\w/.])docs/[\w/-]+\.md", path.read_text(encoding="utf-8"))
    }
    assert sorted(each for each in named if not (ROOT / each[1]).exists()) == []


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, str(DOCS / "build.py"), str(tmp_path / "site")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    missing = [
        page
        for page in PAGES
        if page.startswith("docs/")
        and not (tmp_path / "site" / Path(page).relative_to("docs").with_suffix(".html")).exists()
    ]
    assert missing == []
