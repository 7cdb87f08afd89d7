"""How much memory and time commands take for large recordings. A command, no test:

    PYTHONPATH=benchmarks python benchmarks/measuring/measure_large.py --samples 1e6 1e7 -o FILE.json

Recordings of a simulated motor with 22 columns, of 10⁷ samples 2.3 GB; one as it was finished, and one as a
killed recorder leaves it. Each command runs in a process of its own, whose memory is looked at every 20 ms:
what it has for itself (``anonymous``: what a machine must have), and all that is resident, pages of files
among it that the system takes away when it needs them. Whether time is linear is seen in the processor's time
(``cpu_seconds``), which other work on the machine does not stretch.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from labhil_benchmarks.large_recording import write_large
from measured import tell

LOOK = 0.02
COMMANDS = {
    "info": ("info", "whole.mcap"),
    "export to CSV": ("export", "whole.mcap", "-o", "out.csv"),
    "export to Parquet": ("export", "whole.mcap", "-o", "out.parquet"),
    "recover": ("recover", "cut.mcap.part", "-o", "out.mcap"),
    "verify": ("verify", "whole.mcap", "--model", "FIT.json"),
    "fit": ("fit", "whole.mcap", "--json", "out.json"),
}


def watch(arguments: list[str], folder: Path, patience: float) -> dict[str, Any]:
    """Run a command; its time (s), its exit status and the largest memory (MB) of its process."""
    command = [sys.executable, "-P", "-m", "labhil", *arguments]
    began = time.monotonic()
    anonymous = resident = 0.0
    with (folder / "said.txt").open("w") as output:
        process = subprocess.Popen(command, cwd=folder, stdout=output, stderr=output)
        before = os.times()
        while process.poll() is None and time.monotonic() - began < patience:
            memory = memory_of(process.pid)
            anonymous, resident = max(anonymous, memory[0]), max(resident, memory[1])
            time.sleep(LOOK)
    over = process.poll() is not None
    if not over:
        process.kill()
        process.wait()
    after = os.times()
    used = (after.children_user + after.children_system) - (before.children_user + before.children_system)
    return {
        "seconds": round(time.monotonic() - began, 1),
        "cpu_seconds": round(used, 1),
        "exit_status": process.returncode if over else f"not done after {patience:g} s",
        "anonymous_mb": round(anonymous, 1),
        "resident_mb": round(resident, 1),
        "said": (folder / "said.txt").read_text()[-300:],
    }


def memory_of(pid: int) -> tuple[float, float]:
    """What a process has for itself, and all that is resident, MB; 0 for one that is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0, 0.0
    sizes = {line.split(":")[0]: line.split()[1] for line in lines if line.endswith("kB")}
    own = int(sizes.get("RssAnon", 0)) + int(sizes.get("RssShmem", 0))
    return own * 1.024e-3, int(sizes.get("VmRSS", 0)) * 1.024e-3


def measure(
    samples: int, wanted: list[str], patience: float, folder: Path, made: Path | None
) -> dict[str, Any]:
    """All commands on a recording of so many samples; ``made`` is one that may be there already."""
    recording = folder / "whole.mcap"
    if made is not None and made.exists():
        os.link(made, recording)
    else:
        write_large(recording, samples)
    if "verify" in wanted:
        (folder / "small").mkdir()
        model = write_large(folder / "small" / "model.mcap", 30_000, seed=2)
        watch(["fit", str(model), "--json", str(folder / "FIT.json")], folder, 600.0)
    if "recover" in wanted:
        cut = folder / "cut.mcap.part"
        shutil.copyfile(recording, cut)
        os.truncate(cut, recording.stat().st_size * 99 // 100)
    result: dict[str, Any] = {"bytes": recording.stat().st_size, "commands": {}}
    for name in wanted:
        result["commands"][name] = watch(list(COMMANDS[name]), folder, patience)
        print(f"{samples} {name}: {result['commands'][name]}", file=sys.stderr, flush=True)
        for out in folder.glob("out.*"):
            out.unlink()
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--samples", type=float, nargs="+", default=[1e6, 1e7])
    parser.add_argument("--only", help="some of: " + ", ".join(COMMANDS))
    parser.add_argument("--patience", type=float, default=1800.0, help="s that one command may take")
    parser.add_argument(
        "--folder", type=Path, help="where there is room; a recording SAMPLES.mcap there is used"
    )
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    result: dict[str, Any] = {"schema": "labhil.large/1", "samples": {}}
    if options.only and options.out is not None and options.out.exists():
        result["samples"] = json.loads(options.out.read_text())["samples"]  # the other sizes stay
    wanted = [name.strip() for name in options.only.split(",")] if options.only else list(COMMANDS)
    for samples in options.samples:
        with tempfile.TemporaryDirectory(dir=options.folder) as folder:
            made = None if options.folder is None else options.folder / f"{int(samples)}.mcap"
            figures = measure(int(samples), wanted, options.patience, Path(folder), made)
        result["samples"][str(int(samples))] = {**figures, "load_average": round(os.getloadavg()[0], 1)}
    result["machine"] = {"cores": os.cpu_count(), "python": platform.python_version()}
    tell(result, options.out)


if __name__ == "__main__":
    main()
