"""The register that tells how far an asynchronous operation is."""

from __future__ import annotations

from labhil_sim_ur5.registers import Registers

REGISTER = 2
RUNNING = 1 << 15


class Progress:
    """``output_int_register_2``: operation (bits 24–30), count of writes (16–22), running (15), progress."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers
        self._operation = 0
        self._writes = 0

    def started(self) -> None:
        """A new operation begins."""
        self._operation = (self._operation + 1) % 128
        self._write(RUNNING)

    def at(self, value: int) -> None:
        """The operation has come to its ``value``-th waypoint."""
        if value == 0:
            self._operation = (self._operation + 1) % 128
        self._write(RUNNING | min(value, RUNNING - 1))

    def passed(self, value: int) -> None:
        """The same within an operation that the client waits for."""
        self.at(value)

    def finished(self) -> None:
        """No operation is under way."""
        self._write(0)

    def _write(self, low: int) -> None:
        self._writes = (self._writes + 1) % 128
        self._registers.answer_integer(REGISTER, self._operation << 24 | self._writes << 16 | low)
