"""The register of the progress of an asynchronous operation."""

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

    def start(self) -> None:
        """Begin a new operation."""
        self._operation = (self._operation + 1) % 128
        self._write(RUNNING)

    def set_waypoint(self, value: int) -> None:
        """Set the index of the operation's waypoint; 0 begins a new operation."""
        if value == 0:
            self._operation = (self._operation + 1) % 128
        self._write(RUNNING | min(value, RUNNING - 1))

    def pass_waypoint(self, value: int) -> None:
        """Set the index of the waypoint of a blocking operation."""
        self.set_waypoint(value)

    def finish(self) -> None:
        """End the operation."""
        self._write(0)

    def _write(self, low: int) -> None:
        self._writes = (self._writes + 1) % 128
        self._registers.answer_integer(REGISTER, self._operation << 24 | self._writes << 16 | low)
