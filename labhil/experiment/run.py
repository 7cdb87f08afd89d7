"""Runs an experiment from its first process to the last byte of its recording.

However a run ends, these things happen, in this order, each whether or not the one before it worked:
every device is brought to its safe state, the hosts end, the recording is finished and gets its name,
the simulated devices are stopped.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from labhil.bus.publish import publish_event
from labhil.bus.session import Bus, open_bus
from labhil.errors import BusError, LabhilError, RunStoppedError, UsageError
from labhil.experiment.device_run import DeviceRun
from labhil.experiment.experiment import TWIN, Experiment
from labhil.experiment.interruption import Interruption
from labhil.experiment.plan import DevicePlan, Plan, make_plan
from labhil.experiment.twins import start_twin
from labhil.service.hosts import HostProcess
from labhil.service.messages import HostConfig
from labhil.service.recorder import Recorder, RecordingSummary, StreamSummary

PROGRESS_INTERVAL = 0.1
SILENCE = 3.0
"""How long the samples of a device may stay away while its host lives, s."""


class RunState(StrEnum):
    """What a run is doing; every change is an event in the recording, with its reason."""

    IDLE = "idle"
    STARTING = "starting"
    RUNNING = "running"
    STOPPING = "stopping"
    FINISHED = "finished"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run has come: ``elapsed`` of ``duration``, s of the slowest device's clock."""

    state: RunState
    elapsed: float
    duration: float
    message: str


@dataclass(frozen=True, slots=True)
class RunResult:
    """What came of a run. ``path`` is None when nothing was recorded.

    ``duration`` (s) and the rates of ``streams`` (Hz) are measured, in seconds of the devices' worlds.
    ``error`` is why it came to grief, None when all went well; ``reason`` says either in words.
    """

    path: Path | None
    exit_status: int
    duration: float
    streams: tuple[StreamSummary, ...]
    reason: str
    error: LabhilError | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the result as the contract's ``labhil.run/1``."""
        streams = [
            {
                "device": stream.device,
                "stream": stream.stream,
                "samples": stream.samples,
                "gaps": stream.gaps,
                "rate": stream.rate,
            }
            for stream in self.streams
        ]
        return {
            "schema": "labhil.run/1",
            "path": None if self.path is None else str(self.path),
            "exit_status": self.exit_status,
            "duration": self.duration,
            "streams": streams,
            "reason": self.reason,
        }


def run_experiment(
    experiment: Experiment, out_dir: Path, progress: Callable[[Progress], None] = lambda _progress: None
) -> RunResult:
    """Run ``experiment`` and leave its recording in ``out_dir``, whatever happens on the way.

    Raises ExperimentFileError, RigFileError, or UsageError for a directory that cannot be made, before
    anything is started. Everything that goes wrong after that is told by the result. In the main thread
    SIGINT, SIGTERM and SIGHUP stop the run in order.
    """
    plan = make_plan(experiment)
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{out_dir}: expected a directory for the recording, found {error}") from error
    with Interruption() as interrupted:
        return _Run(plan, recording_path(experiment, out_dir), progress, interrupted).run()


def recording_path(experiment: Experiment, out_dir: Path) -> Path:
    """Return where the recording goes; where that name is taken, a number is added."""
    name = re.sub(r"[^\w.+-]+", "_", experiment.experiment.name)
    start = time.strftime("%Y%m%dT%H%M%S")
    wanted = out_dir / experiment.record.path.format(name=name, start=start)
    path, number = wanted, 1
    while path.exists() or path.with_name(path.name + ".part").exists():
        number += 1
        path = wanted.with_name(f"{wanted.stem}-{number}{wanted.suffix}")
    return path


def answer_path(recording: Path, device: str, several: bool) -> Path:
    """Return where a twin writes what it is made of: beside the recording."""
    return recording.with_suffix(f".{device}.twin.json" if several else ".twin.json")


