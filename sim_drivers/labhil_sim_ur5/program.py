"""The client's control program, as its register contract has it: a command in, its answer and a state out.

``output_int_register_0`` is 1 when a command may come and 2 when one is done; the client then sends 0.
Commands that are meant for every tick are carried out every tick and leave 1. A blocking command leaves 1
until it is done. 255 ends the program.
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
    """One running program."""

    def __init__(self, controller: Controller, script: Script) -> None:
        self.controller = controller
        self.script = script
        self.registers = Registers(controller.values, script.offset)
        self.progress = Progress(self.registers)
        self.asynchronous: Motion | None = None
        self.continuous: Motion | None = None
        """What a command for every tick keeps going: servo, speed or jog."""
        self.watchdog: float | None = None
        self.watching_contact = False
        self.contact_steps = 0
        self.logged: set[int] = set()
        self._waiting: Motion | None = None
        self._executing = False
        self._since = controller.ticks
        self._custom = None if script.control else CustomProgram(self)
        if script.control:
            self.progress.finished()
            self._signal(READY)

    def tick(self) -> None:
        """Do what the program does in one period of the controller."""
        try:
            if self._custom is not None:
                self._custom.tick()
                return
            self._listen()
        except ScriptError as error:
            self.controller.end_program(f"runtime error: {error}")

    def _listen(self) -> None:
        if self._is_starved():
            self.controller.end_program("the watchdog heard nothing from the client")
            return
        self._watch_asynchronous()
        self._watch_contact()
        if self._waiting is not None:
            if self.controller.moving(self._waiting):
                return
            self._waiting = None
            self._signal(DONE)
            return
        command = self.registers.command
        if command in REALTIME:
            self._carry_out(command)
            self._signal(READY)
        elif command == 0:
            self._executing = False
            self._signal(READY)
        elif not self._executing:
            self._executing = True
            if command == END:
                self.controller.end_program("the client asked for it")
                return
            self._waiting = self._carry_out(command)
            if self._waiting is None:
                self._signal(DONE)

    def _carry_out(self, command: int) -> Motion | None:
        """Carry out one command; return the motion that it waits for."""
        handler = COMMANDS.get(command)
        if handler is None:
            self.controller.log(f"command {command} is unknown: answered as done, nothing happens")
            return None
        waited_for = handler(self)
        return waited_for if waited_for is not None and not waited_for.done else None

    def start(self, motion: Motion, asynchronous: bool) -> Motion | None:
        """Begin a motion; return it when the program waits for it."""
        self.stop_asynchronous()
        self.refuse_second()
        self.controller.begin(motion)
        if not asynchronous:
            return motion
        self.asynchronous = motion
        self.progress.started()
        return None

    def stop_asynchronous(self) -> None:
        """Let go of an asynchronous motion; what comes next takes its place."""
        if self.asynchronous is not None:
            self.asynchronous = None
            self.progress.finished()

    def refuse_second(self) -> None:
        """Raise ScriptError while a servo, speed or jog command keeps the arm: the controller does so too."""
        if self.controller.moving(self.continuous):
            raise ScriptError("another thread is already controlling the robot: stop it first")

    def _watch_asynchronous(self) -> None:
        if self.asynchronous is not None and not self.controller.moving(self.asynchronous):
            self.asynchronous = None
            self.progress.finished()

    def _watch_contact(self) -> None:
        """Stop at a contact while the client watches for one."""
        if self.watching_contact and self.controller.contact > 0:
            self.watching_contact = False
            self.contact_steps = self.controller.contact
            halt_tool(self, CONTACT_STOP)

    def _is_starved(self) -> bool:
        if self.watchdog is None:
            return False
        controller = self.controller
        last = max(controller.updated.get(self.registers.command_name, 0), self._since)
        return (controller.ticks - last) * controller.period > self.watchdog

    def watch(self, frequency: float) -> None:
        """Set the watchdog: the client must be heard that often (Hz); 0 takes it away."""
        self._since = self.controller.ticks
        self.watchdog = 1.0 / frequency if frequency > 0.0 else None

    def _signal(self, state: int) -> None:
        self.registers.answer_integer(0, state)
