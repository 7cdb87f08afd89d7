"""What commands make of ten thousand bad files. A command, no test:

    PYTHONPATH=benchmarks python benchmarks/measuring/measure_bad_files.py -o FILE.json

Every case is a folder of files, of which one is bad, and a command that reads it. It is read, or refused with
exit status 2 and a message that names the file; within 20 s and 1 GB; no traceback, no signal; nothing on the
screen that steers a terminal; no file changed but the one that was asked for. A case with a fault is kept
with ``--keep FOLDER``.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from labhil_benchmarks.bad_files.harm import harmful_cases
from labhil_benchmarks.bad_files.kinds import Case, make_cases
from labhil_benchmarks.bad_files.reader import Reader
from labhil_benchmarks.bad_files.verdict import Tally, try_case
from measured import tell


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help="parts of kinds' names: a,b,…")
    parser.add_argument("--keep", type=Path, help="Where cases with a fault are kept.")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    begun = time.monotonic()
    tallies: dict[str, Tally] = {}
    with tempfile.TemporaryDirectory() as name, Reader(Path(name)) as reader:
        place = Path(name) / "case"
        for case in cases(options.cases, options.seed):
            if options.only and not any(part in case.kind for part in options.only.split(",")):
                continue
            outcome, faults = try_case(case, reader, place)
            tallies.setdefault(case.kind, Tally()).add(case, outcome, faults)
            if faults:
                print(f"{case.kind}: {tallies[case.kind].faults[-1]}", file=sys.stderr, flush=True)
                if options.keep is not None:
                    kept = options.keep / f"{case.kind}-{case.number}".replace("/", "_")
                    shutil.copytree(place, kept, dirs_exist_ok=True)
    tell(summary(tallies, options.seed, time.monotonic() - begun), options.out)


def cases(count: int, seed: int) -> Iterator[Case]:
    made: list[Callable[[], Case]] = [*harmful_cases(), *make_cases(count, seed)]
    for make in made:
        yield make()


def summary(tallies: dict[str, Tally], seed: int, seconds: float) -> dict[str, Any]:
    return {
        "schema": "labhil.bad_files/1",
        "seed": seed,
        "cases": sum(tally.cases for tally in tallies.values()),
        "faults": sum(len(tally.faults) for tally in tallies.values()),
        "worst_seconds": max(tally.worst_seconds for tally in tallies.values()),
        "worst_megabytes": max(tally.worst_megabytes for tally in tallies.values()),
        "seconds": round(seconds, 1),
        "kinds": {kind: asdict(tally) for kind, tally in tallies.items()},
        "machine": {"cores": os.cpu_count(), "python": platform.python_version()},
    }


if __name__ == "__main__":
    main()
