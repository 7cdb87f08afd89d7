"""``python -m labhil_ur5.client HOST RATE``: the client library ur_rtde, in a process that may die.

The library can crash its interpreter and can block for minutes, so nothing else runs here. The process reads
a JSON object per line on standard input and writes one per line on standard output:

* in: ``{"move": q}`` moves there by moveJ; ``{"t": s, "q": q, "from": q}`` is a waypoint;
  ``{"alive": true}`` is a sign of life; ``{"stop": true}`` stops and holds; ``{"slider": share}``;
  ``{"outputs": bits}``
* out: ``{"state": "idle" | "moving" | "servo" | "stopping"}`` ten times a second and at every change,
  ``{"fault": "…"}`` before it ends because of a fault

The end of standard input stops the arm, ends the controller's program and this process. If this process dies
or hangs, the controller's watchdog stops the program after 1/``WATCHDOG_RATE`` s.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

from labhil.terminal import complain
from labhil_ur5.player import Player, TooFastError
from labhil_ur5.reported_signals import COMMAND_TIMEOUT, DIGITAL_OUTPUTS

WATCHDOG_RATE = 10.0
"""Lowest rate at which the controller's watchdog has to be fed, Hz."""
MOVE_SPEED, MOVE_ACCELERATION = 0.5, 0.7
"""Speed and acceleration of the fastest joint in a moveJ, rad/s and rad/s²."""
STOP_ACCELERATION = 3.0
"""Deceleration of a stop during a moveJ, rad/s²."""
LOOKAHEAD, GAIN = 0.1, 300.0
"""Lookahead time (s) and gain of servoJ: the manufacturer's defaults."""
MAX_MOVE_START = 0.5
"""Time after which a move that was never reported as running counts as done, s."""
MAX_CALL_TIME = 0.08
"""Longest time of a call that only writes a package, s; see :class:`LostError`."""
EXIT_LOST = 4
"""Exit status after the connection broke."""
REPORT_PERIOD = 0.1
IDLE_PERIOD = 0.02


class FaultError(Exception):
    """The arm does not execute its command; the process ends."""


class LostError(Exception):
    """The connection broke.

    The library then connects again within the call and replaces the program by one without a watchdog, which
    must not move an arm.
    """


