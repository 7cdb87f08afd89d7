"""Faults to order: at a time that was set, or when a line on standard input says so."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from labhil_sim_ur5.controller import Controller
from labhil_sim_ur5.modes import RobotMode
from labhil_sim_ur5.server import Server
from labhil_sim_ur5.settings import FaultSettings

LONGEST_STALL = 60.0


class Faults:
    """Does to a server and its controller what settings and lines ask for.

    Lines: ``drop``, ``stall SECONDS``, ``truncate``, ``protective stop``, ``unlock``, ``emergency stop``,
    ``release``, ``end program``, ``contact STEPS``, ``digital_in NUMBER 0|1``, ``analog_in 0|1 SHARE``.
    """

    def __init__(self, settings: FaultSettings, server: Server, controller: Controller) -> None:
        self._server, self._controller = server, controller
        self._began: float | None = None
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
        self._lines: Mapping[str, Callable[[list[str]], None]] = {
            "drop": lambda words: self._drop(),
            "stall": lambda words: time.sleep(min(max(float(words[0]), 0.0), LONGEST_STALL)),
            "truncate": lambda words: self._truncate(),
            "protective stop": lambda words: controller.protective_stop("asked for from outside"),
            "unlock": lambda words: self._unlock(),
            "emergency stop": lambda words: controller.emergency_stop("the button was pressed"),
            "release": lambda words: self._release(),
            "end program": lambda words: controller.end_program("stopped at the panel"),
            "contact": lambda words: self._contact(int(words[0])),
            "digital_in": lambda words: self._digital(int(words[0]), int(words[1])),
            "analog_in": lambda words: self._analog(int(words[0]), float(words[1])),
        }

    def tick(self) -> None:
        """Do what is due."""
        if not self._due:
            return
        if self._began is None:
            if any(client.conversation.started for client in self._server.rtde_clients()):
                self._began = time.monotonic()
            return
        while self._due and time.monotonic() - self._began >= self._due[0][0]:
            self.carry_out(self._due.pop(0)[1])

    def carry_out(self, line: str) -> None:
        """Do what a line says."""
        name = next((name for name in self._lines if line == name or line.startswith(f"{name} ")), None)
        if name is None:
            self._controller.log(f"not understood: {line!r}; known: {', '.join(self._lines)}")
            return
        try:
            self._lines[name](line[len(name) :].split())
        except (ValueError, IndexError):
            self._controller.log(f"not understood: {line!r}: numbers are missing or wrong")
            return
        self._controller.log(f"done: {line}")

    def _drop(self) -> None:
        for client in self._server.rtde_clients():
            self._server.hang_up(client)

    def _truncate(self) -> None:
        for client in self._server.rtde_clients():
            if client.conversation.started:
                sample = client.conversation.sample(self._controller.values)
                client.send(sample[: len(sample) // 2])
            self._server.hang_up(client)

    def _unlock(self) -> None:
        self._controller.unlock()

    def _release(self) -> None:
        """Let the emergency button go, switch on, release the brakes."""
        self._controller.restore()
        self._controller.power(RobotMode.IDLE)
        self._controller.power(RobotMode.RUNNING)

    def _contact(self, steps: int) -> None:
        self._controller.contact = steps

    def _digital(self, number: int, level: int) -> None:
        bits = self._controller.values["actual_digital_input_bits"]
        if not 0 <= number < 64 or not isinstance(bits, int):
            raise ValueError(number)
        self._controller.values["actual_digital_input_bits"] = (
            bits | 1 << number if level else bits & ~(1 << number)
        )

    def _analog(self, number: int, share: float) -> None:
        if number not in {0, 1}:
            raise ValueError(number)
        self._controller.values[f"standard_analog_input{number}"] = share
