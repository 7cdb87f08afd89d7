"""All devices of a run together: connecting, leasing, starting and stopping them.

Devices are stopped concurrently and within a bounded time each, so that one that fails or hangs delays no
other.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import Literal

from labhil.bus.authentication import Refusals
from labhil.bus.session import Bus
from labhil.errors import BusError, LabhilError, RunError
from labhil.experiment.checks import CheckSection
from labhil.experiment.device_run import DeviceRun
from labhil.experiment.plan import DevicePlan
from labhil.service.hosts import HostProcess
from labhil.service.messages import HostConfig

OWN_STALL = 1.0
"""s between two looks of a run, after which it has stood still itself: stopped, or for a busy machine."""


class Devices:
    """The devices of one run with their hosts.

    Args:
        bus: The bus of the run.
        holder: The name under which the run holds the leases.
        duration: Duration of the steps, s of the devices' clocks.
        changed: Is set when a device is done or something failed.
        refusals: Counts messages that are not authentic.
    """

    def __init__(
        self, bus: Bus, holder: str, duration: float, changed: threading.Event, refusals: Refusals
    ) -> None:
        self._refusals = refusals
        self.runs: list[DeviceRun] = []
        self._hosts: list[HostProcess] = []
        self._bus, self._holder, self._duration, self._changed = bus, holder, duration, changed
        self._looked_at = time.monotonic()

    def start_host(self, config: HostConfig) -> None:
        """Start the host of one device; does not wait for it."""
        self._hosts.append(HostProcess(config))

    def connect(
        self, plans: Sequence[DevicePlan], subscriptions: ExitStack, interrupted: Callable[[], bool]
    ) -> None:
        """Wait until every host has connected to its device; raises the error of a driver that fails.

        Args:
            plans: The devices, in the order in which their hosts were started.
            subscriptions: Where the subscriptions of the devices are closed.
            interrupted: Whether to stop waiting.
        """
        for plan, host in zip(plans, self._hosts, strict=True):
            device = host.wait_connected(interrupted)
            run = DeviceRun(self._bus, plan, device, self._duration, self._changed, self._refusals)
            self.runs.append(subscriptions.enter_context(run))

    def start(self) -> None:
        """Take all leases, then let the steps begin or continue; CommandRefusedError where one is refused."""
        for run in self.runs:
            run.take_lease(self._holder)
        for run in self.runs:
            run.start()

    @property
    def done(self) -> bool:
        """Whether all steps are over."""
        return all(run.done for run in self.runs)

    @property
    def elapsed(self) -> float:
        """Elapsed time of the slowest device, s of its clock."""
        return min((run.elapsed for run in self.runs), default=0.0)

    def check(self, *, max_silence: float = 3.0, max_ending: float = 10.0) -> None:
        """Raise the error of a host or a device that has failed, if one has.

        Args:
            max_silence: How long the samples of a device may stay away while its host lives, s.
            max_ending: The same once its host has reported a failure, s: it first brings the device to its
                safe state.
        """
        for host in self._hosts:
            failure = host.failure()
            if failure is not None:
                raise failure
        now, before = time.monotonic(), self._looked_at
        self._looked_at = now
        if now - before > OWN_STALL:
            # what this process has not taken in while it stood still is nobody's silence
            for run in self.runs:
                run.last_sample_at = max(run.last_sample_at, now)
        for run in self.runs:
            failure_of_run = run.failure()
            if failure_of_run is not None:
                raise failure_of_run
            limit = max_ending if run.host_failed else max_silence
            if not run.resumes_alone and time.monotonic() - run.last_sample_at > limit:
                raise BusError(f"{run.plan.name}: no samples on the bus for {limit:g} s")
        if fault := self._bus.failure():
            raise BusError(f"the run no longer hears everything: {fault}")

    def step_notes(self) -> Iterator[str]:
        """Yield the messages about steps that waited, began or ended early, each once."""
        for run in self.runs:
            while run.clock.notes:
                yield f"{run.plan.name}: {run.clock.notes.popleft()}"

    def watch(self, checks: Sequence[CheckSection], at: Literal["before", "after"]) -> bool:
        """Watch from now on whether the checks ``at`` this time hold; return whether there are any."""
        due = [check for check in checks if check.at == at]
        for run in self.runs:
            run.watch([check for check in due if check.device in (None, run.plan.name)])
        return bool(due)

    def checks_hold(self) -> bool:
        """Return whether all conditions have held; ConditionError for one whose time is over."""
        outcomes = [run.checks_hold() for run in self.runs]  # all are asked, so that no failure is missed
        return all(outcomes)

    def all_heard(self) -> bool:
        """Return whether at least one sample of every device has come."""
        return all(run.newest for run in self.runs)

    def newest(self) -> dict[str, Mapping[str, float]]:
        """Return the newest sample of each device: values by column, by device."""
        return {run.plan.name: run.newest for run in self.runs}

    def pause_reason(self) -> str:
        """Return why the run has to wait for a device; empty where it does not."""
        return next((run.pause_reason for run in self.runs if run.pause_reason), "")

    def resume_alone(self) -> bool:
        """Return whether the host of each device that the run waits for will announce that it is ready."""
        return all(run.resumes_alone for run in self.runs if run.pause_reason)

    def make_safe(self, reason: str) -> LabhilError | None:
        """Bring all devices to their safe states concurrently; return the first error, if there is one."""
        outcomes = run_concurrently([partial(run.make_safe, reason) for run in self.runs])
        return next((error for error in outcomes if error is not None), None)

    def end_hosts(self) -> None:
        """End all hosts and wait for them; each brings its device to its safe state."""
        end_hosts(self._hosts)


def end_hosts(hosts: Sequence[HostProcess]) -> None:
    """End hosts concurrently and wait for them; each brings its device to its safe state."""
    for host in hosts:
        host.request_end()
    run_concurrently([host.stop for host in hosts])


def host_config(device: DevicePlan, address: str, endpoint: str) -> HostConfig:
    """Return the configuration of the host of a device.

    Args:
        device: The device.
        address: Where the driver connects.
        endpoint: The bus that the host joins.
    """
    return HostConfig(
        device.name,
        device.section.plugin,
        address,
        device.rig.limits,
        endpoint,
        interlocks=device.rig.interlocks,
        reconnect=device.section.reconnect,
    )


def run_concurrently(actions: Sequence[Callable[[], object]]) -> list[LabhilError | None]:
    """Run actions in threads and return the error of each, in order; None where it raised none.

    Any exception that is no LabhilError becomes a RunError: a bug in one action must not keep a device from
    being stopped.
    """
    if not actions:
        return []
    with ThreadPoolExecutor(len(actions), thread_name_prefix="at once") as pool:
        return list(pool.map(_error_of, actions))


def _error_of(action: Callable[[], object]) -> LabhilError | None:
    try:
        action()
    except LabhilError as error:
        return error
    except BaseException as error:  # noqa: BLE001 - in a thread of a pool nothing else would report it
        return RunError(f"the run itself failed: {error!r}")
    return None
