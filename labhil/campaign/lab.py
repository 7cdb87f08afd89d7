"""``labhil serve``: run the devices, the recorder and the worker of a lab."""

from __future__ import annotations

import threading
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path

from labhil.bus.register import check_loopback
from labhil.bus.session import open_bus
from labhil.campaign.policies import Policies, check_policies
from labhil.campaign.worker import Worker
from labhil.experiment.interruption import Interruption
from labhil.experiment.lab import Lab, load_lab
from labhil.experiment.lab_service import LabService, make_recordings_folder
from labhil.memory import keep_few_arenas
from labhil.supervised import SupervisedThread
from labhil.terminal import show


def serve_lab(
    config: Path | None, folder: Path | None, connect: str | None, say: Callable[[str], None]
) -> int:
    """Serve a lab until SIGINT, SIGTERM or SIGHUP, and print the endpoint of the bus.

    Args:
        config: the lab file; None for the example of a simulated lab.
        folder: folder of the recordings; None for that of the lab file.
        connect: endpoint of a bus on this machine to join; None to open one.
        say: is called with lines of text.

    Returns:
        Exit status: 0, or 1 where a device was lost.

    Raises:
        ExperimentFileError, RigFileError, UsageError: before anything starts.
    """
    lab = load_lab(config) if config is not None else _example_lab()
    check_policies(lab)
    # without a lab file the recordings go to the current folder
    recordings_folder = make_recordings_folder(
        lab, folder if folder is not None or config is not None else Path()
    )
    endpoint = None if connect is None else check_loopback(connect)
    keep_few_arenas()
    with Interruption() as interrupted, open_bus(endpoint) as bus:
        worker = Worker(recordings_folder, Policies.of_lab(lab).tasks, bus, say)
        show(bus.endpoint)  # recordings that appear in the folder from now on are studied
        done = threading.Event()
        worker_thread = SupervisedThread(lambda: _poll_until(worker, done, say), "worker")
        bus.watch(worker_thread)  # the service ends in order when this thread fails
        worker_thread.start()
        service = LabService(lab, bus, recordings_folder, say)
        try:
            service.run(interrupted)
        finally:
            worker_thread.end()
            bus.unwatch(worker_thread)
            done.set()
            worker_thread.join()
            worker.close()
    return 1 if service.failed else 0


def _example_lab() -> Lab:
    with as_file(files("labhil.experiment") / "examples" / "lab.toml") as path:
        return load_lab(path)


def _poll_until(
    worker: Worker, done: threading.Event, say: Callable[[str], None], period: float = 0.3
) -> None:
    """Poll the worker every ``period`` s until ``done`` is set."""
    while not done.wait(period):
        try:
            worker.poll()
        except Exception as error:  # noqa: BLE001
            # devices are served and recorded even if every analysis fails
            say(f"the worker: {error}")
