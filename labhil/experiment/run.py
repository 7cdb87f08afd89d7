"""One run of an experiment, from starting its processes to completing its recording.

However a run ends, these steps happen in this order, each whether or not the one before it worked: every
device is brought to its safe state, the hosts end, the recording is completed and gets its name, the
simulated devices are stopped. Its devices are in ``devices.py``, its states in ``control.py``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from labhil.atomic_file import make_folder
from labhil.bus.authentication import Refusals
from labhil.bus.latch import read_latch
from labhil.bus.publish import publish_event
from labhil.bus.register import register
from labhil.bus.session import Bus, open_bus
from labhil.errors import (
    BusError,
    CommandRefusedError,
    EmergencyStopError,
    LabhilError,
    RunError,
    RunStoppedError,
    UsageError,
)
from labhil.experiment.around import AroundSteps
from labhil.experiment.attachments import attach_files, run_metadata
from labhil.experiment.control import RunControl, RunState
from labhil.experiment.devices import Devices, host_config, run_concurrently
from labhil.experiment.experiment import TWIN, Experiment
from labhil.experiment.hooks import Hook, load_hook
from labhil.experiment.interruption import Interruption, emergency_stop_or, raise_emergency_stop, reason_of
from labhil.experiment.plan import DevicePlan, Plan, make_plan
from labhil.experiment.points import is_campaign
from labhil.experiment.remote import offer_control
from labhil.experiment.result import (
    Progress,
    RunResult,
    answer_path,
    recording_path,
    remove_without_recording,
    result_of,
)
from labhil.experiment.twins import start_twin
from labhil.host_clock import session_clock, unix_ns
from labhil.service.recorder import Recorder

__all__ = [
    "Progress",
    "RunControl",
    "RunResult",
    "RunState",
    "answer_path",
    "recording_path",
    "run_experiment",
]

PROGRESS_INTERVAL = 0.1
"""How often a run checks its devices and reports progress, s."""
AFTER_EMERGENCY_STOP = 2.0
"""How long hosts stay after an emergency stop, s."""
MAX_HOLDER_LENGTH = 200
"""Characters of a run's name that are shown with the lease."""
SETTLING_TIME = 0.5
"""How long a device that follows a path is recorded after the order to stop, s."""


class _StopRequested(Exception):  # noqa: N818 - no error: an operator ends the steps early, in order
    pass


def run_experiment(
    experiment: Experiment,
    out_dir: Path,
    progress: Callable[[Progress], None] = lambda _progress: None,
    control: RunControl | None = None,
    *,
    path: Path | None = None,
    metadata: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
) -> RunResult:
    """Run an experiment once and leave its recording, however the run ends.

    Runs of ``repeat`` and ``[sweep]`` are made by :func:`labhil.experiment.campaign.run_campaign`. Errors
    after the start are in the result. In the main thread SIGINT, SIGTERM and SIGHUP abort the run.

    Args:
        experiment: The experiment.
        out_dir: Directory of the recording; it is made if need be.
        progress: Is called with every change of state and its reason, and with the progress in between.
        control: A handle to pause, stop or abort this run from another thread; other processes do so over
            the bus (:mod:`labhil.experiment.remote`).
        path: The recording, instead of the name in the experiment file.
        metadata: Tables that are added to the metadata of the recording.

    Raises:
        ExperimentFileError: The experiment cannot be run as it is.
        RigFileError: A rig file is wrong.
        UsageError: The directory cannot be made, the experiment describes several runs, or ``control``
            served another run.
        CommandRefusedError: The emergency stop is pressed.
    """
    control = RunControl() if control is None else control
    if control.state is not RunState.IDLE:
        raise UsageError(f"a RunControl serves one run; this one's is {control.state.value}: make another")
    if is_campaign(experiment):
        raise UsageError(
            f"{experiment.path}: expected one run, found `repeat` or [sweep]: `labhil run` makes all of them"
        )
    plan = make_plan(experiment)
    standing = read_latch()
    if standing is not None:
        raise CommandRefusedError(f"{standing.describe()}; release it with `labhil estop --release`")
    hook = load_hook(experiment)
    make_folder(out_dir, "the recording")
    with session_clock(), Interruption() as interrupted:
        path = recording_path(experiment, out_dir) if path is None else path
        return _Run(plan, hook, path, progress, interrupted, control, metadata).run()


