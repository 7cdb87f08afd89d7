"""``labhil serve``: devices, recorder and worker, from the first process to the last."""

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

LOOK = 0.3
"""How often the worker looks for something to do, s."""


def serve_lab(
    config: Path | None, folder: Path | None, connect: str | None, say: Callable[[str], None]
) -> int:
    """Serve until SIGINT, SIGTERM or SIGHUP; returns 0, or 1 where a device was lost on the way.

    Prints the bus's endpoint. Raises ExperimentFileError, RigFileError or UsageError before anything starts.
    """
    lab = load_lab(config) if config is not None else _example()
    check_policies(lab)
    # without a file nothing is known of where its user keeps things
    place = make_recordings_folder(lab, folder if folder is not None or config is not None else Path())
    endpoint = None if connect is None else check_loopback(connect)
    keep_few_arenas()
    with Interruption() as interrupted, open_bus(endpoint) as bus:
        worker = Worker(place, Policies.of(lab).tasks, bus, say)
        show(bus.endpoint)  # what appears in the folder from now on is studied
        done = threading.Event()
        at_work = SupervisedThread(lambda: _work(worker, done, say), "worker")
        bus.watch(at_work)  # the service ends in order where nothing is analysed any more
        at_work.start()
        service = LabService(lab, bus, place, say)
        try:
            service.run(interrupted)
        finally:
            at_work.end()
            bus.unwatch(at_work)
            done.set()
            at_work.join()
            worker.close()
    return 1 if service.failed else 0


def _example() -> Lab:
    with as_file(files("labhil.experiment") / "examples" / "lab.toml") as path:
        return load_lab(path)


def _work(worker: Worker, done: threading.Event, say: Callable[[str], None]) -> None:
    while not done.wait(LOOK):
        try:
            worker.look()
        except Exception as error:  # noqa: BLE001
            # devices are served and recorded whatever becomes of an analysis
            say(f"the worker: {error}")