class Client:
    """The state of the arm's program, and the requests that change it.

    Args:
        host: Address of the controller.
        rate: Rate of servo targets, Hz.
    """

    def __init__(self, host: str, rate: float) -> None:
        from rtde_control import RTDEControlInterface

        self._host, self._period = host, 1.0 / rate
        self._control = RTDEControlInterface(host, rate)
        self._io: Any = None
        self._player: Player | None = None
        self._last_request = self._last_report = self._last_tick = time.monotonic()
        self._seen_moving = False
        self._move_started_at = 0.0
        self._incomplete = b""
        self._input_open = True
        self.state = ""
        if not self._control.setWatchdog(WATCHDOG_RATE):
            raise FaultError("the controller did not take its watchdog")
        self._transition("idle")

    def run(self) -> None:
        """Serve requests until standard input ends and the arm is at rest."""
        due = time.monotonic()
        while self._input_open or self.state != "idle":
            self._read_requests(max(due - time.monotonic(), 0.0))
            now = time.monotonic()
            if now < due:
                continue
            self._cycle(now)
            period = IDLE_PERIOD if self.state == "idle" else self._period
            due = max(due + period, now - period)
            if now - self._last_report > REPORT_PERIOD:
                self._report(now)

    def end(self) -> None:
        """End the controller's program and the connection."""
        self._control.stopScript()
        self._control.disconnect()

    def _read_requests(self, timeout: float) -> None:
        if not self._input_open:
            time.sleep(timeout)
            return
        if not select.select([0], [], [], timeout)[0]:
            return
        data = os.read(0, 1 << 16)
        if not data:
            self._input_open = False
            self._stop()
            return
        *lines, self._incomplete = (self._incomplete + data).split(b"\n")
        for line in lines:
            self._dispatch(json.loads(line))

    def _dispatch(self, request: Mapping[str, Any]) -> None:
        if "stop" in request:
            self._stop()
            return
        if "slider" in request or "outputs" in request:
            self._switch(request)
            return
        self._last_request = time.monotonic()
        if "move" in request and self.state == "idle":
            self._check(self._control.moveJ(request["move"], MOVE_SPEED, MOVE_ACCELERATION, True), "moveJ")
            self._move_started_at, self._seen_moving = self._last_request, False
            self._transition("moving")
        elif "q" in request:
            self._add_waypoint(request)

    def _add_waypoint(self, request: Mapping[str, Any]) -> None:
        if self.state == "idle":
            self._player = Player(request["from"], request["t"], request["q"])
            self._transition("servo")
        elif self.state == "servo" and self._player is not None:
            try:
                self._player.add(request["t"], request["q"])
            except TooFastError as error:
                self._stop()
                write_line({"refused": str(error)})

    def _switch(self, request: Mapping[str, Any]) -> None:
        if self._io is None:
            from rtde_io import RTDEIOInterface

            self._io = RTDEIOInterface(self._host)
        if "slider" in request:
            self._check(self._io.setSpeedSlider(request["slider"]), "setSpeedSlider")
        for number in range(DIGITAL_OUTPUTS) if "outputs" in request else ():
            on = bool(request["outputs"] >> number & 1)
            self._check(self._io.setStandardDigitalOut(number, on), "setStandardDigitalOut")

    def _stop(self) -> None:
        if self.state == "servo" and self._player is not None:
            self._player.stop()
            self._transition("stopping")
        elif self.state == "moving":
            # asynchronous, since the watchdog must be fed meanwhile
            self._control.stopJ(STOP_ACCELERATION, True)
            self._move_started_at, self._seen_moving = time.monotonic(), False
            self._transition("stopping")

    def _cycle(self, now: float) -> None:
        if self.state in ("servo", "moving") and now - self._last_request > COMMAND_TIMEOUT:
            self._stop()
        if self._player is not None:
            self._servo(self._player, now)
        else:
            self._check(self._call_promptly(self._control.kickWatchdog), "kickWatchdog")
            if self.state != "idle":
                self._check_arrival(now)

    def _servo(self, player: Player, now: float) -> None:
        elapsed, self._last_tick = now - self._last_tick, now
        q = list(player.tick(elapsed))
        success = self._call_promptly(
            lambda: self._control.servoJ(q, 0.0, 0.0, self._period, LOOKAHEAD, GAIN)
        )
        self._check(success, "servoJ")
        if player.at_rest:
            self._player = None
            self._check(self._control.servoStop(STOP_ACCELERATION), "servoStop")
            self._transition("idle")

    def _check_arrival(self, now: float) -> None:
        running = self._control.getAsyncOperationProgressEx().isAsyncOperationRunning()
        self._seen_moving = self._seen_moving or running
        # a move to the present position may end before it is reported as running
        if not running and (self._seen_moving or now - self._move_started_at > MAX_MOVE_START):
            self._transition("idle")

    def _call_promptly(self, call: Callable[[], bool]) -> bool:
        start_time = time.monotonic()
        success = call()
        duration = time.monotonic() - start_time
        if duration > MAX_CALL_TIME:
            raise LostError(f"the connection to the controller broke: a call took {duration:.2f} s")
        return success

    def _check(self, success: bool, call_name: str) -> None:
        if not success:
            raise FaultError(
                f"the controller did not carry out {call_name}: its program does not run any more"
            )

    def _transition(self, state: str) -> None:
        self.state = state
        self._report(time.monotonic())

    def _report(self, now: float) -> None:
        self._last_report = now
        write_line({"state": self.state})


def write_line(data: Mapping[str, Any]) -> None:
    """Write a line to the driver; nothing happens where the driver is gone."""
    with contextlib.suppress(OSError):
        os.write(_output, json.dumps(data).encode() + b"\n")


_output = 1


def main() -> int:
    """Run the process; returns 0 after an orderly end, 3 after a fault; exits with ``EXIT_LOST``."""
    global _output  # noqa: PLW0603 - before anything else runs
    # the library prints on standard output
    _output = os.dup(1)
    os.dup2(2, 1)
    host, rate = sys.argv[1], float(sys.argv[2])
    try:
        client = Client(host, rate)
        client.run()
        client.end()
    except (RuntimeError, FaultError) as error:
        write_line({"fault": str(error).strip()})
        return 3
    except LostError as error:
        # the driver stops the program; the library's own end may hang
        complain(error)
        os._exit(EXIT_LOST)
    return 0


if __name__ == "__main__":
    sys.exit(main())
