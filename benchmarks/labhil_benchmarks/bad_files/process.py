"""The process that runs commands: a request a line on stdin, what came of it a line on stdout.

Commands run by ``labhil.cli.main`` as a shell would start them, without the half second of a new process.
A crash ends this process, which :class:`labhil_benchmarks.bad_files.reader.Reader` sees.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any

LOADED = 250_000_000
"""Bytes of a new process with all libraries; what earlier commands left in this one does not count."""

MEMORY = 6 << 30
"""Bytes of address space: this machine is spared, and a command that would take them fails."""


def main() -> None:
    """Run commands until there are no more."""
    import numba  # noqa: F401  - what a command needs is no part of its figures
    import scipy.optimize  # noqa: F401

    from labhil.cli import main as labhil

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    answers = os.fdopen(os.dup(1), "w")
    requests = os.fdopen(os.dup(0), "r")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    print("{}", file=answers, flush=True)
    for line in requests:
        answer = _run(labhil, json.loads(line))
        print(json.dumps(answer), file=answers, flush=True)


def _run(labhil: Any, request: dict[str, Any]) -> dict[str, Any]:
    os.chdir(request["folder"])
    for number, name in ((1, request["stdout"]), (2, request["stderr"])):
        opened = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(opened, number)
        os.close(opened)
    sys.argv = ["labhil", *request["command"]]
    resting = _forget_peaks()
    begun, status, trace = time.monotonic(), 0, ""
    try:
        labhil()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:  # noqa: BLE001 - the traceback that a person would see
        status, trace = 1, traceback.format_exc()
    seconds = time.monotonic() - begun
    sys.stdout.flush()
    sys.stderr.flush()
    return {"status": status, "seconds": seconds, "memory": LOADED + _growth(resting), "traceback": trace}


def _family() -> list[int]:
    """This process and those that it has started and that still run."""
    processes = [os.getpid()]
    for number in processes:
        try:
            listed = Path(f"/proc/{number}/task/{number}/children").read_text(encoding="ascii")
        except OSError:
            continue
        processes += map(int, listed.split())
    return processes


def _forget_peaks() -> dict[int, int]:
    """Let the peaks of these processes begin anew, and return what each has now, by its number."""
    for number in _family():
        with suppress(OSError):
            Path(f"/proc/{number}/clear_refs").write_text("5", encoding="ascii")
    return {number: _bytes(number, "VmHWM") for number in _family()}


def _growth(resting: dict[int, int]) -> int:
    """Bytes of memory at most since then, of all these processes together, beyond what they had then."""
    return sum(_bytes(number, "VmHWM") - resting.get(number, 0) for number in _family())


def _bytes(number: int, what: str) -> int:
    with suppress(OSError):
        status = Path(f"/proc/{number}/status").read_text(encoding="ascii", errors="replace")
        return sum(int(line.split()[1]) << 10 for line in status.splitlines() if line.startswith(what))
    return 0


if __name__ == "__main__":
    main()
