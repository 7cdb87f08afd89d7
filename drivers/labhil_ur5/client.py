"""``python -m labhil_ur5.client HOST RATE``: the client library ur_rtde, in a process that may die.

The library can crash its interpreter and can block for minutes, so nothing else lives here. It reads
one JSON object a line on standard input and tells one a line on standard output what it is doing:

* in: ``{"move": q}`` goes there by moveJ; ``{"t": s, "q": q, "from": q}`` is a waypoint;
  ``{"alive": true}`` says that somebody is there; ``{"stop": true}`` stops and holds;
  ``{"slider": share}``; ``{"outputs": bits}``
* out: ``{"state": "idle" | "moving" | "servo" | "stopping"}`` ten times a second and at every change,
  ``{"fault": "…"}`` before it ends by itself

The end of standard input stops the arm, ends the controller's program and this process. Should this
process die or hang, the controller's own watchdog stops the program after 1/``WATCHDOG_RATE`` s.
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
from labhil_ur5.declared import COMMAND_TIMEOUT, DIGITAL_OUTPUTS
from labhil_ur5.player import Player, TooFastError

WATCHDOG_RATE = 10.0
"""What the controller's watchdog expects of us at least, Hz."""
MOVE_SPEED, MOVE_ACCELERATION = 0.5, 0.7
"""How the arm goes to where a path begins, rad/s and rad/s² of its fastest joint."""
STOP_ACCELERATION = 3.0
"""How it stops on the way there, rad/s²."""
LOOKAHEAD, GAIN = 0.1, 300.0
"""servoJ's own smoothing (s) and its gain: the manufacturer's defaults."""
UNSEEN = 0.5
"""A move that was not seen to run is taken for done after so long, s."""
LONGEST_CALL = 0.08
"""What a call that only writes a package may take, s; see :class:`LostError`."""
LOST = 4
"""Exit status when the connection broke."""
TELL_EVERY = 0.1
IDLE_PERIOD = 0.02


class FaultError(Exception):
    """The arm does not carry out its command; the process ends with it."""


class LostError(Exception):
    """The connection broke.

    The library then connects again within the call and puts a new program in place of ours, one without a
    watchdog: such a program is not to move an arm.
    """


