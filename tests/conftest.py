"""What every test has to leave behind: nothing that runs, nothing that listens."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from xdist.scheduler import LoadScopeScheduling

from labhil.cores import POOL_NAME

# Two processes share the tests out. With a thread for each core in both, threads wait for each other by
# counting, in products of small matrices: two thirds of the time went there. numpy and scipy read this when
# they are loaded, which comes later; child processes inherit it.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).parent))  # for patient_labhil, which tests import

PATIENCE = 20.0
# kept by the standard library for the life of the process, once a process pool was used
# and by us, for the next file that is read in a process of its own
KEPT_PROCESSES = ("resource_tracker", "forkserver", "labhil.recording.formats.reader_process")

KEEPING_TIME = ("bus", "firmware", "matrix", "run", "tui", "wire")
"""Folders whose tests run devices and hosts in real time: never two of them at once."""


WORKER = os.environ.get("PYTEST_XDIST_WORKER", "").removeprefix("gw")
CORES = sorted(os.sched_getaffinity(0))


def keeps_time(path: Path) -> bool:
    """Whether the tests of a file do."""
    return path.parent.name in KEEPING_TIME


class ByFile(LoadScopeScheduling):
    """Shares the tests out by file; those that keep time are one share."""

    def _split_scope(self, nodeid: str) -> str:
        path = Path(nodeid.partition("::")[0])
        return "in real time" if keeps_time(path) else str(path)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByFile:
    """How two processes divide the work."""
    return ByFile(config, log)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Leave a core to the process whose tests keep time: beside a fit on all cores commands come too late."""
    if WORKER:
        own = [CORES[int(WORKER) % len(CORES)]]
        os.sched_setaffinity(0, CORES if keeps_time(item.path) else own)


@pytest.fixture(scope="session", autouse=True)
def runtime_directory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep an emergency stop that a test presses among the tests of this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
        yield


@pytest.fixture(autouse=True)
def patient_watchdogs(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the hosts of a run in this process wait longer for commands, as ``patient_labhil`` does.

    Tests of the watchdog itself make their hosts' configurations themselves.
    """
    if request.path.parent.name in {*KEEPING_TIME, "campaign"}:
        import patient_labhil

        monkeypatch.setattr("labhil.experiment.devices.HostConfig", patient_labhil.patient_config)
        monkeypatch.setattr("labhil.experiment.twins.twin_command", patient_labhil.patient_twin_command)


@pytest.fixture(autouse=True)
def nothing_left_running() -> Iterator[None]:
    """Fail a test that leaves a thread, a child process or a listening port (a bus session has one)."""
    before = running()
    yield
    deadline = time.monotonic() + PATIENCE
    while (left := running() - before) and time.monotonic() < deadline:
        time.sleep(0.02)
    if left:
        pytest.fail(f"left behind: {', '.join(sorted(left))}")


def running() -> set[str]:
    """Describe the threads, child processes and listening ports of this process."""
    me = psutil.Process()
    return {*_threads(), *_children(me), *_listening(me)}


def _threads() -> Iterator[str]:
    for thread in threading.enumerate():
        # a thread that Python did not start is only a name for a caller that came by
        came_by = isinstance(thread, threading._DummyThread)
        # those that share the cores wait for the next simulation, as long as the process lives
        if not came_by and not thread.name.startswith(POOL_NAME):
            yield f"thread {thread.name} ({thread.ident})"


def _children(me: psutil.Process) -> Iterator[str]:
    for child in me.children(recursive=True):
        try:
            command = " ".join(child.cmdline())
        except psutil.Error:
            continue
        if not any(kept in command for kept in KEPT_PROCESSES):
            yield f"process {child.pid} {command}"


def _listening(me: psutil.Process) -> Iterator[str]:
    for connection in me.net_connections(kind="tcp"):
        if connection.status == psutil.CONN_LISTEN:
            yield f"port {connection.laddr.port}"
