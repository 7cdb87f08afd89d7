"""The emergency stop, from the side of whoever presses it: every device at once, and who did not answer."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from labhil.bus import latch
from labhil.bus.ask import ask_all
from labhil.bus.keys import command_key
from labhil.bus.live import live_devices
from labhil.bus.register import check_loopback, is_endpoint, running
from labhil.bus.session import Bus, open_bus
from labhil.errors import BusError, CommandRefusedError

PATIENCE = 3.0
"""How long devices that are expected to answer are asked again, s: a bus that was just joined needs one."""

GUEST_PATIENCE = 2.0 * PATIENCE
"""How long a guest waits, s: the other machine asks its devices meanwhile."""

ASK_EVERY = 0.1
LATCH = "the latch"
EVERY_HOST = command_key("*", "estop")
EVERYTHING = "*"
"""Stands where a device's name does when the door of a lab confirms a guest's stop or release."""
EVERY_LATCH = command_key("*", "release")
"""Where guests ask for a release: access control sees keys, and not what a message says."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Who answered, and with which state; why a host could not do it; and who said nothing at all."""

    answered: Mapping[str, str]
    failed: Mapping[str, str]
    silent: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether there was somebody to stop, and everybody was."""
        return bool(self.answered) and not self.failed and not self.silent


def press_everywhere(by: str, reason: str, connect: str | None = None) -> Outcome:
    """Stop every device on this machine, or those on the bus of ``connect``, and latch the stop.

    The latch is set first: it works without the bus. Where it cannot be, devices are stopped all the same,
    and the outcome says so under ``LATCH``. A guest's stop (``connect`` is a folder) is latched on the other
    machine, and not here. BusError when no bus can be opened at all.
    """
    if connect is not None and not is_endpoint(connect):
        with open_bus(connect) as bus:
            return _ask_as_guest(bus, EVERY_HOST, {"reason": reason})
    fault = _set_latch(by, reason)
    return _add_failures(fault, _ask_everywhere({"action": "press", "by": by, "reason": reason}, connect))


def release_everywhere(connect: str | None = None) -> Outcome:
    """Release the stop in every host; nothing moves by that, it can only be commanded again.

    CommandRefusedError where a guest may not release what stands.
    """
    if connect is not None and not is_endpoint(connect):
        with open_bus(connect) as bus:
            return _ask_as_guest(bus, EVERY_LATCH, {})
    latch.release()
    return _ask_everywhere({"action": "release"}, connect)


def press_on(bus: Bus, by: str, reason: str, expected: Collection[str]) -> Outcome:
    """Stop every device on a bus that is open already; ``expected`` are those that have to answer."""
    if bus.guest is not None:
        return _ask_as_guest(bus, EVERY_HOST, {"reason": reason})
    fault = _set_latch(by, reason)
    payload = {"action": "press", "by": by, "reason": reason}
    return _add_failures(fault, _ask_until_all_answer(bus, payload, set(expected)))


def _set_latch(by: str, reason: str) -> Mapping[str, str]:
    """Set the latch; what kept us from that, if anything did."""
    try:
        latch.press(by, reason)
    except (BusError, OSError) as error:
        return {LATCH: f"hosts that start later will not know of it: {error}"}
    return {}


def _add_failures(fault: Mapping[str, str], outcome: Outcome) -> Outcome:
    return replace(outcome, failed={**outcome.failed, **fault})


def _ask_everywhere(payload: Mapping[str, Any], connect: str | None) -> Outcome:
    place = None if connect is None else check_loopback(connect)
    entries = [e for e in running() if e.kind != "replay" and place in (None, e.endpoint)]
    expected = {device for entry in entries for device in entry.devices}
    if place is None and not entries:
        return Outcome({}, {}, ())
    with open_bus(place or [entry.endpoint for entry in entries]) as bus:
        return _ask_until_all_answer(bus, payload, expected)


def _ask_as_guest(bus: Bus, place: str, payload: Mapping[str, Any]) -> Outcome:
    """Let the door of another machine stop or release everything there; raises what keeps it from that."""
    while True:
        answers = {
            key.split("/")[1]: said for key, said in ask_all(bus, place, payload, GUEST_PATIENCE).items()
        }
        accepted = answers.pop(EVERYTHING, None)
        if accepted is not None or not bus.settling:
            break
        time.sleep(ASK_EVERY)
    if isinstance(accepted, (BusError, CommandRefusedError)):
        raise accepted
    if accepted is None:
        raise bus.unanswered(place)
    answered, failed = {}, {}
    for device, said in answers.items():
        if isinstance(said, (BusError, CommandRefusedError)):
            failed[device] = str(said)
        else:
            answered[device] = str(said.get("state"))
    return Outcome(answered, failed, ())


def _ask_until_all_answer(bus: Bus, payload: Mapping[str, Any], expected: set[str]) -> Outcome:
    """Ask all hosts again and again until every device that is expected, or alive, has answered."""
    answered: dict[str, str] = {}
    failed: dict[str, str] = {}
    deadline = time.monotonic() + PATIENCE
    missing = set(expected)
    while True:
        left = max(deadline - time.monotonic(), 0.2)
        for key, answer in ask_all(bus, EVERY_HOST, payload, left).items():
            device = key.split("/")[1]
            if isinstance(answer, (BusError, CommandRefusedError)):
                failed[device] = str(answer)
            else:
                answered[device] = str(answer.get("state"))
                failed.pop(device, None)
        missing = (expected | set(live_devices(bus, 0.2))) - set(answered)
        if time.monotonic() > deadline or not (missing or bus.settling):
            silent = tuple(sorted(missing - set(failed)))
            return Outcome(answered, failed, silent)
        time.sleep(ASK_EVERY)
