"""What our decoders make of ten million bytes of noise of each kind. A command, no test:

    PYTHONPATH=benchmarks python benchmarks/measuring/measure_line_noise.py -o FILE.json

Frames of the serial link have a checksum of 16 bits: for 65536 pieces that it refuses one gets through by
chance. RTDE has none (TCP has): what fits in its lengths is taken, what does not ends the connection.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

from labhil_benchmarks.line_noise import (
    DAMAGE,
    Heard,
    forged_frames,
    noisy_frames,
    random_bytes,
    rtde_packages,
)
from measured import tell


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--bytes", type=int, default=10_000_000, help="Of each kind.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    begun = time.monotonic()
    ways: dict[str, Callable[[int, int], Heard]] = {
        "serial: bytes at random": random_bytes,
        **{f"serial: {name}": partial(_of, name) for name in DAMAGE},
        "serial: right checksum, payload at random": forged_frames,
        "RTDE: packages damaged": rtde_packages,
    }
    kinds = {}
    for name, way in ways.items():
        kinds[name] = asdict(way(options.bytes, options.seed))
        print(f"{name}: {kinds[name]}", file=sys.stderr, flush=True)
    result = {
        "schema": "labhil.line_noise/1",
        "seed": options.seed,
        "faults": sum(len(kind["faults"]) for kind in kinds.values()),
        "seconds": round(time.monotonic() - begun, 1),
        "kinds": kinds,
    }
    tell(result, options.out)


def _of(name: str, count: int, seed: int) -> Heard:
    return noisy_frames(count, DAMAGE[name], seed)


if __name__ == "__main__":
    main()
