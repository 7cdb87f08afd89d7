"""Candidates for the repaired file of a simulator in Python.

The starts of its parameters are numbers in its file; forces, lags and the like are in a Python file beside.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from labhil.analysis.patch import unified_diff
from labhil.analysis.patch_bench import Candidate, StatedNames, check_suffix, finer_steps
from labhil.analysis.patch_check import PatchCheck, inertia_felt_by_input, rest_velocity
from labhil.errors import UsageError
from labhil.python_file import module_of, object_of
from labhil.rig import RigFile
from labhil.simulators.companion import Usage
from labhil.simulators.patches import drop_inactive, format_number, with_shared_values
from labhil.simulators.python_rates import PythonRates
from labhil.simulators.python_rollout import PythonRollout
from labhil.simulators.python_step import PythonStep
from labhil.simulators.python_text import PythonText
from labhil.simulators.simulator import Simulator
from labhil.simulators.stepped import JointForce

SUFFIX = ".py"


def split_name(into: Path) -> tuple[Path, str] | None:
    """Split ``bench.py:pendulum`` into file and name; the name is empty where none is given.

    Returns:
        File and name; None where it is no Python file.
    """
    file, _, name = into.name.partition(":")
    return (into.with_name(file), name) if file.endswith(SUFFIX) else None


@dataclass(frozen=True)
class PythonBench:
    """A Python file with a simulator, with its rig file.

    Attributes:
        path: The file.
        name: The name of the simulator in the file.
        original: The simulator, so that it can be stepped.
        rig: The rig file, or a default one.
    """

    path: Path
    name: str
    original: Simulator
    rig: RigFile
    run_by: str = "Python"

    @classmethod
    def read(cls, file: Path, name: str, rig_file: Path | RigFile | None) -> PythonBench:
        """Run a file and take a simulator from it; the only one where the name is empty.

        Raises:
            UsageError: There is none, or there are several and none is named.
        """
        name = name or _only_simulator(file)
        original = _stepped(file, name)
        return cls(file, name, original, StatedNames.read(rig_file).rig_of(original.name))

    def check_name(self, out: Path) -> None:
        """Check that the new file is a Python file by its name."""
        check_suffix(out, self.path)

    def candidates(self, check: PatchCheck, out: Path) -> Iterator[Candidate]:
        """Yield the file with its starts, then with shorter steps for the forces beside it."""
        text = PythonText.read(self.path, self.name, self.original.parameters)
        values = with_shared_values(check.values)
        starts = {n: values.pop(n, quantity.start) for n, quantity in self.original.parameters.items()}
        for name, quantity in self.original.parameters.items():
            if format_number(starts[name]) != format_number(quantity.start):
                text.set(name, format_number(starts[name]), f"{name} as identified, {quantity.unit}")
        remaining = drop_inactive(values)
        mechanism, numbers = _mechanism(self.original), list(starts.values())
        inertia = mechanism.inertia(numbers) or inertia_felt_by_input(mechanism, numbers)
        for steps in finer_steps(remaining, check.dataset.test.period):
            yield Candidate(
                text.changed(),
                tuple(text.changes),
                unified_diff(text, out),
                remaining,
                self._usage(steps.length),
                rest_velocity(remaining, steps.length, abs(inertia)),
                steps.remedy,
                substeps=steps.divisor,
            )

    def load(self, draft: Path, candidate: Candidate, force: JointForce | None) -> Simulator:
        """Load a candidate with the force of its companion."""
        simulator = _stepped(draft, self.name)
        added = _mechanism(simulator).added_force
        added.force, added.substeps = force, candidate.substeps
        return simulator

    def _usage(self, step: float) -> Usage:
        """How a simulation with steps of at most ``step`` s calls the companion."""
        (position, velocity), signal = self.original.states, next(iter(self.original.inputs))
        force = f"effects.force({position}, {velocity}{{drive}})"
        inertia = self.original.coordinate.inertia
        if not inertia:
            return Usage.of_step(signal, f"{signal} += {force}", step)
        return Usage.of_step(signal, f"{velocity} += dt * {force} / {inertia}", step)


Mechanism = PythonRates | PythonStep | PythonRollout


def _only_simulator(file: Path) -> str:
    """The name of the only simulator of a file."""
    found = [name for name, value in vars(module_of(file.resolve())).items() if isinstance(value, Simulator)]
    if len(found) != 1:
        names = f"{', '.join(found)}: give {file}:{found[0]}" if found else "none"
        raise UsageError(f"{file}: expected one simulator (what labhil.simulator gives), found {names}")
    return found[0]


def _stepped(file: Path, name: str) -> Simulator:
    """The simulator of a file; one that fits compile is stepped by Python here."""
    simulator = object_of(f"{file.name}:{name}", file.parent)
    if not isinstance(simulator, Simulator):
        raise UsageError(
            f"{file}: {name}: expected what labhil.simulator gives, found {type(simulator).__name__}"
        )
    if simulator.stepped is not None:
        return simulator
    return replace(simulator, stepped=PythonRates(simulator))


def _mechanism(simulator: Simulator) -> Mechanism:
    return cast("Mechanism", simulator.stepped)
