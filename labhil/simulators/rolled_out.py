"""A model that steps the simulator itself: it scores a file as it is, with effects of input and sensor."""

from __future__ import annotations

from labhil.errors import UsageError
from labhil.physics.record import Record, Windows
from labhil.rig import RigFile
from labhil.signals import FloatArray
from labhil.simulators.model import SimulatorModel
from labhil.simulators.simulator import Simulator


class RolledOutModel(SimulatorModel):
    """A model without a table: the simulator steps every window.

    It is slow, and forces are those of the file alone.
    """

    def __init__(self, simulator: Simulator, rig: RigFile, record: Record) -> None:
        if simulator.stepped is None:
            raise UsageError(f"simulator {simulator.name!r}: expected one that is stepped, found a function")
        self._stepped = simulator.stepped
        super().__init__(simulator, rig, record)

    def _examine(self, parameters: object, record: Record) -> None:
        """Nothing is fitted here."""

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        nodes = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        numbers = [self._values.of(theta, name) for name in self.simulator.parameters]
        return self._stepped.roll_out(numbers, record, nodes, windows, states)
