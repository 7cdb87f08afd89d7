"""Dashboard port: one answer line per line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from labhil_sim_ur5.modes import RobotMode, Runtime, SafetyMode

if TYPE_CHECKING:
    from labhil_sim_ur5.controller import Controller

BANNER = "Connected: Universal Robots Dashboard Server"
MODEL = "UR5"
MAX_LINE_LENGTH = 4096
_SAFETY_NAMES = {
    SafetyMode.NORMAL: "NORMAL",
    SafetyMode.PROTECTIVE_STOP: "PROTECTIVE_STOP",
    SafetyMode.EMERGENCY_STOP: "ROBOT_EMERGENCY_STOP",
}


class Dashboard:
    """Answers of the dashboard.

    Args:
        controller: The controller.
        serial: Serial number of the robot.
        unlock_after: Time after which a protective stop can be unlocked, s.
    """

    def __init__(self, controller: Controller, serial: int, unlock_after: float) -> None:
        self._controller = controller
        self._serial = serial
        self._unlock_after = unlock_after
        self._answers: Mapping[str, Callable[[], str]] = {
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
        answer = self._answers.get(line)
        if answer is not None:
            return answer()
        command, _, argument = line.partition(" ")
        if command == "load" and argument:
            self._controller.program_name = argument
            return f"Loading program: /programs/{argument}"
        if command == "popup":
            self._controller.log(f"popup: {argument}")
            return "showing popup"
        if command == "addToLog":
            self._controller.log(f"log: {argument}")
            return "Added log message"
        if command == "setUserRole":
            return f"Setting user role: {argument}"
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
        if self._controller.stop_duration() < self._unlock_after:
            return (
                f"Cannot unlock protective stop until {self._unlock_after:g}s after occurrence. "
                "Always inspect cause of protective stop before unlocking"
            )
        self._controller.unlock()
        return "Protective stop releasing"

    def _restart_safety(self) -> str:
        self._controller.restart_safety()
        return "Restarting safety"


class LineSplitter:
    """Splits bytes into lines."""

    def __init__(self) -> None:
        self._incomplete = b""

    def split(self, data: bytes) -> list[str]:
        """Add bytes, and return the complete lines."""
        *complete, self._incomplete = (self._incomplete + data).split(b"\n")
        self._incomplete = self._incomplete[-MAX_LINE_LENGTH:]
        return [line.decode("utf-8", "replace") for line in complete]
