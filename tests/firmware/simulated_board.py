"""A bench's firmware, built and run on a board in simavr: for the tests here and for measure.py."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
DRIVERS = HERE.parents[1] / "drivers"
HERTZ = 16e6
SIZES = re.compile(r"^(?:Program|Data):\s+(\d+) bytes", re.MULTILINE)
END_OF_RAM = 0x2200


def run(command: list[object], folder: Path | None = None) -> str:
    """Run a command that must succeed; gives what it printed."""
    done = subprocess.run(
        [str(part) for part in command], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command[0]}:\n{done.stdout}{done.stderr}"
    return done.stdout


def build_harness(folder: Path) -> Path:
    """Compile what simulates a board into ``folder``."""
    program = folder / "harness"
    sources = [HERE / name for name in ("harness.c", "board.c", "plants.c")]
    strict = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror"]
    run(["gcc", *strict, "-o", program, *sources, "-lsimavr", "-lelf", "-lm", "-lutil"])
    return program


def build_firmware(name: str, target: Path, settings: Mapping[str, object] | None = None) -> Path:
    """Build a bench's firmware as its Makefile does into ``target``; gives the ELF file.

    ``settings`` take the place of what its ``bench.h`` defines.
    """
    source = DRIVERS / f"labhil_{name}" / "firmware"
    if settings:
        from labhil_firmware import write_sources

        write_sources(source, target)
        header = target / "bench.h"
        text = header.read_text(encoding="utf-8")
        for setting, value in settings.items():
            text, found = re.subn(rf"^#define {setting}\b.*$", f"#define {setting} {value}", text, flags=re.M)
            assert found == 1, f"{header} defines no {setting}"
        header.write_text(text, encoding="utf-8")
        source = target
    run(["make", f"BUILD={target}"], source)
    return target / f"{name}.elf"


def sizes(elf: Path) -> tuple[int, int]:
    """Bytes of flash, and of memory without the stack."""
    flash, memory = SIZES.findall(run(["avr-size", "-C", "--mcu=atmega2560", elf]))
    return int(flash), int(memory)


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

    def deepest_stack(self) -> int:
        """How many bytes the stack has taken so far: the memory above everything else that is no longer 0."""
        end = self.symbol("_end")
        memory = bytes.fromhex(self.tell(f"peek {end} {END_OF_RAM - end}"))
        return len(memory.lstrip(b"\0"))


@contextlib.contextmanager
def started(harness: Path, elf: Path) -> Iterator[SimulatedBoard]:
    """Run a firmware on a board with the plant of its bench, and stop it in the end."""
    process = subprocess.Popen(
        [str(harness), str(elf), elf.stem], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
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
