"""The client's control program by its contract of registers: a command in, its answer and a state out.

``output_int_register_0`` is 1 when a command may come and 2 when one is done; the client then sends 0.
Real-time commands are executed in every tick and keep 1. A blocking command keeps 1 until it is done. 255
ends the program.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from labhil_sim_ur5.commands import COMMANDS, REALTIME
from labhil_sim_ur5.custom import CustomProgram
from labhil_sim_ur5.motion import Motion
from labhil_sim_ur5.moves import CONTACT_STOP, halt_tool
from labhil_sim_ur5.progress import Progress
from labhil_sim_ur5.registers import Registers
from labhil_sim_ur5.script import Script, ScriptError

if TYPE_CHECKING:
    from labhil_sim_ur5.controller import Controller

READY, DONE = 1, 2
END = 255


class Program:
    """A running program."""

    def __init__(self, controller: Controller, script: Script) -> None:
        self.controller = controller
        self.script = script
        self.registers = Registers(controller.values, script.offset)
        self.progress = Progress(self.registers)
        self.asynchronous: Motion | None = None
        self.continuous: Motion | None = None
        """The motion of a real-time command: servo, speed or jog."""
        self.watchdog: float | None = None
        self.watching_contact = False
        self.contact_steps = 0
        self.logged: set[int] = set()
        self._awaited: Motion | None = None
        self._executing = False
        self._watchdog_start = controller.ticks
        self._custom = None if script.control else CustomProgram(self)
        if script.control:
            self.progress.finish()
            self._set_state(READY)

    def tick(self) -> None:
        """Execute one period of the program."""
        try:
            if self._custom is not None:
                self._custom.tick()
                return
            self._handle_command()
        except ScriptError as error:
            self.controller.end_program(f"runtime error: {error}")

    def _handle_command(self) -> None:
        if self._watchdog_expired():
            self.controller.end_program("the watchdog heard nothing from the client")
            return
        self._watch_asynchronous()
        self._watch_contact()
        if self._awaited is not None:
            if self.controller.is_moving(self._awaited):
                return
            self._awaited = None
            self._set_state(DONE)
            return
        command = self.registers.command
        if command in REALTIME:
            self._execute(command)
            self._set_state(READY)
        elif command == 0:
            self._executing = False
            self._set_state(READY)
        elif not self._executing:
            self._executing = True
            if command == END:
                self.controller.end_program("the client asked for it")
                return
            self._awaited = self._execute(command)
            if self._awaited is None:
                self._set_state(DONE)

    def _execute(self, command: int) -> Motion | None:
        """Execute a command; return the motion that it waits for."""
        handler = COMMANDS.get(command)
        if handler is None:
            self.controller.log(f"command {command} is unknown: answered as done, nothing happens")
            return None
        motion = handler(self)
        return motion if motion is not None and not motion.done else None

    def start(self, motion: Motion, asynchronous: bool) -> Motion | None:
        """Start a motion; return it when the program waits for it."""
        self.stop_asynchronous()
        self.check_free()
        self.controller.start_motion(motion)
        if not asynchronous:
            return motion
        self.asynchronous = motion
        self.progress.start()
        return None

    def stop_asynchronous(self) -> None:
        """Forget an asynchronous motion, which the next motion replaces."""
        if self.asynchronous is not None:
            self.asynchronous = None
            self.progress.finish()

    def check_free(self) -> None:
        """Raise ScriptError while a servo, speed or jog command moves the arm, as the controller does."""
        if self.controller.is_moving(self.continuous):
            raise ScriptError("another thread is already controlling the robot: stop it first")

    def _watch_asynchronous(self) -> None:
        if self.asynchronous is not None and not self.controller.is_moving(self.asynchronous):
            self.asynchronous = None
            self.progress.finish()

    def _watch_contact(self) -> None:
        """Stop at a contact while contact detection is on."""
        if self.watching_contact and self.controller.contact > 0:
            self.watching_contact = False
            self.contact_steps = self.controller.contact
            halt_tool(self, CONTACT_STOP)

    def _watchdog_expired(self) -> bool:
        if self.watchdog is None:
            return False
        controller = self.controller
        last_update = max(controller.updated.get(self.registers.command_name, 0), self._watchdog_start)
        return (controller.ticks - last_update) * controller.period > self.watchdog

    def set_watchdog(self, frequency: float) -> None:
        """Set the lowest rate of commands, Hz; 0 switches the watchdog off."""
        self._watchdog_start = self.controller.ticks
        self.watchdog = 1.0 / frequency if frequency > 0.0 else None

    def _set_state(self, state: int) -> None:
        self.registers.answer_integer(0, state)
