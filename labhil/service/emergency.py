"""Pressing and releasing the emergency stop: all devices at once, with the answer of each host."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from labhil.bus import latch
from labhil.bus.ask import ask_all
from labhil.bus.keys import command_key
from labhil.bus.live import live_devices
from labhil.bus.register import check_loopback, is_endpoint, registered_processes
from labhil.bus.session import Bus, open_bus
from labhil.errors import BusError, CommandRefusedError

ANSWER_TIMEOUT = 3.0
"""How long devices that are expected to answer are asked again, s: a bus that was just joined needs 1 s."""

GUEST_TIMEOUT = 2.0 * ANSWER_TIMEOUT
"""How long a guest waits, s: the other machine asks its devices meanwhile."""

ASK_INTERVAL = 0.1
"""Time between two requests to hosts that have not answered, s."""
LATCH = "the latch"
"""The name under which an outcome reports that the latch file could not be written."""
EVERY_HOST = command_key("*", "estop")
EVERYTHING = "*"
"""The place of the device's name when a gateway confirms a guest's stop or release of the whole lab."""
EVERY_LATCH = command_key("*", "release")
"""Where guests request a release: access control sees keys, not the contents of messages."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a stop or a release.

    Attributes:
        answered: State of each host that answered, by device.
        failed: Why a host could not carry it out, by device.
        silent: Devices whose hosts did not answer.
    """

    answered: Mapping[str, str]
    failed: Mapping[str, str]
    silent: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether at least one host answered, and none failed or was silent."""
        return bool(self.answered) and not self.failed and not self.silent


def press_everywhere(by: str, reason: str, connect: str | None = None) -> Outcome:
    """Stop every device on this machine, or those on one bus, and latch the stop.

    The latch is set first: it works without the bus. Where it cannot be set, devices are stopped all the same
    and the outcome reports it under ``LATCH``. A guest's stop is latched on the other machine, not here.

    Args:
        by: Who presses it.
        reason: Why.
        connect: Endpoint of one bus, or the folder of a connection to a lab on another machine.

    Raises:
        BusError: No bus can be opened.
    """
    if connect is not None and not is_endpoint(connect):
        with open_bus(connect) as bus:
            return _ask_as_guest(bus, EVERY_HOST, {"reason": reason})
    fault = _set_latch(by, reason)
    return _add_failures(fault, _ask_everywhere({"action": "press", "by": by, "reason": reason}, connect))


def release_everywhere(connect: str | None = None) -> Outcome:
    """Release the emergency stop in every host. Nothing moves by that; devices can be commanded again.

    Args:
        connect: As for :func:`press_everywhere`.

    Raises:
        CommandRefusedError: The guest may not release this stop.
    """
    if connect is not None and not is_endpoint(connect):
        with open_bus(connect) as bus:
            return _ask_as_guest(bus, EVERY_LATCH, {})
    latch.release()
    return _ask_everywhere({"action": "release"}, connect)


def press_on(bus: Bus, by: str, reason: str, expected: Collection[str]) -> Outcome:
    """Stop every device on an open bus, and latch the stop.

    Args:
        bus: The bus.
        by: Who presses it.
        reason: Why.
        expected: Devices whose hosts have to answer.
    """
    if bus.guest is not None:
        return _ask_as_guest(bus, EVERY_HOST, {"reason": reason})
    fault = _set_latch(by, reason)
    payload = {"action": "press", "by": by, "reason": reason}
    return _add_failures(fault, _ask_until_all_answer(bus, payload, set(expected)))


def _set_latch(by: str, reason: str) -> Mapping[str, str]:
    """Set the latch; return the failure by ``LATCH`` where that is not possible."""
    try:
        latch.press(by, reason)
    except (BusError, OSError) as error:
        return {LATCH: f"hosts that start later will not know of it: {error}"}
    return {}


def _add_failures(fault: Mapping[str, str], outcome: Outcome) -> Outcome:
    return replace(outcome, failed={**outcome.failed, **fault})


def _ask_everywhere(payload: Mapping[str, Any], connect: str | None) -> Outcome:
    place = None if connect is None else check_loopback(connect)
    entries = [e for e in registered_processes() if e.kind != "replay" and place in (None, e.endpoint)]
    expected = {device for entry in entries for device in entry.devices}
    if place is None and not entries:
        return Outcome({}, {}, ())
    with open_bus(place or [entry.endpoint for entry in entries]) as bus:
        return _ask_until_all_answer(bus, payload, expected)


def _ask_as_guest(bus: Bus, place: str, payload: Mapping[str, Any]) -> Outcome:
    """Request the gateway of another machine to stop or release everything there."""
    while True:
        replies = ask_all(bus, place, payload, GUEST_TIMEOUT)
        answers = {key.split("/")[1]: answer for key, answer in replies.items()}
        accepted = answers.pop(EVERYTHING, None)
        if accepted is not None or not bus.is_settling:
            break
        time.sleep(ASK_INTERVAL)
    if isinstance(accepted, (BusError, CommandRefusedError)):
        raise accepted
    if accepted is None:
        raise bus.unanswered_error(place)
    answered, failed = {}, {}
    for device, answer in answers.items():
        if isinstance(answer, (BusError, CommandRefusedError)):
            failed[device] = str(answer)
        else:
            answered[device] = str(answer.get("state"))
    return Outcome(answered, failed, ())


def _ask_until_all_answer(bus: Bus, payload: Mapping[str, Any], expected: set[str]) -> Outcome:
    """Ask all hosts repeatedly until the host of every device that is expected, or alive, has answered."""
    answered: dict[str, str] = {}
    failed: dict[str, str] = {}
    deadline = time.monotonic() + ANSWER_TIMEOUT
    missing = set(expected)
    while True:
        remaining = max(deadline - time.monotonic(), 0.2)
        for key, answer in ask_all(bus, EVERY_HOST, payload, remaining).items():
            device = key.split("/")[1]
            if isinstance(answer, (BusError, CommandRefusedError)):
                failed[device] = str(answer)
            else:
                answered[device] = str(answer.get("state"))
                failed.pop(device, None)
        missing = (expected | set(live_devices(bus, 0.2))) - set(answered)
        if time.monotonic() > deadline or not (missing or bus.is_settling):
            silent = tuple(sorted(missing - set(failed)))
            return Outcome(answered, failed, silent)
        time.sleep(ASK_INTERVAL)
