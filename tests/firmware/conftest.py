"""Compilers for the firmware's tests, and a board in simavr on a pseudo terminal.

Where a tool is missing the tests are skipped, with what to install.
"""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

HERE = Path(__file__).parent
DRIVERS = HERE.parents[1] / "drivers"
SHARED = DRIVERS / "labhil_firmware" / "shared"
HERTZ = 16e6
SANITIZED = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
HEADERS = "#include <simavr/sim_avr.h>\n#include <libelf.h>\n"
ASKED_FOR = "apt install gcc make gcc-avr avr-libc libsimavr-dev libelf-dev"


def run(command: list[object], folder: Path | None = None) -> str:
    """Run a command that must succeed; gives what it printed."""
    done = subprocess.run(
        [str(part) for part in command], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command[0]}:\n{done.stdout}{done.stderr}"
    return done.stdout


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


@dataclass(frozen=True, slots=True)
class SimulatedBoard:
    """A board that runs: ``address`` is its serial port; times are seconds of its own world."""

    address: str
    process: subprocess.Popen[str]
    elf: Path

    def tell(self, command: str) -> str:
        """Send the harness a command; gives its answer."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()

    def report(self) -> dict:
        """What has been measured so far."""
        return json.loads(self.tell("report"))

    def silence_before_safety(self) -> float:
        """How long after the host's last byte the outputs were safe, s; they must be by now."""
        report = self.report()
        assert report["safe_since"], f"the outputs are not safe: {report}"
        return (report["safe_since"] - report["last_byte"]) / HERTZ

    def symbol(self, name: str) -> int:
        """Address of a function (in the flash) or a variable (in the memory)."""
        found = re.search(rf"^([0-9a-f]+) \w {name}$", run(["avr-nm", self.elf]), re.MULTILINE)
        assert found is not None, name
        return int(found[1], 16) & 0xFFFF

    def line_losses(self) -> tuple[int, int, int]:
        """Overruns, framing errors and unsent messages, as the firmware counts them."""
        memory = bytes.fromhex(self.tell(f"peek {self.symbol('line_losses')} 6"))
        overruns, framing_errors, unsent = (memory[i] | memory[i + 1] << 8 for i in (0, 2, 4))
        return overruns, framing_errors, unsent


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
        if not target.exists():
            run(["make", f"BUILD={target}"], DRIVERS / f"labhil_{name}" / "firmware")
        return target / f"{name}.elf"

    return build


@pytest.fixture(scope="session")
def harness(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build what simulates a board."""
    if shutil.which("gcc") is None or not compiles("-fsyntax-only", code=HEADERS):
        pytest.skip(f"no simavr to compile against here: {ASKED_FOR}")
    program = tmp_path_factory.mktemp("harness") / "harness"
    sources = [HERE / name for name in ("harness.c", "board.c", "plants.c")]
    strict = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror"]
    run(["gcc", *strict, "-o", program, *sources, "-lsimavr", "-lelf", "-lm", "-lutil"])
    return program


@pytest.fixture(scope="session")
def simulated_board(
    harness: Path, firmware: Callable[[str], Path]
) -> Callable[[str], contextlib.AbstractContextManager[SimulatedBoard]]:
    """What starts a board with a bench's firmware and plant, and stops it in the end."""

    @contextlib.contextmanager
    def start(name: str) -> Iterator[SimulatedBoard]:
        elf = firmware(name)
        process = subprocess.Popen(
            [str(harness), str(elf), name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            yield SimulatedBoard(process.stdout.readline().strip(), process, elf)
        finally:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
            process.wait(10)
            process.stdout.close()

    return start
