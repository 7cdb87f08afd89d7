"""Program of the reader's process: requests as lines on stdin, answers as bytes on stdout.

:mod:`labhil.recording.formats.isolated` starts it. Each request limits memory and processor time.
"""

from __future__ import annotations

import json
import math
import os
import select
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from labhil.bounds import ImplausibleError
from labhil.errors import LabhilError
from labhil.recording.formats.bag import read_bag
from labhil.recording.formats.columns import Columns
from labhil.recording.formats.lerobot import read_dataset, read_parquet_or_episode
from labhil.recording.formats.matlab import read_hdf5, read_mat
from labhil.recording.formats.mcap_file import read_mcap
from labhil.recording.formats.npz import read_npz
from labhil.recording.formats.transfer import pack
from labhil.recording.formats.workbook import read_workbook
from labhil.rig_sections import Table

IDLE_SECONDS = 60.0
"""Time without a request after which the process ends, s; the next one starts in half a second."""

READERS: dict[str, Callable[[Path, Table, Sequence[str]], Columns]] = {
    "mat": lambda path, table, wanted: read_mat(path, wanted),
    "hdf5": lambda path, table, wanted: read_hdf5(path, wanted),
    "parquet": read_parquet_or_episode,
    "lerobot": read_dataset,
    "workbook": read_workbook,
    "bag": lambda path, table, wanted: read_bag(path, wanted),
    "npz": lambda path, table, wanted: read_npz(path, wanted),
    "mcap": lambda path, table, wanted: read_mcap(path, wanted),
}


def main() -> None:
    """Serve requests until the input ends or no request arrives."""
    warnings.simplefilter("ignore")
    # output of a library must not mix with the answers
    answers = os.fdopen(os.dup(1), "wb")
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    _write(answers, b"\n")
    while select.select([sys.stdin], [], [], IDLE_SECONDS)[0]:
        line = sys.stdin.buffer.readline()
        if not line:
            return
        _write(answers, pack(_answer(json.loads(line))))


def _answer(request: dict[str, Any]) -> dict[str, Any]:
    path = Path(request["path"])
    try:
        os.chdir(request["folder"])
        _limit_resources(request["cpu_seconds"], request["memory"])
        table = Table.model_validate(request["table"])
        return {"columns": READERS[request["kind"]](path, table, request["wanted"])}
    except LabhilError as error:
        return {"error": type(error).__name__, "text": str(error)}
    except ImplausibleError as error:
        return {"error": "TableError", "text": f"{path}: {error}"}
    except MemoryError:
        return {
            "error": "TableError",
            "text": f"{path}: cannot be read: it needs more than the {request['memory'] >> 20} MB of memory "
            "that a file of its size may take",
        }
    except Exception as error:  # noqa: BLE001 - each library raises its own on a damaged file
        return {"error": "TableError", "text": f"{path}: cannot be read: {error!r:.500}"}


def _limit_resources(cpu_seconds: float, memory: int) -> None:
    """Limit the resources for the next file, in addition to those used so far."""
    try:
        import resource
    except ImportError:  # not a POSIX system
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _set_soft_limit(resource.RLIMIT_CPU, math.ceil(time.process_time() + cpu_seconds))
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (OSError, ValueError):
        return
    _set_soft_limit(resource.RLIMIT_AS, pages * resource.getpagesize() + memory)


def _set_soft_limit(kind: int, limit: int) -> None:
    """Set a soft limit, at most the hard limit (``ulimit -v``)."""
    import resource

    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def _write(answers: BinaryIO, data: bytes) -> None:
    answers.write(data)
    answers.flush()


if __name__ == "__main__":
    main()
