"""A process for one device: its driver on the bus, and what keeps the device honest.

``python -m labhil.service.host`` reads one line of configuration on its standard input, says on its
standard output when the device is there and how it ended (one line of JSON each), and runs until
something ends it. Whatever that is (a command, SIGINT, SIGTERM, the end of its standard input
because the parent is gone, a failing device, a failing bus) the device is brought to its safe state.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import signal
import sys
from collections.abc import Callable
from dataclasses import asdict
from types import FrameType
from typing import Any

from labhil.bus.publish import publish_event
from labhil.bus.register import registered
from labhil.bus.session import Bus, open_bus
from labhil.driver import Counters, DeviceInfo, Driver
from labhil.errors import DeviceError, LabhilError, RigFileError
from labhil.host_clock import unix_ns
from labhil.plugins import load_driver
from labhil.service.control import DeviceControl
from labhil.service.messages import HostConfig, HostState
from labhil.service.reconnect import Search
from labhil.terminal import show

SEARCH_LOOK = 0.1
"""How often a host that looks for its device looks whether it is to end, s."""


class EndOfInput:
    """Why this process is to end: a signal, or the end of its standard input. Empty while it is not."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN | select.POLLHUP)
        self._reason = ""

    def watch_signals(self) -> None:
        """Let SIGINT, SIGTERM and SIGHUP end this process in order, instead of at once."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._take_signal)

    def _take_signal(self, number: int, _frame: FrameType | None) -> None:
        self._reason = self._reason or signal.Signals(number).name

    def __call__(self) -> str:
        """Return the reason to end, or an empty string; does not wait."""
        if not self._reason and self._poll.poll(0) and not os.read(self._descriptor, 4096):
            self._reason = "standard input closed"
        return self._reason


def serve_device(config: HostConfig, ended: EndOfInput) -> str:
    """Connect to the device, put it on the bus, and return why that ended; the device is safe then.

    Raises LabhilError: what the driver or the bus raised.
    """
    if ended():
        return ended()  # whoever started this process is gone: nobody is on the bus
    driver = load_driver(config.plugin)(config.address)
    with open_bus(config.connect) as bus:
        try:
            info = connect_patiently(driver, config, ended)
            if info is None:
                return ended()
            refuse_unwatched(driver, config)
            reachable = registered("host", config.device, bus.endpoint, [config.device])
            with reachable, DeviceControl(config, driver, info, bus, ended) as control:
                say({"ready": describe(driver, info)})
                reason = control.run()
                say({"delivering": reason})
                return reason
        except LabhilError as error:
            driver.safe()
            announce_failure(bus, config.device, error, driver.counters)
            raise
        finally:
            driver.safe()
            driver.close()


def connect_patiently(driver: Driver, config: HostConfig, ended: Callable[[], str]) -> DeviceInfo | None:
    """Connect to the device; a patient host looks for one that is not there until ``ended``, then None."""
    try:
        return driver.connect()
    except DeviceError as error:
        if not config.patient:
            raise
        say({"waiting": str(error)})
    search = Search(driver, math.inf)
    try:
        while (info := search.result(SEARCH_LOOK)) is None and not ended():
            pass
    finally:
        search.cancel()
    return info


def refuse_unwatched(driver: Driver, config: HostConfig) -> None:
    """Raise RigFileError for a limit on a channel that such a device may have, but this one has not."""
    may_have = type(driver).spec.stream.names()
    for name in config.limits:
        if name in may_have and name not in driver.spec.stream.names():
            raise RigFileError(
                f"limits.{name}: expected a device that watches it, found that {config.address} has no such"
                " channel fitted: fit it, or take the limit out of the rig file"
            )


def describe(driver: Driver, info: DeviceInfo) -> dict[str, Any]:
    """Return what a parent wants to know of a device that has just been connected."""
    return {
        "stream": {
            "name": driver.spec.stream.name,
            "signals": [signal.to_json() for signal in driver.spec.stream.signals],
            "rate": driver.spec.stream.rate,
        },
        "safe": dict(driver.spec.safe),
        "speed": info.speed,
        "firmware": info.firmware,
        "serial": info.serial,
    }


def announce_failure(bus: Bus, device: str, error: LabhilError, counters: Counters) -> None:
    """Publish that the device failed, with what, and what had been counted on its wire by then."""
    state = HostState.FAILED.value
    data = {"t_ns": unix_ns(), "kind": state, "state": state, "message": str(error)}
    publish_event(bus, device, {**data, "error": type(error).__name__, "counters": asdict(counters)})


def say(data: dict[str, Any]) -> None:
    """Write one line for the parent, who may be gone."""
    with contextlib.suppress(OSError):
        show(json.dumps(data))


def main() -> int:
    """Run the process; returns its exit status."""
    ended = EndOfInput(sys.stdin.fileno())
    ended.watch_signals()
    try:
        reason = serve_device(HostConfig.from_line(sys.stdin.readline()), ended)
    except LabhilError as error:
        say({"ended": {"error": type(error).__name__, "reason": str(error)}})
        return error.exit_status
    say({"ended": {"error": None, "reason": reason}})
    return 0


if __name__ == "__main__":
    sys.exit(main())
