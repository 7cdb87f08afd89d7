"""Port 29999: one line in, one line out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from labhil_sim_ur5.modes import RobotMode, Runtime, SafetyMode

if TYPE_CHECKING:
    from labhil_sim_ur5.controller import Controller

BANNER = "Connected: Universal Robots Dashboard Server"
MODEL = "UR5"
LONGEST_LINE = 4096
_SAFETY_NAMES = {
    SafetyMode.NORMAL: "NORMAL",
    SafetyMode.PROTECTIVE_STOP: "PROTECTIVE_STOP",
    SafetyMode.EMERGENCY_STOP: "ROBOT_EMERGENCY_STOP",
}


class Dashboard:
    """Answers for all clients: the robot's ``serial`` number, ``unlock_after`` s that a stop must hold."""

    def __init__(self, controller: Controller, serial: int, unlock_after: float) -> None:
        self._controller = controller
        self._serial = serial
        self._unlock_after = unlock_after
        self._exact: Mapping[str, Callable[[], str]] = {
            "play": lambda: "Starting program" if controller.play() else "Failed to execute: play",
            "stop": self._stop,
            "pause": lambda: "Pausing program" if controller.pause() else "Failed to execute: pause",
            "running": lambda: f"Program running: {str(controller.runtime is Runtime.PLAYING).lower()}",
            "robotmode": lambda: f"Robotmode: {controller.robot_mode.name}",
            "safetymode": lambda: f"Safetymode: {_SAFETY_NAMES[controller.safety]}",
            "safetystatus": lambda: f"Safetystatus: {_SAFETY_NAMES[controller.safety]}",
            "programState": self._program_state,
            "get loaded program": lambda: f"Loaded program: {controller.program_name}",
            "isProgramSaved": lambda: f"True {controller.program_name}",
            "PolyscopeVersion": self._version,
            "version": self._version,
            "get serial number": lambda: str(serial),
            "get robot model": lambda: MODEL,
            "is in remote control": lambda: "true",
            "power on": lambda: self._power(RobotMode.IDLE, "Powering on"),
            "power off": lambda: self._power(RobotMode.POWER_OFF, "Powering off"),
            "brake release": lambda: self._power(RobotMode.RUNNING, "Brake releasing"),
            "unlock protective stop": self._unlock,
            "restart safety": self._restart_safety,
            "close popup": lambda: "closing popup",
            "close safety popup": lambda: "closing safety popup",
            "shutdown": lambda: "Shutting down",
        }

    def answer(self, line: str) -> str:
        """Return the answer to one line."""
        line = line.strip()
        exact = self._exact.get(line)
        if exact is not None:
            return exact()
        word, _, rest = line.partition(" ")
        if word == "load" and rest:
            self._controller.program_name = rest
            return f"Loading program: /programs/{rest}"
        if word == "popup":
            self._controller.log(f"popup: {rest}")
            return "showing popup"
        if word == "addToLog":
            self._controller.log(f"log: {rest}")
            return "Added log message"
        if word == "setUserRole":
            return f"Setting user role: {rest}"
        return f"could not understand: '{line}'"

    def _version(self) -> str:
        version = self._controller.version
        return f"URSoftware {version.major}.{version.minor}.{version.bugfix}.{version.build}"

    def _stop(self) -> str:
        self._controller.end_program("stopped from the dashboard")
        return "Stopped"

    def _program_state(self) -> str:
        paused = self._controller.runtime in {Runtime.PAUSING, Runtime.PAUSED}
        running = self._controller.runtime in {Runtime.PLAYING, Runtime.RESUMING}
        state = "PAUSED" if paused else "PLAYING" if running else "STOPPED"
        return f"{state} {self._controller.program_name}"

    def _power(self, mode: RobotMode, reply: str) -> str:
        self._controller.power(mode)
        return reply

    def _unlock(self) -> str:
        if self._controller.stopped_for() < self._unlock_after:
            return (
                f"Cannot unlock protective stop until {self._unlock_after:g}s after occurrence. "
                "Always inspect cause of protective stop before unlocking"
            )
        self._controller.unlock()
        return "Protective stop releasing"

    def _restart_safety(self) -> str:
        self._controller.restart_safety()
        return "Restarting safety"


class Lines:
    """Cuts bytes into lines."""

    def __init__(self) -> None:
        self._rest = b""

    def take(self, data: bytes) -> list[str]:
        """Return the lines that are complete now."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-LONGEST_LINE:]
        return [line.decode("utf-8", "replace") for line in whole]
