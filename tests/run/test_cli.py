from __future__ import annotations

import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

from labhil import __version__
from labhil.command_line import app
from labhil.commands.acquisition import parse_settings
from labhil.console import split_names
from labhil.errors import UsageError

ANALYSIS = ("numba", "scipy.optimize", "matplotlib", "statsmodels")


def labhil(directory: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "labhil", *arguments]
    done = subprocess.run(
        command, cwd=directory, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert "Traceback" not in done.stderr
    return done


def test_every_command_has_help_with_an_example() -> None:
    for command in app.registered_commands:
        assert command.callback is not None
        assert command.callback.__doc__, command.name
        assert (command.epilog or "").startswith("Example: labhil "), command.callback.__name__


def test_help_shows_the_example(tmp_path: Path) -> None:
    assert "Example: labhil run ball_beam_identify.toml" in labhil(tmp_path, "run", "--help").stdout


def test_the_version_is_told(tmp_path: Path) -> None:
    assert labhil(tmp_path, "--version").stdout == f"labhil {__version__}\n"


def test_devices_are_listed_and_described(tmp_path: Path) -> None:
    assert "ball_beam  (with a simulated device)" in labhil(tmp_path, "devices").stdout
    described = labhil(tmp_path, "devices", "ball_beam").stdout
    assert "servo_angle [rad]" in described
    assert "safe at 0" in described


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("devices", "ball_bean"), "did you mean 'ball_beam'"),
        (("twin", "ball_bean"), "did you mean 'ball_beam'"),
        (("twin", "ball_beam", "--terms", "viscous"), "known: "),
        (("twin", "ball_beam", "--set", "latency"), "expected name=number"),
        (("run", "nothing.toml"), "nothing.toml: cannot be read"),
        (("import", "nothing.csv", "--rig", "nothing.toml", "-o", "x.mcap"), "nothing.toml: cannot be read"),
        (("export", "nothing.mcap", "-o", "x.csv"), "nothing.mcap"),
        (("recrod",), "No such command"),
    ],
)
def test_wrong_use_ends_with_2_and_a_message(
    tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    done = labhil(tmp_path, *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr


def test_settings_are_numbers_by_name() -> None:
    assert parse_settings(["a.b=1e-3", "c = -2"]) == {"a.b": 1e-3, "c": -2.0}
    for wrong in ("a", "a=", "=1", "a=b"):
        with pytest.raises(UsageError, match="expected name=number"):
            parse_settings([wrong])


def test_names_are_split_at_commas() -> None:
    assert split_names("a, b,") == ("a", "b")
    assert split_names("") == ()
    assert split_names(None) is None


def test_a_table_becomes_a_recording_and_a_table_again(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text('[rig]\nkind = "ball_beam"\n')
    rows = "".join(f"{k / 10},{0.1 * k},{0.01 * k}\n" for k in range(20))
    (tmp_path / "bench.csv").write_text("t,servo_angle,ball_position\n" + rows)
    done = labhil(tmp_path, "import", "bench.csv", "--rig", "rig.toml", "-o", "bench.mcap")
    assert (done.returncode, done.stdout) == (0, "bench.mcap\n")
    done = labhil(tmp_path, "export", "bench.mcap", "-o", "again.csv")
    assert (done.returncode, done.stdout) == (0, "again.csv\n")
    lines = (tmp_path / "again.csv").read_text().splitlines()
    assert len(lines) == 21
    assert set(lines[0].split(",")) == {"t", "servo_angle", "ball_position"}


@pytest.mark.extended
def test_a_run_loads_nothing_of_the_analysis(tmp_path: Path) -> None:
    example = files("labhil.experiment") / "examples"
    text = (example / "ball_beam_test.toml").read_text().replace("duration = 60.0 ", "duration = 1.0 ")
    (tmp_path / "short.toml").write_text(text)
    (tmp_path / "ball_beam.toml").write_text((example / "ball_beam.toml").read_text())
    code = (
        "import sys\n"
        "from labhil.cli import main\n"
        "sys.argv = ['labhil', 'run', 'short.toml']\n"
        "try:\n    main()\n"
        f"finally:\n    print('loaded', *[name for name in {ANALYSIS!r} if name in sys.modules])\n"
    )
    command = [sys.executable, "-P", "-c", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    path, loaded = done.stdout.splitlines()[-2:]
    assert (tmp_path / path).exists()
    assert loaded == "loaded"
