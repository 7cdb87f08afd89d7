"""A lab that stays up: the hosts of its devices on one bus, recorded in one file after another.

A device that fails does not stop the others. However a service ends, every device is brought to its safe
state, the hosts end, the recording gets its name, the simulated devices are stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from labhil.atomic_file import make_folder
from labhil.bus.publish import publish_event
from labhil.bus.register import register
from labhil.bus.session import Bus
from labhil.errors import BusError, LabhilError, RecordingFailedError, RunStoppedError
from labhil.experiment.attachments import attach_rigs
from labhil.experiment.devices import end_hosts, host_config
from labhil.experiment.experiment import TWIN, RecordSection
from labhil.experiment.lab import Lab
from labhil.experiment.plan import DevicePlan, device_plan
from labhil.experiment.remote import offer_status
from labhil.experiment.result import free_path
from labhil.experiment.twins import start_twin
from labhil.host_clock import session_clock, unix_ns
from labhil.memory import give_back
from labhil.service.hosts import HostProcess
from labhil.service.recorded import RecordingSummary
from labhil.service.recorder import Recorder

CHECK_INTERVAL = 0.2
"""How often devices and the recording are checked, s."""

LAB = "lab"


class LabService:
    """Serves and records the devices of a lab.

    Args:
        lab: The lab file.
        bus: The bus, open already.
        folder: Where recordings go.
        report: Is called with each line for the operator.
    """

    def __init__(self, lab: Lab, bus: Bus, folder: Path, report: Callable[[str], None]) -> None:
        self._lab, self._bus, self._folder, self._report = lab, bus, folder, report
        self._plans = [device_plan(lab, name) for name in lab.devices]
        self._hosts: dict[str, HostProcess] = {}
        self._recorder: Recorder | None = None
        self._recording_began = 0.0
        self.failed: dict[str, LabhilError] = {}

    def run(self, ended: Callable[[], bool]) -> None:
        """Serve until ``ended`` returns true.

        Raises:
            LabhilError: All devices have failed, or nothing can be recorded.
        """
        names = [plan.name for plan in self._plans]
        reachable = register(LAB, self._lab.lab.name, self._bus.endpoint, names)
        with session_clock(), ExitStack() as twins, reachable:
            offer_status(self._bus, self._status, twins)
            try:
                self._record()
                for plan in self._plans:
                    self._start(plan, twins, ended)
                while not ended():
                    time.sleep(CHECK_INTERVAL)
                    self._check()
            except RunStoppedError:
                self._stop()
            except BaseException as error:
                self._stop(error)
                raise
            else:
                self._stop()

    def _start(self, plan: DevicePlan, twins: ExitStack, ended: Callable[[], bool]) -> None:
        """Start a device and wait for it; a failure is reported and does not stop the others."""
        try:
            address = plan.section.address
            if address == TWIN:
                address = self._start_twin(plan, twins, ended)
            patient = plan.section.reconnect
            host = HostProcess(replace(host_config(plan, address, self._bus.endpoint), patient=patient))
            self._hosts[plan.name] = host
            if host.wait_reported(ended) is None:
                self._report(f"{plan.name}: {host.absent}; the search goes on as long as this service lasts")
            else:
                self._report_up(plan.name)
        except RunStoppedError:
            raise
        except LabhilError as error:
            self._lose(plan.name, error)

    def _start_twin(self, plan: DevicePlan, twins: ExitStack, ended: Callable[[], bool]) -> str:
        answer = self._folder / f"{self._lab.lab.name}.{plan.name}.twin.json"
        section, directory = plan.section.twin, self._lab.path.parent
        twin, address = start_twin(plan.name, plan.section.plugin, section, answer, ended, directory)
        twins.callback(twin.stop)
        return address

    def _check(self) -> None:
        if fault := self._bus.failure():
            raise BusError(f"the service no longer hears everything: {fault}")
        for name, host in list(self._hosts.items()):
            try:
                if host.absent and host.has_connected():
                    self._report_up(name)
                failure = host.failure()
            except LabhilError as error:
                failure = error
            if failure is not None:
                self._lose(name, failure)
        if self._recorder is not None:
            self._recorder.check()
        if self._recorder is not None and time.monotonic() - self._recording_began > self._lab.lab.roll:
            self._record()

    def _report_up(self, name: str) -> None:
        config = self._hosts[name].config
        self._report(f"{name}: {config.plugin} at {config.address} is up")

    def _status(self) -> dict[str, Any]:
        """Return the answer to the request ``status``."""
        hosts = dict(self._hosts)
        absent = {name: host.absent for name, host in hosts.items() if host.absent}
        return {
            "state": "serving",
            "reason": "",
            "name": self._lab.lab.name,
            "devices": [plan.name for plan in self._plans],
            "up": [name for name in hosts if name not in absent],
            "absent": absent,
            "failed": {name: str(error) for name, error in self.failed.items()},
            "path": None if self._recorder is None else str(self._recorder.summary().path),
        }

    def _lose(self, name: str, error: LabhilError) -> None:
        """Continue without a device; raises its error where it was the last one."""
        self.failed[name] = error
        host = self._hosts.pop(name, None)
        if host is not None:
            host.stop()
        self._report(f"{name}: {error}")
        event = {"t_ns": unix_ns(), "kind": "failed", "state": "failed", "message": str(error)}
        publish_event(self._bus, name, event)
        if len(self.failed) == len(self._plans):
            raise error

    def _record(self) -> None:
        """Begin a recording, then end the one before it, so that no sample falls between them."""
        if not self._lab.lab.record or not self._plans:
            return
        previous = self._recorder
        path = free_path(self._folder, RecordSection().path, self._lab.lab.name)
        metadata = {"lab": {"name": self._lab.lab.name, "roll": repr(self._lab.lab.roll)}}
        attachments = attach_rigs(self._plans)
        self._recorder = Recorder(self._bus, path, attachments=attachments, metadata=metadata)
        self._recording_began = time.monotonic()
        if previous is not None:
            self._report_recording(previous.finish("0", "the next recording began"))
            give_back()

    def _report_recording(self, summary: RecordingSummary) -> None:
        self._report(f"recorded {summary.path}")
        for warning in summary.warnings:
            self._report(f"{summary.path}: {warning}")

    def _stop(self, error: BaseException | None = None) -> None:
        """End the hosts first, concurrently; then complete the recording, with ``error`` as its reason."""
        end_hosts(list(self._hosts.values()))
        if self._recorder is None:
            return
        status = 0 if error is None else error.exit_status if isinstance(error, LabhilError) else 1
        reason = "the service ended" if error is None else f"the service failed: {error}"
        try:
            summary = self._recorder.finish(str(status), reason)
        except RecordingFailedError as failure:
            if error is None:
                raise
            self._report(str(failure))  # the error that ended the service takes precedence
        else:
            if any(stream.samples for stream in summary.streams):
                self._report_recording(summary)
            else:
                summary.path.unlink()


def make_recordings_folder(lab: Lab, folder: Path | None) -> Path:
    """Make the folder of the recordings and return it.

    Args:
        lab: The lab file.
        folder: The folder, instead of that in the lab file.

    Raises:
        UsageError: It cannot be made.
    """
    folder = folder if folder is not None else lab.path.parent / lab.lab.folder
    make_folder(folder, "recordings")
    return folder
