"""All devices of a run at once: connected, leased, started, and above all stopped.

Whatever stops devices does it for all of them at the same time and within a bounded time each, so that one
that fails or hangs keeps no other waiting.
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

SILENCE = 3.0
"""How long the samples of a device may stay away while its host lives, s."""


ENDING = 10.0
"""The same once its host has reported a failure, s: it has to bring its device to safety first."""


OWN_STALL = 1.0
"""s between two looks of a run, after which it has stood still itself: stopped, or for a busy machine."""


class Devices:
    """The devices of one run with their hosts; ``duration`` is that of the steps, s of their clocks."""

    def __init__(
        self, bus: Bus, holder: str, duration: float, changed: threading.Event, refusals: Refusals
    ) -> None:
        self._refusals = refusals
        self.runs: list[DeviceRun] = []
        self._hosts: list[HostProcess] = []
        self._bus, self._holder, self._duration, self._changed = bus, holder, duration, changed
        self._looked_at = time.monotonic()

    def start_host(self, config: HostConfig) -> None:
        """Start the host of one device, without waiting for it."""
        self._hosts.append(HostProcess(config))

    def connect(
        self, plans: Sequence[DevicePlan], subscriptions: ExitStack, interrupted: Callable[[], bool]
    ) -> None:
        """Wait until every host has its device; raises what a driver raised."""
        for plan, host in zip(plans, self._hosts, strict=True):
            device = host.wait_connected(interrupted)
            run = DeviceRun(self._bus, plan, device, self._duration, self._changed, self._refusals)
            self.runs.append(subscriptions.enter_context(run))

    def start(self) -> None:
        """Take all leases, then let the steps begin, or go on; CommandRefusedError where one is refused."""
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
        """How far the slowest device has come, s of its clock."""
        return min((run.elapsed for run in self.runs), default=0.0)

    def look_after(self) -> None:
        """Raise what went wrong with a host or its device, if anything did."""
        for host in self._hosts:
            failure = host.failure()
            if failure is not None:
                raise failure
        now, before = time.monotonic(), self._looked_at
        self._looked_at = now
        if now - before > OWN_STALL:
            # what this process has not taken in while it stood still is nobody's silence
            for run in self.runs:
                run.heard_at = max(run.heard_at, now)
        for run in self.runs:
            fault = run.failure()
            if fault is not None:
                raise fault
            patience = ENDING if run.ends else SILENCE
            if not run.comes_back and time.monotonic() - run.heard_at > patience:
                raise BusError(f"{run.plan.name}: no samples on the bus for {patience:g} s")
        if deaf := self._bus.failure():
            raise BusError(f"the run no longer hears everything: {deaf}")

    def step_notes(self) -> Iterator[str]:
        """Yield what conditions have brought about: steps that waited, began, or ended early, each once."""
        for run in self.runs:
            while run.clock.notes:
                yield f"{run.plan.name}: {run.clock.notes.popleft()}"

    def watch(self, checks: Sequence[CheckSection], at: Literal["before", "after"]) -> bool:
        """Look from now on for whether the checks ``at`` this time hold; returns whether there are any."""
        due = [check for check in checks if check.at == at]
        for run in self.runs:
            run.watch([check for check in due if check.device in (None, run.plan.name)])
        return bool(due)

    def checks_hold(self) -> bool:
        """Whether all conditions have held; raises ConditionError for one whose time is over."""
        outcomes = [run.checks_hold() for run in self.runs]  # of each, so that none that fails is overlooked
        return all(outcomes)

    def all_heard(self) -> bool:
        """Whether a sample of every device has come."""
        return all(run.newest for run in self.runs)

    def newest(self) -> dict[str, Mapping[str, float]]:
        """The values of each device's newest sample."""
        return {run.plan.name: run.newest for run in self.runs}

    def rest(self) -> str:
        """Why the run has to wait for one of its devices; empty when it does not."""
        return next((run.rests for run in self.runs if run.rests), "")

    def comes_back(self) -> bool:
        """Whether every device that the run waits for will say itself when it is ready again."""
        return all(run.comes_back for run in self.runs if run.rests)

    def make_safe(self, reason: str) -> LabhilError | None:
        """Bring all devices to their safe states at once; returns what went wrong first, if anything did."""
        outcomes = at_once([partial(run.make_safe, reason) for run in self.runs])
        return next((error for error in outcomes if error is not None), None)

    def end_hosts(self) -> None:
        """End all hosts, which bring their devices to safety, and wait until they are gone."""
        end_hosts(self._hosts)


def end_hosts(hosts: Sequence[HostProcess]) -> None:
    """End these hosts, which bring their devices to safety, and wait until they are gone."""
    for host in hosts:
        host.tell_to_end()
    at_once([host.stop for host in hosts])


def host_config(device: DevicePlan, address: str, endpoint: str) -> HostConfig:
    """What the host of a device needs to know."""
    return HostConfig(
        device.name,
        device.section.plugin,
        address,
        device.rig.limits,
        endpoint,
        interlocks=device.rig.interlocks,
        reconnect=device.section.reconnect,
    )


def at_once(actions: Sequence[Callable[[], object]]) -> list[LabhilError | None]:
    """Do all of this at the same time, and return what each of them raised, in order.

    What is no error of ours becomes a RunError: one action that has a fault must not keep a device unstopped.
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
    except BaseException as error:  # noqa: BLE001 - in a thread of a pool it reaches nobody else
        return RunError(f"the run itself failed: {error!r}")
    return None
