"""Compilers for the firmware's tests, and a board in simavr on a pseudo terminal.

Where a tool is missing the tests are skipped, with what to install.
"""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from simulated_board import DRIVERS, HERE, SimulatedBoard, build_firmware, build_harness, run, started

SHARED = DRIVERS / "labhil_firmware" / "shared"
SANITIZED = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
HEADERS = "#include <simavr/sim_avr.h>\n#include <libelf.h>\n"
ASKED_FOR = "apt install gcc make gcc-avr avr-libc libsimavr-dev libelf-dev"


def compiles(*options: str, code: str = "int main(void) { return 0; }", compiler: str = "gcc") -> bool:
    command = [compiler, "-x", "c", "-", "-o", "/dev/null", *options]
    return subprocess.run(command, input=code, text=True, capture_output=True, check=False).returncode == 0


@pytest.fixture(scope="session")
def host_program(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Compile one of our C files with some of the firmware's shared ones, for this machine."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler here: apt install gcc")
    sanitized = SANITIZED if compiles(*SANITIZED) else ["-O1"]

    def build(name: str, *shared: str) -> Path:
        program = tmp_path_factory.mktemp("host") / name
        sources = [HERE / f"{name}.c", *(SHARED / file for file in shared)]
        strict = ["-std=c11", "-Wall", "-Wextra", "-Werror", f"-I{SHARED}"]
        run(["gcc", *strict, *sanitized, "-o", program, *sources])
        return program

    return build


@pytest.fixture(scope="session")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Build a bench's firmware as its Makefile does; gives the ELF file."""
    missing = [tool for tool in ("make", "avr-gcc", "avr-size", "avr-objcopy") if shutil.which(tool) is None]
    if missing:
        pytest.skip(f"no {', '.join(missing)} here: {ASKED_FOR}")
    if not compiles("-fsyntax-only", "-mmcu=atmega2560", code="#include <avr/io.h>\n", compiler="avr-gcc"):
        pytest.skip(f"no avr-libc here: {ASKED_FOR}")
    folder = tmp_path_factory.mktemp("firmware")

    def build(name: str) -> Path:
        target = folder / name
        return target / f"{name}.elf" if target.exists() else build_firmware(name, target)

    return build


@pytest.fixture(scope="session")
def harness(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build what simulates a board."""
    if shutil.which("gcc") is None or not compiles("-fsyntax-only", code=HEADERS):
        pytest.skip(f"no simavr to compile against here: {ASKED_FOR}")
    return build_harness(tmp_path_factory.mktemp("harness"))


@pytest.fixture(scope="session")
def simulated_board(
    harness: Path, firmware: Callable[[str], Path]
) -> Callable[[str], contextlib.AbstractContextManager[SimulatedBoard]]:
    """What starts a board with a bench's firmware and plant, and stops it in the end."""
    return lambda name: started(harness, firmware(name))
