"""Interpreter of programs other than the client's: plain calls with numbers, one after the other.

There are no variables, conditions or loops; a line that is no known call is logged and skipped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from labhil_sim_ur5.motion import Halt, Motion
from labhil_sim_ur5.moves import as_six, make_move
from labhil_sim_ur5.script import Statement

if TYPE_CHECKING:
    from labhil_sim_ur5.program import Program

_OUTPUTS = {
    "set_digital_out": 0,
    "set_standard_digital_out": 0,
    "set_configurable_digital_out": 8,
    "set_tool_digital_out": 16,
}


class CustomProgram:
    """Runs the lines of a script in sequence."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._remaining = list(program.script.body)
        self._moving: Motion | None = None
        self._sleep = 0.0
        self._calls: Mapping[str, Callable[[Statement], None]] = {
            "movej": self._move,
            "movel": self._move,
            "movep": self._move,
            "stopj": self._stop,
            "stopl": self._stop,
            "sleep": self._wait,
            "sync": self._wait,
            "textmsg": lambda line: program.controller.log(f"textmsg: {' '.join(map(str, line.arguments))}"),
            "popup": lambda line: program.controller.log(f"popup: {' '.join(map(str, line.arguments[:1]))}"),
            "protective_stop": lambda line: program.controller.protective_stop("triggered by the program"),
            "set_tcp": self._set_tool,
            "set_payload": self._set_payload,
            "write_output_integer_register": self._write_integer,
            "write_output_float_register": self._write_float,
        }

    def tick(self) -> None:
        """Execute lines until one takes time."""
        if self._program.controller.is_moving(self._moving):
            return
        self._sleep -= self._program.controller.period
        while self._sleep <= 0.0 and not self._program.controller.is_moving(self._moving):
            if not self._remaining:
                self._program.controller.end_program("at its end")
                return
            self._execute(self._remaining.pop(0))

    def _execute(self, line: Statement) -> None:
        if line.name in _OUTPUTS:
            number = _OUTPUTS[line.name] + int(line.number("n", 0, 0))
            level = int(bool(line.number("b", 1, 0)))
            self._program.controller.terminals.set_bits(1 << number, level << number)
        elif line.name in self._calls:
            self._calls[line.name](line)
        else:
            self._program.controller.log(f"line not understood, passed over: {line.line}")

    def _move(self, line: Statement) -> None:
        controller = self._program.controller
        move = make_move(self._program, line, controller.plan.q)
        if move is None:
            controller.log(f"line not understood, passed over: {line.line}")
            return
        self._moving = controller.start_motion(move[0](controller.plan.q))

    def _stop(self, line: Statement) -> None:
        controller = self._program.controller
        halt = Halt.of_joints(controller.plan, line.number("a", 0, 2.0))
        self._moving = controller.start_motion(halt)

    def _wait(self, line: Statement) -> None:
        self._sleep = line.number("t", 0, self._program.controller.period)

    def _set_tool(self, line: Statement) -> None:
        values = line.six()
        if values is not None:
            self._program.controller.tool = as_six(values)

    def _set_payload(self, line: Statement) -> None:
        controller = self._program.controller
        controller.set_payload(max(line.number("m", 0, 0.0), 0.0), controller.payload[1])

    def _write_integer(self, line: Statement) -> None:
        self._write("output_int_register", line, int(line.number("value", 1, 0)))

    def _write_float(self, line: Statement) -> None:
        self._write("output_double_register", line, line.number("value", 1, 0.0))

    def _write(self, kind: str, line: Statement, value: float) -> None:
        name = f"{kind}_{int(line.number('address', 0, -1))}"
        if name in self._program.controller.values:
            self._program.controller.values[name] = value
        else:
            self._program.controller.log(f"there is no {name}: {line.line}")
