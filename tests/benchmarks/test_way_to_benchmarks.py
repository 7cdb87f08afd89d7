"""Commands of the benchmarks: found in a checkout, handed on word for word, missed in words."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from labhil.campaign import benchmarks
from labhil.cli import main
from labhil.errors import MissingBenchmarksError

ROOT = Path(__file__).parents[2]
CARDS = ROOT / "benchmarks" / "results" / "trials"


def labhil(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command as somebody does who has no benchmarks on the path."""
    command = [sys.executable, "-P", "-m", "labhil", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_an_installation_finds_the_checkout_that_it_came_from(tmp_path: Path) -> None:
    done = labhil("trial", "compare", str(CARDS / "axis.json"), str(CARDS / "ur5.json"), folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("| | `axis` | `ur5` |\n")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("benchmark", "no_such_case"), "benchmark case 'no_such_case' does not exist"),
        (("reference", "9.9", "--quick"), "9.9"),
        (("trial", "compare", "nowhere.json"), "nowhere.json: expected a score card"),
        (("trial", "benchmark", "axis", "--no-such-option"), "No such option: --no-such-option"),
    ],
)
def test_arguments_are_handed_on_and_wrong_use_ends_with_2(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["labhil", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    said = capsys.readouterr()
    assert (end.value.code, said.out) == (2, "")
    assert message in said.err


@pytest.mark.parametrize("words", [("reference",), ("benchmark",), ("trial", "calibrate")])
def test_help_is_that_of_the_benchmarks(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    monkeypatch.setattr("sys.argv", ["labhil", *words, "--help"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 0
    shown = capsys.readouterr().out
    assert f"Usage: labhil {' '.join(words)}" in shown
    assert "Example: labhil" in shown


@pytest.mark.parametrize(
    "noted",
    [
        None,
        {"url": "https://example.org/labhil.git", "vcs_info": {"vcs": "git", "commit_id": "0"}},
        {"url": "file:///nowhere/labhil-0.1.0-py3-none-any.whl", "archive_info": {}},
        {"url": "file:///nowhere/labhil", "dir_info": {}},
    ],
)
def test_elsewhere_the_message_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, noted: dict[str, object] | None
) -> None:
    """What pip notes of an index, a repository, a wheel, and a folder that is gone."""
    facts = tmp_path / "labhil-0.1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: labhil\nVersion: 0.1.0\n")
    if noted is not None:
        (facts / "direct_url.json").write_text(json.dumps(noted))
    monkeypatch.setattr("sys.path", [str(tmp_path)])
    monkeypatch.setattr(benchmarks, "PACKAGE", "labhil_benchmarks_of_nobody")
    with pytest.raises(MissingBenchmarksError, match=r"`labhil reference` is one of .*pip install") as error:
        benchmarks.benchmark_module("command_line", "`labhil reference`")
    assert error.value.exit_status == 2
