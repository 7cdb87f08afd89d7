"""A simulator's own rollouts as a model: what its file really does, effects on the way in and out beside."""

from __future__ import annotations

from labhil.errors import UsageError
from labhil.physics.model import Record, Windows
from labhil.rig import RigFile
from labhil.signals import FloatArray
from labhil.simulators.model import SimulatorModel
from labhil.simulators.simulator import Simulator


class RolledOutModel(SimulatorModel):
    """The model of which nothing is tabulated: every window is stepped by the simulator itself.

    It is slow and serves to score a file as it stands; forces are the file's own.
    """

    def __init__(self, simulator: Simulator, rig: RigFile, record: Record) -> None:
        if simulator.stepped is None:
            raise UsageError(f"simulator {simulator.name!r}: expected one that is stepped, found a function")
        self._itself = simulator.stepped
        super().__init__(simulator, rig, record)

    def _try_out(self, parameters: object, record: Record) -> None:
        """Nothing is fitted here."""

    def _trajectory(
        self, theta: FloatArray, record: Record, windows: Windows, states: FloatArray
    ) -> FloatArray:
        nodes = self._path.nodes(record, 0, lambda name: self._values.of(theta, name))
        numbers = [self._values.of(theta, name) for name in self.simulator.parameters]
        return self._itself.roll_out(numbers, record, nodes, windows, states)
