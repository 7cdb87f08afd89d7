"""The host: a process for one device that connects its driver to the bus and keeps the device safe.

``python -m labhil.service.host`` reads one line of configuration from standard input and reports on standard
output when the device is connected and how it ended (one line of JSON each). However it ends (a command,
SIGINT, SIGTERM, the end of its standard input because the parent is gone, a failure of the device or the
bus), the device is brought to its safe state. Its control loop is in ``control.py``.
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
from labhil.bus.register import register
from labhil.bus.session import Bus, open_bus
from labhil.driver import Counters, DeviceInfo, Driver
from labhil.errors import DeviceError, LabhilError, RigFileError
from labhil.host_clock import unix_ns
from labhil.plugins import load_driver
from labhil.service.control import DeviceControl
from labhil.service.messages import HostConfig, HostState
from labhil.service.reconnect import Search
from labhil.terminal import show

SEARCH_POLL_INTERVAL = 0.1
"""How often a host that searches for its device checks whether it has to end, s."""


class EndRequest:
    """The reason for this process to end: a signal, or the end of its standard input; empty before that."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN | select.POLLHUP)
        self._reason = ""

    def watch_signals(self) -> None:
        """Let SIGINT, SIGTERM and SIGHUP end this process in order instead of immediately."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._take_signal)

    def _take_signal(self, number: int, _frame: FrameType | None) -> None:
        self._reason = self._reason or signal.Signals(number).name

    def __call__(self) -> str:
        """Return the reason to end, or an empty string; does not wait."""
        if not self._reason and self._poll.poll(0) and not os.read(self._descriptor, 4096):
            self._reason = "standard input closed"
        return self._reason


def serve_device(config: HostConfig, ended: EndRequest) -> str:
    """Connect to the device and serve it on the bus until an end is requested; the device is safe then.

    Args:
        config: The configuration of the host.
        ended: Returns the reason to end, or an empty text.

    Returns:
        Why it ended.

    Raises:
        LabhilError: The driver or the bus failed.
    """
    if ended():
        return ended()  # the parent is gone, and the bus with it
    driver = load_driver(config.plugin)(config.address)
    with open_bus(config.connect) as bus:
        try:
            info = connect_patiently(driver, config, ended)
            if info is None:
                return ended()
            refuse_unwatched(driver, config)
            reachable = register("host", config.device, bus.endpoint, [config.device])
            with reachable, DeviceControl(config, driver, info, bus, ended) as control:
                report({"ready": describe(driver, info)})
                reason = control.run()
                report({"delivering": reason})
                return reason
        except LabhilError as error:
            driver.safe()
            announce_failure(bus, config.device, error, driver.counters)
            raise
        finally:
            driver.safe()
            driver.close()


def connect_patiently(driver: Driver, config: HostConfig, ended: Callable[[], str]) -> DeviceInfo | None:
    """Connect to the device; a patient host searches for an absent one, and gets None where ``ended``."""
    try:
        return driver.connect()
    except DeviceError as error:
        if not config.patient:
            raise
        report({"waiting": str(error)})
    search = Search(driver, math.inf)
    try:
        while (info := search.result(SEARCH_POLL_INTERVAL)) is None and not ended():
            pass
    finally:
        search.cancel()
    return info


def refuse_unwatched(driver: Driver, config: HostConfig) -> None:
    """Raise RigFileError for a limit on a channel that is not fitted in this device."""
    possible = type(driver).spec.stream.names()
    for name in config.limits:
        if name in possible and name not in driver.spec.stream.names():
            raise RigFileError(
                f"limits.{name}: expected a device that watches it, found that {config.address} has no such"
                " channel fitted: fit it, or take the limit out of the rig file"
            )


def describe(driver: Driver, info: DeviceInfo) -> dict[str, Any]:
    """Return the report about a connected device for the parent, as JSON data."""
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
    """Publish the event that the device failed, with the error and the counters of its connection."""
    state = HostState.FAILED.value
    data = {"t_ns": unix_ns(), "kind": state, "state": state, "message": str(error)}
    publish_event(bus, device, {**data, "error": type(error).__name__, "counters": asdict(counters)})


def report(data: dict[str, Any]) -> None:
    """Write one line for the parent, which may be gone."""
    with contextlib.suppress(OSError):
        show(json.dumps(data))


def main() -> int:
    """Run the host and return its exit status."""
    ended = EndRequest(sys.stdin.fileno())
    ended.watch_signals()
    try:
        reason = serve_device(HostConfig.from_line(sys.stdin.readline()), ended)
    except LabhilError as error:
        report({"ended": {"error": type(error).__name__, "reason": str(error)}})
        return error.exit_status
    report({"ended": {"error": None, "reason": reason}})
    return 0


if __name__ == "__main__":
    sys.exit(main())
