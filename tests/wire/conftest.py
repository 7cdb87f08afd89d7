"""What the wire tests share: a ball-and-beam twin as a process of its own."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

PROGRAM = """
import json, sys
from labhil.driver import TwinOptions
from labhil_sim_ball_beam import TWIN
options = json.loads(sys.argv[1])
options["terms"] = None if options["terms"] is None else tuple(options["terms"])
TWIN.serve(TwinOptions(**options), lambda address: print(address, flush=True))
"""


@contextlib.contextmanager
def twin_process(
    wire: str = "pty", speed: float = 1.0, seed: int = 1, terms: list[str] | None = None, **parameters: float
) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Start a twin; gives its address and its process, and stops it in the end."""
    options = {"wire": wire, "speed": speed, "seed": seed, "terms": terms, "parameters": parameters}
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path))
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, json.dumps(options)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert process.stdin is not None and process.stdout is not None
    try:
        yield process.stdout.readline().strip(), process
    finally:
        process.stdin.close()
        status = process.wait(10)
        process.stdout.close()
    assert status == 0


@pytest.fixture(scope="session")
def ball_beam_twin() -> Callable[..., contextlib.AbstractContextManager[tuple[str, subprocess.Popen[str]]]]:
    """What starts a twin; see :func:`twin_process`."""
    return twin_process
