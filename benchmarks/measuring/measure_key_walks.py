"""Random walks over the keys of the terminal UI. A command, no test:

    PYTHONPATH=benchmarks python benchmarks/measuring/measure_key_walks.py --walks 500 -o FILE.json

Each walk opens the screen over a folder with whole and broken files and presses random keys: mostly those
that are bound where it is. ``enter`` starts no experiment: tests of the screen do that.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

from labhil.tui.session import Session
from labhil_benchmarks.key_walks import Walk, fill, walk
from measured import tell

ROOT = Path(__file__).parents[2]
RESULTS = ("results", "compared")
WALKS_TOGETHER = 10
"""In one folder and one lab; what was walked is written after each ten."""


def main() -> None:
    """Walk, and write what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--walks", type=int, default=500)
    parser.add_argument("--length", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="Seed of the first walk.")
    parser.add_argument("--processes", type=int, default=4, help="They wait for the screen most of the time.")
    parser.add_argument("-o", "--out", type=Path, required=True)
    chosen = parser.parse_args()
    began = time.monotonic()
    seeds = range(chosen.first, chosen.first + chosen.walks)
    shares = [seeds[start : start + WALKS_TOGETHER] for start in range(0, len(seeds), WALKS_TOGETHER)]
    walks: list[Walk] = []
    with ProcessPoolExecutor(chosen.processes, get_context("spawn")) as pool:
        for done in as_completed([pool.submit(walk_all, share, chosen.length) for share in shares]):
            walks.extend(done.result())
            tell(summary(walks, time.monotonic() - began), chosen.out)


def summary(walks: Sequence[Walk], seconds: float) -> dict[str, object]:
    """What so many walks came to."""
    crashed = sorted((run for run in walks if run.crash), key=lambda run: run.seed)
    return {
        "walks": len(walks),
        "keys": sum(len(run.keys) for run in walks),
        "crashes": len(crashed),
        "crashed": [asdict(run) for run in crashed],
        "seconds": round(seconds, 1),
    }


def walk_all(seeds: Sequence[int], length: int) -> list[Walk]:
    """Make these walks in a folder and a lab of their own."""
    with tempfile.TemporaryDirectory() as place:
        # an emergency stop that is pressed here stops nothing elsewhere
        os.environ["XDG_RUNTIME_DIR"] = place
        recordings = sorted((ROOT / "recordings").glob("*.mcap"))[:2]
        results = sorted(file for kind in RESULTS for file in (ROOT / "tests" / "tui" / kind).iterdir())
        folder = fill(Path(place) / "bench", recordings, results)
        with Session() as lab:
            return [asyncio.run(walk(folder, lab, seed, length)) for seed in seeds]


if __name__ == "__main__":
    main()
