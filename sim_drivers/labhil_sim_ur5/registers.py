"""Registers for the communication of a client and the control program, at the program's offset."""

from __future__ import annotations

from collections.abc import Iterable

from labhil_sim_ur5.codec import Value
from labhil_sim_ur5.poses import Pose


class Registers:
    """Integer and float registers of one program, counted from its offset."""

    def __init__(self, values: dict[str, Value], offset: int) -> None:
        self._values = values
        self.offset = offset
        self._command = f"input_int_register_{offset}"

    @property
    def command(self) -> int:
        """The requested command."""
        value = self._values[self._command]
        return int(value) if isinstance(value, int | float) else 0

    @property
    def command_name(self) -> str:
        """Name of the variable of the command."""
        return self._command

    def integer(self, number: int) -> int:
        """Return an integer that the client has set."""
        value = self._values.get(f"input_int_register_{number + self.offset}", 0)
        return int(value) if isinstance(value, int | float) else 0

    def number(self, number: int) -> float:
        """Return a float that the client has set."""
        value = self._values.get(f"input_double_register_{number + self.offset}", 0.0)
        return float(value) if isinstance(value, int | float) else 0.0

    def six(self, first: int) -> Pose:
        """Return six floats that the client has set."""
        a, b, c, d, e, f = (self.number(first + i) for i in range(6))
        return (a, b, c, d, e, f)

    def answer_integer(self, number: int, value: int) -> None:
        """Set an integer for the client."""
        name = f"output_int_register_{number + self.offset}"
        if name in self._values:
            self._values[name] = value

    def answer(self, values: Iterable[float], first: int = 0) -> None:
        """Set consecutive floats for the client."""
        for number, value in enumerate(values, first + self.offset):
            name = f"output_double_register_{number}"
            if name in self._values:
                self._values[name] = float(value)
