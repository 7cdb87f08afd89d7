"""Injected faults: at set times, or by lines on standard input."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from labhil_sim_ur5.controller import Controller
from labhil_sim_ur5.modes import RobotMode
from labhil_sim_ur5.server import Server
from labhil_sim_ur5.settings import FaultSettings

MAX_STALL = 60.0


class Faults:
    """Injects faults into a server and its controller.

    Lines: ``drop``, ``stall SECONDS``, ``truncate``, ``protective stop``, ``unlock``, ``emergency stop``,
    ``release``, ``end program``, ``contact STEPS``, ``digital_in NUMBER 0|1``, ``analog_in 0|1 SHARE``.
    """

    def __init__(self, settings: FaultSettings, server: Server, controller: Controller) -> None:
        self._server, self._controller = server, controller
        self._start_time: float | None = None
        self._due = sorted(
            (at, name)
            for at, name in (
                (settings.drop_at, "drop"),
                (settings.stall_at, f"stall {settings.stall_for:g}"),
                (settings.truncate_at, "truncate"),
                (settings.protective_stop_at, "protective stop"),
                (settings.emergency_stop_at, "emergency stop"),
                (settings.end_program_at, "end program"),
            )
            if at > 0.0
        )
        self._actions: Mapping[str, Callable[[list[str]], None]] = {
            "drop": lambda arguments: self._drop(),
            "stall": lambda arguments: time.sleep(min(max(float(arguments[0]), 0.0), MAX_STALL)),
            "truncate": lambda arguments: self._truncate(),
            "protective stop": lambda arguments: controller.protective_stop("asked for from outside"),
            "unlock": lambda arguments: self._unlock(),
            "emergency stop": lambda arguments: controller.emergency_stop("the button was pressed"),
            "release": lambda arguments: self._release(),
            "end program": lambda arguments: controller.end_program("stopped at the panel"),
            "contact": lambda arguments: self._set_contact(int(arguments[0])),
            "digital_in": lambda arguments: self._set_digital_input(int(arguments[0]), int(arguments[1])),
            "analog_in": lambda arguments: self._set_analog_input(int(arguments[0]), float(arguments[1])),
        }

    def tick(self) -> None:
        """Inject the faults that are due."""
        if not self._due:
            return
        if self._start_time is None:
            if any(client.conversation.started for client in self._server.rtde_clients()):
                self._start_time = time.monotonic()
            return
        while self._due and time.monotonic() - self._start_time >= self._due[0][0]:
            self.execute(self._due.pop(0)[1])

    def execute(self, line: str) -> None:
        """Execute a line."""
        name = next((name for name in self._actions if line == name or line.startswith(f"{name} ")), None)
        if name is None:
            self._controller.log(f"not understood: {line!r}; known: {', '.join(self._actions)}")
            return
        try:
            self._actions[name](line[len(name) :].split())
        except (ValueError, IndexError):
            self._controller.log(f"not understood: {line!r}: numbers are missing or wrong")
            return
        self._controller.log(f"done: {line}")

    def _drop(self) -> None:
        for client in self._server.rtde_clients():
            self._server.disconnect(client)

    def _truncate(self) -> None:
        for client in self._server.rtde_clients():
            if client.conversation.started:
                sample = client.conversation.sample(self._controller.values)
                client.send(sample[: len(sample) // 2])
            self._server.disconnect(client)

    def _unlock(self) -> None:
        self._controller.unlock()

    def _release(self) -> None:
        """Release the emergency stop button, switch on, and release the brakes."""
        self._controller.release_emergency_stop()
        self._controller.power(RobotMode.IDLE)
        self._controller.power(RobotMode.RUNNING)

    def _set_contact(self, steps: int) -> None:
        self._controller.contact = steps

    def _set_digital_input(self, number: int, level: int) -> None:
        bits = self._controller.values["actual_digital_input_bits"]
        if not 0 <= number < 64 or not isinstance(bits, int):
            raise ValueError(number)
        self._controller.values["actual_digital_input_bits"] = (
            bits | 1 << number if level else bits & ~(1 << number)
        )

    def _set_analog_input(self, number: int, fraction: float) -> None:
        if number not in {0, 1}:
            raise ValueError(number)
        self._controller.values[f"standard_analog_input{number}"] = fraction