class _Run:
    def __init__(
        self, plan: Plan, path: Path, progress: Callable[[Progress], None], interrupted: Interruption
    ) -> None:
        self._plan, self._path, self._progress, self._interrupted = plan, path, progress, interrupted
        self._state = RunState.IDLE
        self._changed = threading.Event()
        self._bus: Bus | None = None
        self._hosts: list[HostProcess] = []
        self._devices: list[DeviceRun] = []
        self._error: LabhilError | None = None

    def run(self) -> RunResult:
        with ExitStack() as twins:
            try:
                with open_bus() as self._bus:
                    return self._recorded(self._bus, twins)
            except LabhilError as error:
                # only what happens before there is a recorder, or to the recorder itself, comes by here
                return RunResult(self._kept(), error.exit_status, 0.0, (), str(error), error)
            finally:
                self._bus = None

    def _recorded(self, bus: Bus, twins: ExitStack) -> RunResult:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        recorder = Recorder(bus, self._path, attachments=self._attachments(), metadata=self._metadata())
        with recorder, ExitStack() as subscriptions:
            try:
                self._become(RunState.STARTING, "starting")
                self._start(bus, twins, subscriptions)
                self._become(RunState.RUNNING, "all devices are connected")
                self._follow(recorder)
            except LabhilError as error:
                self._error = error
            finally:
                self._stop_devices()
            reason = str(self._error) if self._error else "all steps are done"
            self._become(RunState.FAILED if self._error else RunState.FINISHED, reason)
            subscriptions.close()
            status = self._error.exit_status if self._error else 0
            summary = recorder.finish(str(status), reason)
        return self._result(summary, status, reason)

    # starting

    def _start(self, bus: Bus, twins: ExitStack, subscriptions: ExitStack) -> None:
        for device in self._plan.devices:
            address = device.section.address
            if address == TWIN:
                address = self._start_twin(device, twins)
            config = HostConfig(device.name, device.section.plugin, address, device.rig.limits, bus.endpoint)
            self._hosts.append(HostProcess(config))
        for device, host in zip(self._plan.devices, self._hosts, strict=True):
            connected = host.wait_connected(self._interrupted)
            run = DeviceRun(bus, device, connected, self._plan.duration, self._changed)
            self._devices.append(subscriptions.enter_context(run))
        for run in self._devices:
            run.take_lease(f"run {self._plan.experiment.experiment.name}")
        for run in self._devices:
            run.start()

    def _start_twin(self, device: DevicePlan, twins: ExitStack) -> str:
        several = sum(other.section.address == TWIN for other in self._plan.devices) > 1
        answer = answer_path(self._path, device.name, several)
        twin, address = start_twin(
            device.name,
            device.section.plugin,
            device.section.twin,
            answer,
            self._interrupted,
            self._plan.experiment.path.parent,
        )
        twins.callback(twin.stop)
        self._refuse_interruption()
        return address

    def _attachments(self) -> dict[str, bytes]:
        attachments = {"experiment.toml": self._plan.experiment.public_text().encode()}
        for index, device in enumerate(self._plan.devices):
            name = "rig.toml" if index == 0 else f"rig.{device.name}.toml"
            attachments[name] = device.rig.text.encode()
        return attachments

    def _metadata(self) -> dict[str, dict[str, str]]:
        section = self._plan.experiment.experiment
        return {"experiment": {"name": section.name, "duration": repr(self._plan.duration)}}

    # running

    def _follow(self, recorder: Recorder) -> None:
        while not all(device.done for device in self._devices):
            self._changed.wait(PROGRESS_INTERVAL)
            self._changed.clear()
            self._refuse_interruption()
            if recorder.failure is not None:
                raise recorder.failure
            self._look_after_devices()
            self._report("")

    def _look_after_devices(self) -> None:
        for host in self._hosts:
            failure = host.failure()
            if failure is not None:
                raise failure
        for device in self._devices:
            trouble = device.failure()
            if trouble is not None:
                raise trouble
            if time.monotonic() - device.heard_at > SILENCE:
                raise BusError(f"{device.plan.name}: no samples on the bus for {SILENCE:g} s")

    def _refuse_interruption(self) -> None:
        if self._interrupted():
            raise RunStoppedError(f"stopped by {self._interrupted.reason}")

    # stopping

    def _stop_devices(self) -> None:
        self._become(RunState.STOPPING, str(self._error) if self._error else "all steps are done")
        for device in self._devices:
            self._make_safe(device)
        for host in self._hosts:
            host.tell_to_end()
        for host in self._hosts:
            host.stop()

    def _make_safe(self, device: DeviceRun) -> None:
        """Ask for the safe state at once; a host that does not answer is ended anyhow, and others go on."""
        try:
            device.make_safe("the run ends")
        except LabhilError as error:
            self._error = self._error or error

    def _become(self, state: RunState, reason: str) -> None:
        self._state = state
        if self._bus is not None:
            event = {"t_ns": time.time_ns(), "kind": state.value, "state": state.value, "message": reason}
            publish_event(self._bus, "run", event)
        self._report(reason)

    def _report(self, message: str) -> None:
        elapsed = min((device.elapsed for device in self._devices), default=0.0)
        duration = self._plan.duration
        self._progress(Progress(self._state, min(elapsed, duration), duration, message))

    # the result

    def _result(self, summary: RecordingSummary, status: int, reason: str) -> RunResult:
        if not any(stream.samples for stream in summary.streams):
            # an empty file would only look like a recording
            summary.path.unlink()
            return RunResult(None, status, 0.0, (), reason, self._error)
        speeds = {device.plan.name: device.speed for device in self._devices}
        streams = tuple(
            replace(stream, rate=stream.rate / speeds.get(stream.device, 1.0)) for stream in summary.streams
        )
        return RunResult(summary.path, status, _duration(streams), streams, reason, self._error)

    def _kept(self) -> Path | None:
        part = self._path.with_name(self._path.name + ".part")
        return next((path for path in (self._path, part) if path.exists()), None)


def _duration(streams: tuple[StreamSummary, ...]) -> float:
    spans = [(s.samples + s.gaps - 1) / s.rate for s in streams if s.rate > 0]
    return max(spans, default=0.0)
