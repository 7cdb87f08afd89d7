"""Candidates for a repaired FMU.

The parameters of an FMU are starts in its description; forces, lags and the like are in a Python file beside.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from labhil.analysis.patch import unified_diff
from labhil.analysis.patch_bench import Candidate, FinerSteps, StatedNames, check_suffix, finer_steps
from labhil.analysis.patch_check import PatchCheck, inertia_felt_by_input, rest_velocity
from labhil.rig import RigFile
from labhil.simulators.companion import Usage, sort_effects
from labhil.simulators.fmu import Mechanism, fmu_simulator
from labhil.simulators.fmu_mechanism import CoSimulationMechanism
from labhil.simulators.fmu_patches import DESCRIPTION, patch_fmu, read_description, with_description
from labhil.simulators.simulator import Simulator
from labhil.simulators.stepped import JointForce

FMU_SUFFIX = ".fmu"

INTEGRATED = "its accelerations integrated in place of its own solver"
"""The remedy where the error of a co-simulation's own solver shows beside the noise."""


@dataclass(frozen=True)
class FmuBench:
    """An FMU with its rig file.

    Attributes:
        path: The FMU.
        original: The FMU as it was read.
        rig: The rig file, or a default one.
        stated: The names that the rig file states.
    """

    path: Path
    original: Simulator
    rig: RigFile
    stated: StatedNames
    run_by: str = "the FMU"

    @classmethod
    def read(cls, path: Path, rig_file: Path | RigFile | None) -> FmuBench:
        """Read an FMU with the signal names of a rig file, or with its own."""
        stated = StatedNames.read(rig_file)
        simulator = _read(path, stated, stated.name)
        return cls(path, simulator, stated.rig_of(simulator.name), stated)

    def check_name(self, out: Path) -> None:
        """Check that the new file is an FMU by its name."""
        check_suffix(out, self.path)

    def candidates(self, check: PatchCheck, out: Path) -> Iterator[Candidate]:
        """Yield the FMU with its starts, then with shorter steps for the forces beside it.

        Of a co-simulation, then the same with its accelerations integrated, for the case that its own
        solver is coarse.
        """
        text = read_description(self.path)
        starts = {name: quantity.start for name, quantity in self.original.parameters.items()}
        patched = patch_fmu(text, starts, check.values)
        content = with_description(self.path, text.changed())
        diff = unified_diff(text, out / DESCRIPTION, by_element=True)
        values = [check.values.get(name, start) for name, start in starts.items()]
        mechanism = self._mechanism(self.original)
        inertia = inertia_felt_by_input(mechanism, values)
        for own_solver, steps in self._ways(patched.remaining, values, check.dataset.test.period):
            remedies = [] if own_solver else [INTEGRATED]
            yield Candidate(
                content,
                tuple(text.changes),
                diff,
                patched.remaining,
                self._usage(steps.length),
                rest_velocity(patched.remaining, steps.length, inertia),
                " and ".join([*remedies, *([steps.remedy] if steps.remedy else [])]),
                patched.starts,
                substeps=steps.divisor,
                own_solver=own_solver,
            )

    def load(self, draft: Path, candidate: Candidate, force: JointForce | None) -> Simulator:
        """Load a candidate with the force of its companion."""
        simulator = _read(draft, self.stated, self.original.name)
        mechanism = self._mechanism(simulator)
        if isinstance(mechanism, CoSimulationMechanism):
            mechanism.own_solver = candidate.own_solver
        added = mechanism.added_force
        added.force, added.substeps = force, candidate.substeps
        return simulator

    def _ways(
        self, remaining: Mapping[str, float], values: Sequence[float], period: float
    ) -> Iterator[tuple[bool, FinerSteps]]:
        """Yield whether the FMU's own solver runs it, and in which steps."""
        mechanism, steps = self._mechanism(self.original), list(finer_steps(remaining, period))
        if not isinstance(mechanism, CoSimulationMechanism):
            yield from product([True], steps)
            return
        forced = sort_effects(remaining).has_force
        lengths = {each: each.length if forced else period for each in steps}
        yield from ((True, each) for each in steps if mechanism.makes_steps_of(values, lengths[each]))
        yield from product([False], steps)

    def _usage(self, step: float) -> Usage:
        position, velocity = self.original.states
        signal = next(iter(self.original.inputs))
        return Usage.of_step(
            signal,
            f"{signal} += effects.force({position}, {velocity}{{drive}})",
            step,
            "start_values = effects.PARAMETERS (a tool may leave the starts of the binary itself)",
        )

    @staticmethod
    def _mechanism(simulator: Simulator) -> Mechanism:
        mechanism = simulator.stepped
        assert isinstance(mechanism, Mechanism)
        return mechanism


def _read(path: Path, stated: StatedNames, name: str) -> Simulator:
    return fmu_simulator(path, inputs=stated.inputs, outputs=stated.outputs, name=name)