class Client:
    """What the arm is doing, and how to make it do something else."""

    def __init__(self, host: str, rate: float) -> None:
        from rtde_control import RTDEControlInterface

        self._host, self._dt = host, 1.0 / rate
        self._control = RTDEControlInterface(host, rate)
        self._outputs: Any = None
        self._player: Player | None = None
        self._heard_at = self._reported_at = self._ticked_at = time.monotonic()
        self._seen_moving = False
        self._moved_at = 0.0
        self._rest = b""
        self._open = True
        self.state = ""
        if not self._control.setWatchdog(WATCHDOG_RATE):
            raise FaultError("the controller did not take its watchdog")
        self._transition("idle")

    def run(self) -> None:
        """Serve until standard input ends and the arm stands."""
        due = time.monotonic()
        while self._open or self.state != "idle":
            self._listen(max(due - time.monotonic(), 0.0))
            now = time.monotonic()
            if now < due:
                continue
            self._act(now)
            period = IDLE_PERIOD if self.state == "idle" else self._dt
            due = max(due + period, now - period)
            if now - self._reported_at > TELL_EVERY:
                self._tell(now)

    def end(self) -> None:
        """End the controller's program and the connection."""
        self._control.stopScript()
        self._control.disconnect()

    def _listen(self, timeout: float) -> None:
        if not self._open:
            time.sleep(timeout)
            return
        if not select.select([0], [], [], timeout)[0]:
            return
        data = os.read(0, 1 << 16)
        if not data:
            self._open = False
            self._stop()
            return
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._dispatch(json.loads(line))

    def _dispatch(self, order: Mapping[str, Any]) -> None:
        if "stop" in order:
            self._stop()
            return
        if "slider" in order or "outputs" in order:
            self._switch(order)
            return
        self._heard_at = time.monotonic()
        if "move" in order and self.state == "idle":
            self._check(self._control.moveJ(order["move"], MOVE_SPEED, MOVE_ACCELERATION, True), "moveJ")
            self._moved_at, self._seen_moving = self._heard_at, False
            self._transition("moving")
        elif "q" in order:
            self._take_waypoint(order)

    def _take_waypoint(self, order: Mapping[str, Any]) -> None:
        if self.state == "idle":
            self._player = Player(order["from"], order["t"], order["q"])
            self._transition("servo")
        elif self.state == "servo" and self._player is not None:
            try:
                self._player.take(order["t"], order["q"])
            except TooFastError as error:
                self._stop()
                say({"refused": str(error)})

    def _switch(self, order: Mapping[str, Any]) -> None:
        if self._outputs is None:
            from rtde_io import RTDEIOInterface

            self._outputs = RTDEIOInterface(self._host)
        if "slider" in order:
            self._check(self._outputs.setSpeedSlider(order["slider"]), "setSpeedSlider")
        for number in range(DIGITAL_OUTPUTS) if "outputs" in order else ():
            on = bool(order["outputs"] >> number & 1)
            self._check(self._outputs.setStandardDigitalOut(number, on), "setStandardDigitalOut")

    def _stop(self) -> None:
        if self.state == "servo" and self._player is not None:
            self._player.stop()
            self._transition("stopping")
        elif self.state == "moving":
            # not waited for: the watchdog must be fed meanwhile
            self._control.stopJ(STOP_ACCELERATION, True)
            self._moved_at, self._seen_moving = time.monotonic(), False
            self._transition("stopping")

    def _act(self, now: float) -> None:
        if self.state in ("servo", "moving") and now - self._heard_at > COMMAND_TIMEOUT:
            self._stop()
        if self._player is not None:
            self._servo(self._player, now)
        else:
            self._check(self._call_promptly(self._control.kickWatchdog), "kickWatchdog")
            if self.state != "idle":
                self._check_arrival(now)

    def _servo(self, player: Player, now: float) -> None:
        elapsed, self._ticked_at = now - self._ticked_at, now
        q = list(player.tick(elapsed))
        done = self._call_promptly(lambda: self._control.servoJ(q, 0.0, 0.0, self._dt, LOOKAHEAD, GAIN))
        self._check(done, "servoJ")
        if player.at_rest:
            self._player = None
            self._check(self._control.servoStop(STOP_ACCELERATION), "servoStop")
            self._transition("idle")

    def _check_arrival(self, now: float) -> None:
        running = self._control.getAsyncOperationProgressEx().isAsyncOperationRunning()
        self._seen_moving = self._seen_moving or running
        # a move to where the arm is already may be over before it is seen to run
        if not running and (self._seen_moving or now - self._moved_at > UNSEEN):
            self._transition("idle")

    def _call_promptly(self, call: Callable[[], bool]) -> bool:
        began = time.monotonic()
        success = call()
        duration = time.monotonic() - began
        if duration > LONGEST_CALL:
            raise LostError(f"the connection to the controller broke: a call took {duration:.2f} s")
        return success

    def _check(self, done: bool, what: str) -> None:
        if not done:
            raise FaultError(f"the controller did not carry out {what}: its program does not run any more")

    def _transition(self, state: str) -> None:
        self.state = state
        self._tell(time.monotonic())

    def _tell(self, now: float) -> None:
        self._reported_at = now
        say({"state": self.state})


def say(data: Mapping[str, Any]) -> None:
    """Write one line for the driver, who may be gone."""
    with contextlib.suppress(OSError):
        os.write(_answers, json.dumps(data).encode() + b"\n")


_answers = 1


def main() -> int:
    """Run the process; 0 after an orderly end, 3 after a fault, ``LOST``."""
    global _answers  # noqa: PLW0603 - before anything else runs
    # the library prints on standard output
    _answers = os.dup(1)
    os.dup2(2, 1)
    host, rate = sys.argv[1], float(sys.argv[2])
    try:
        client = Client(host, rate)
        client.run()
        client.end()
    except (RuntimeError, FaultError) as error:
        say({"fault": str(error).strip()})
        return 3
    except LostError as error:
        # whoever watches this process has the program stopped; the library's own end may hang
        complain(error)
        os._exit(LOST)
    return 0


if __name__ == "__main__":
    sys.exit(main())
