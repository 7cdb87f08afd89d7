"""The command that hands out the firmware."""

from pathlib import Path

import pytest

from labhil import plugins

pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def labhil(capsys, *arguments: str) -> tuple[int, str, str]:
    import sys

    from labhil import cli

    sys.argv = ["labhil", *arguments]
    with pytest.raises(SystemExit) as ended:
        cli.main()
    said = capsys.readouterr()
    return int(ended.value.code or 0), said.out, said.err


def test_every_serial_bench_has_firmware(capsys):
    status, out, _ = labhil(capsys, "firmware")
    assert status == 0
    listed = dict(line.split("  ") for line in out.splitlines())
    assert {"ball_beam", "dc_motor", "solenoid"} <= set(listed)
    for name, folder in listed.items():
        assert Path(folder) == plugins.firmware_folder(name)


@pytest.mark.parametrize("name", ["ball_beam", "dc_motor", "solenoid"])
def test_a_copy_has_all_that_it_is_built_of(capsys, name):
    status, out, err = labhil(capsys, "firmware", name, "-o", "copy")
    assert (status, out) == (0, "copy\n")
    assert "make -C copy" in err
    copied = {path.relative_to("copy").as_posix() for path in Path("copy").rglob("*") if path.is_file()}
    assert {"Makefile", "bench.h", f"{name}.c", "shared/firmware.mk", "shared/frame.c"} <= copied
    assert not any(path.startswith("build/") for path in copied)
    includes = {
        line.split('"')[1]
        for path in Path("copy").rglob("*.[ch]")
        for line in path.read_text(encoding="utf-8").splitlines()
        if line.startswith('#include "')
    }
    assert includes <= {Path(path).name for path in copied}


def test_what_is_there_is_not_overwritten(capsys, tmp_path):
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "mine.c").write_text("", encoding="utf-8")
    status, out, err = labhil(capsys, "firmware", "ball_beam", "-o", "copy")
    assert (status, out) == (2, "")
    assert "expected a new or an empty folder" in err


def test_a_device_without_firmware_is_named(capsys):
    status, _, err = labhil(capsys, "firmware", "toaster")
    assert status == 2
    assert "toaster" in err
    assert "ball_beam" in err


def test_devices_tells_of_it(capsys):
    status, out, _ = labhil(capsys, "devices", "ball_beam")
    assert status == 0
    assert "labhil firmware ball_beam" in out
