"""What the wire tests share: twins as processes of their own."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

PROGRAM = """
import json, sys
from labhil.driver import TwinOptions
from labhil.plugins import load_twin
options = json.loads(sys.argv[2])
options["terms"] = None if options["terms"] is None else tuple(options["terms"])
load_twin(sys.argv[1]).serve(TwinOptions(**options), lambda address: print(address, flush=True))
"""


@contextlib.contextmanager
def twin_process(
    kind: str,
    wire: str = "pty",
    speed: float = 1.0,
    seed: int = 1,
    terms: list[str] | None = None,
    **parameters: float,
) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Start a twin; gives its address and its process, and stops it in the end."""
    options = {"wire": wire, "speed": speed, "seed": seed, "terms": terms, "parameters": parameters}
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(path for path in sys.path if path))
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, kind, json.dumps(options)],
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
    """What starts a ball and beam; see :func:`twin_process`."""
    return functools.partial(twin_process, "ball_beam")


@pytest.fixture(scope="session")
def twin_of() -> Callable[..., contextlib.AbstractContextManager[tuple[str, subprocess.Popen[str]]]]:
    """What starts a twin of any kind; see :func:`twin_process`."""
    return twin_process