class _Run:
    def __init__(
        self,
        plan: Plan,
        hook: Hook | None,
        path: Path,
        progress: Callable[[Progress], None],
        interrupted: Interruption,
        control: RunControl,
        metadata: Mapping[str, Mapping[str, str]],
    ) -> None:
        self._plan, self._path, self._progress = plan, path, progress
        self._extra_metadata = metadata
        self._interrupted, self._control = interrupted, control
        self._bus: Bus | None = None
        self._devices: Devices | None = None
        self._resumes_alone = False
        self._around = AroundSteps(plan.experiment, hook, path, control.changed)
        self._refusals = Refusals(lambda text: self._publish("rejected", text))

    def run(self) -> RunResult:
        with ExitStack() as twins:
            try:
                with open_bus() as self._bus, self._make_reachable(self._bus):
                    return self._record(self._bus, twins)
            except LabhilError as error:
                # only errors before there is a recorder, and those of the recorder itself, get here
                reason = reason_of(error)
                self._fail(reason)
                return RunResult(self._existing_recording(), error.exit_status, 0.0, (), reason, error)
            finally:
                self._bus = None

    @contextmanager
    def _make_reachable(self, bus: Bus) -> Iterator[None]:
        """Let other processes find this run and control it."""
        names = [device.name for device in self._plan.devices]
        section = self._plan.experiment.experiment
        with (
            register("run", section.name, bus.endpoint, names),
            offer_control(bus, self._control, self._describe, self._refusals),
        ):
            yield

    def _record(self, bus: Bus, twins: ExitStack) -> RunResult:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        recorder = Recorder(
            bus,
            self._path,
            attachments=attach_files(self._plan),
            metadata=run_metadata(self._plan, self._extra_metadata),
            waits=True,
            on_failure=self._control.changed.set,
        )
        name = f"run {self._plan.experiment.experiment.name}"
        self._devices = devices = Devices(
            bus, name[:MAX_HOLDER_LENGTH], self._plan.duration, self._control.changed, self._refusals
        )
        error: LabhilError | None = None
        reason = "all steps are done"
        with recorder, ExitStack() as subscriptions:
            try:
                self._transition(RunState.STARTING, "starting")
                self._connect(bus, devices, twins, subscriptions)
                self._around.before(devices, partial(self._poll, recorder, devices))
                devices.start()
                self._transition(RunState.RUNNING, "all devices are connected")
                recorder.begin()
                self._supervise(recorder, devices)
            except _StopRequested as request:
                reason = str(request)
            except LabhilError as exc:
                error = emergency_stop_or(exc)
            except Exception as exc:  # noqa: BLE001 - a bug must not look like a run that has ended well
                error = RunError(f"the run itself failed: {exc!r}")
                error.__cause__ = exc
            finally:
                failure = self._stop(recorder, devices, error, reason)
            error = emergency_stop_or(recorder.failure or error or failure)
            reason = reason if error is None else reason_of(error)
            self._transition(RunState.FINISHED if error is None else RunState.FAILED, reason)
            subscriptions.close()
            status = 0 if error is None else error.exit_status
            summary = recorder.finish(str(status), reason)
        speeds = {run.plan.name: run.speed for run in devices.runs}
        return result_of(summary, speeds, status, reason, error)

    # starting

    def _connect(self, bus: Bus, devices: Devices, twins: ExitStack, subscriptions: ExitStack) -> None:
        try:
            self._handle_requests()
            addresses = self._addresses(twins)
            self._handle_requests()
            for device in self._plan.devices:
                devices.start_host(host_config(device, addresses[device.name], bus.endpoint))
            devices.connect(self._plan.devices, subscriptions, self._is_to_end)
        except RunStoppedError:
            self._handle_requests()  # raises the reason of the stop, which may be no error
            raise

    def _addresses(self, twins: ExitStack) -> dict[str, str]:
        """Return the address of every device; simulated ones are started, concurrently."""
        addresses = {device.name: device.section.address for device in self._plan.devices}
        simulated = [device for device in self._plan.devices if addresses[device.name] == TWIN]

        def start(device: DevicePlan) -> None:
            addresses[device.name] = self._start_twin(device, twins)

        outcomes = run_concurrently([partial(start, device) for device in simulated])
        for error in outcomes:
            if error is not None:
                raise error
        return addresses

    def _start_twin(self, device: DevicePlan, twins: ExitStack) -> str:
        are_several = sum(candidate.section.address == TWIN for candidate in self._plan.devices) > 1
        answer = answer_path(self._path, device.name, are_several)
        twins.callback(remove_without_recording, answer, self._path)
        twin, address = start_twin(
            device.name,
            device.section.plugin,
            device.section.twin,
            answer,
            self._is_to_end,
            self._plan.experiment.path.parent,
        )
        twins.callback(twin.stop)
        return address

    def _is_to_end(self) -> bool:
        return self._interrupted() or self._control.is_to_end()

    # running

    def _supervise(self, recorder: Recorder, devices: Devices) -> None:
        while not devices.done:
            self._control.changed.wait(PROGRESS_INTERVAL)
            self._control.changed.clear()
            self._publish_steps(devices)
            self._poll(recorder, devices)
            self._pause_or_resume(devices)
            self._report("")
        self._publish_steps(devices)

    def _publish_steps(self, devices: Devices) -> None:
        for text in devices.step_notes():
            self._publish("step", text)

    def _poll(self, recorder: Recorder, devices: Devices) -> None:
        """Carry out requests, and raise the error of anything that has failed."""
        self._handle_requests()
        self._check(recorder, devices)

    def _check(self, recorder: Recorder, devices: Devices) -> None:
        if self._interrupted():
            raise RunStoppedError(f"stopped by {self._interrupted.reason}")
        recorder.check()
        devices.check()
        raise_emergency_stop()

    def _handle_requests(self) -> None:
        """Carry out requests; raises _StopRequested or RunStoppedError for a request to end."""
        for t_ns, text in self._control.take_marks():
            self._publish("mark", text, t_ns)
        if self._interrupted():
            raise RunStoppedError(f"stopped by {self._interrupted.reason}")
        state, reason = self._control.take_request() or (None, "")
        if state is RunState.STOPPING:
            raise _StopRequested(reason)
        if state is RunState.ABORTING:
            raise RunStoppedError(reason)
        if state is RunState.PAUSED:
            self._resumes_alone = False
            self._pause(reason)
        elif state is RunState.RUNNING:
            self._resume(reason)

    def _pause_or_resume(self, devices: Devices) -> None:
        """Pause where a device needs it; resume only where its host announces that it is ready again."""
        pause_reason = devices.pause_reason()
        if self._control.state is RunState.RUNNING and pause_reason:
            self._resumes_alone = devices.resume_alone()
            self._pause(pause_reason)
        elif self._control.state is RunState.PAUSED and self._resumes_alone:
            self._resumes_alone = devices.resume_alone()
            if not pause_reason:
                self._resume("all devices are back")

    def _pause(self, reason: str) -> None:
        assert self._devices is not None
        failure = self._devices.make_safe(f"paused: {reason}")
        if failure is not None:
            raise failure
        self._transition(RunState.PAUSED, reason)

    def _resume(self, reason: str) -> None:
        assert self._devices is not None
        try:
            self._devices.start()
        except CommandRefusedError as error:
            self._devices.make_safe("not resumed")
            message = f"the run stays paused: {error}"
            self._publish("refused", message)
            self._control.refuse(message)
            self._report(message)
            return
        self._transition(RunState.RUNNING, reason)

    # stopping

    def _stop(
        self, recorder: Recorder, devices: Devices, error: LabhilError | None, reason: str
    ) -> LabhilError | None:
        if error is None:
            self._transition(RunState.STOPPING, reason)
        else:
            self._transition(RunState.ABORTING, str(error))
        failure = devices.make_safe("the run ends")
        if isinstance(error, EmergencyStopError):
            # the sender of the stop still waits for the answer of each host, and the stop itself is recorded
            time.sleep(AFTER_EMERGENCY_STOP)
        elif any(device.spec.waypoint_rate for device in self._plan.devices):
            time.sleep(SETTLING_TIME)
        try:
            poll = partial(self._check, recorder, devices)
            failure = failure or self._around.after(devices, poll, error, reason)
        finally:
            devices.end_hosts()
        return failure

    def _fail(self, reason: str) -> None:
        """Go from any state to the failed end."""
        for state in (RunState.ABORTING, RunState.FAILED):
            if self._control.state not in (state, RunState.FINISHED, RunState.FAILED):
                self._transition(state, reason)

    def _transition(self, state: RunState, reason: str) -> None:
        self._control.become(state, reason)
        self._publish(state.value, reason)
        self._report(reason)

    def _publish(self, kind: str, message: str, t_ns: int | None = None) -> None:
        if self._bus is not None:
            stamp, state = unix_ns() if t_ns is None else t_ns, self._control.state.value
            event = {"t_ns": stamp, "kind": kind, "state": state, "message": message}
            # an error of a closed bus must not hide why the run ends
            with suppress(BusError):
                publish_event(self._bus, "run", event)

    def _report(self, message: str) -> None:
        elapsed, duration = self._elapsed(), self._plan.duration
        self._progress(Progress(self._control.state, elapsed, duration, message))

    def _elapsed(self) -> float:
        return 0.0 if self._devices is None else min(self._devices.elapsed, self._plan.duration)

    def _describe(self) -> dict[str, Any]:
        return {
            "name": self._plan.experiment.experiment.name,
            "elapsed": self._elapsed(),
            "duration": self._plan.duration,
            "devices": [device.name for device in self._plan.devices],
            "path": str(self._path),
            "refused": dict(self._refusals.counts),
        }

    def _existing_recording(self) -> Path | None:
        part = self._path.with_name(self._path.name + ".part")
        return next((path for path in (self._path, part) if path.exists()), None)
