"""Probes of libraries, each in a process of its own, so that a crash of a library is only a finding.

``python -m labhil.doctor.probes NAME`` prints what it found and ends with status 0 where the library works.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from labhil.doctor.finding import Finding, broken, fine, note
from labhil.errors import MissingExtraError
from labhil.extras import require
from labhil.terminal import complain, show

TIMEOUT = 120.0
"""How long a probe may take, s: the first compilation is slow."""

ADVICE = {
    "compiler": "pip install --force-reinstall numba llvmlite; `labhil fit` and `diagnose` need it",
    "cache": "set NUMBA_CACHE_DIR to a folder that can be written; models cannot be compiled without",
    "bus": "allow connections to 127.0.0.1 (firewall, container) or reinstall eclipse-zenoh; runs need it",
    "pty": "mount /dev/pts; twins on a pty need it (`labhil twin KIND --wire tcp` does not)",
    "recording": "pip install --force-reinstall mcap lz4 protobuf; nothing can be recorded or read without",
}

NEEDED = {"compiler": "numba", "cache": "numba", "bus": "zenoh", "pty": "serial"}
"""The package that a probe needs, where an installation without some extras may lack it."""


def check_probes() -> Iterator[Finding]:
    """Run all probes, each in a process of its own."""
    for name in PROBES:
        yield run_probe(name)


def run_probe(name: str) -> Finding:
    """Run one probe in a process of its own; the last line that it prints is the finding."""
    command = [sys.executable, "-P", "-m", "labhil.doctor.probes", name]
    try:
        if name in NEEDED:
            require(NEEDED[name], "this")
    except MissingExtraError as error:
        what, _, advice = str(error).partition(": ")
        return note(name, f"not tried: {what}", advice)
    try:
        process = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT, check=False, stdin=subprocess.DEVNULL
        )
    except subprocess.TimeoutExpired:
        return broken(name, f"did not end within {TIMEOUT:g} s", ADVICE[name])
    except OSError as error:
        return broken(name, f"no process could be started: {error}", ADVICE[name])
    lines = (process.stdout if process.returncode == 0 else process.stderr).strip().splitlines()
    last = lines[-1] if lines else f"ended with status {process.returncode} without a word"
    return fine(name, last) if process.returncode == 0 else broken(name, last, ADVICE[name])


def _compiler() -> str:
    import numba

    begun = time.perf_counter()
    double = numba.njit(lambda x: 2.0 * x + 1.0)
    if double(20.5) != 42.0:
        raise RuntimeError(f"expected 42 from a compiled function, found {double(20.5)}")
    return f"numba {numba.__version__} compiles; the first function took {time.perf_counter() - begun:.1f} s"


def _cache() -> str:
    from pathlib import Path

    from numba.core import caching

    import labhil.physics.friction as laws

    law = next(value for value in vars(laws).values() if hasattr(value, "py_func"))
    cache: Callable[..., Any] = caching.FunctionCache
    folder = Path(cache(law.py_func).cache_path)
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / f".doctor-{os.getpid()}"
    probe.write_bytes(b"")
    probe.unlink()
    return f"compiled kernels are kept in {folder}"


def _bus() -> str:
    from zenoh import Query

    from labhil.bus.session import open_bus

    key = "labhil/doctor"

    def answer(query: Query) -> None:
        query.reply(key, b"42")

    with open_bus() as first:
        queryable = first.session.declare_queryable(key, answer)
        with open_bus(first.endpoint) as second:
            begun = time.perf_counter()
            deadline = begun + 10.0
            while time.perf_counter() < deadline:
                replies = [
                    reply.ok.payload.to_bytes() for reply in second.session.get(key, timeout=2.0) if reply.ok
                ]
                if replies == [b"42"]:
                    took = time.perf_counter() - begun
                    queryable.undeclare()
                    return f"two zenoh sessions on {first.endpoint} found each other in {1000 * took:.0f} ms"
                time.sleep(0.05)
    raise RuntimeError("two zenoh sessions on 127.0.0.1 did not hear each other within 10 s")


def _pty() -> str:
    import tty

    import serial

    master, device = os.openpty()
    tty.setraw(device)
    name = os.ttyname(device)
    with serial.Serial(name, timeout=2.0) as port:
        os.write(master, b"labhil")
        received = port.read(6)
    os.close(master)
    os.close(device)
    if received != b"labhil":
        raise RuntimeError(f"expected b'labhil' through {name}, found {received!r}")
    return f"a pseudo-terminal ({name}) carries bytes to a serial port"


def _recording() -> str:
    import tempfile
    from pathlib import Path

    import numpy as np

    from labhil.recording import RecordingWriter, read_recording
    from labhil.signals import Batch, Direction, Signal, Stream

    count = np.arange(1000, dtype=np.int64)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "doctor.mcap"
        with RecordingWriter(path) as writer:
            channel = writer.add_stream(
                "doctor", Stream("state", (Signal("x", "m", Direction.OUTPUT),), 100.0)
            )
            writer.write(channel, Batch(count, count, count, count[:, None] / 7.0))
        read = read_recording(path).stream_with("x")["x"]
    if not np.array_equal(read, count / 7.0):
        raise RuntimeError("a recording that was written is not what was read")
    return "a recording was written, read back and is the same"


PROBES: Mapping[str, Callable[[], str]] = {
    "compiler": _compiler,
    "cache": _cache,
    "bus": _bus,
    "pty": _pty,
    "recording": _recording,
}


if __name__ == "__main__":
    try:
        show(PROBES[sys.argv[1]]())
    except Exception as fault:  # noqa: BLE001 - whatever a library raises is the finding
        complain(f"{type(fault).__name__}: {fault}")
        sys.exit(1)
