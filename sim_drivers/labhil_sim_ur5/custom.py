"""Programs other than the client's own: plain calls, one after the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from labhil_sim_ur5.program import Program


class CustomProgram:
    """Runs the lines of a script one by one."""

    def __init__(self, program: Program) -> None:
        self._program = program

    def tick(self) -> None:
        """Do what can be done in one period."""
        self._program.controller.end_program("at its end")
