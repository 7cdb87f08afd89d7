"""Write a repaired FMU and the functions that it lacks, and check both on the held-out data.

The parameters of an FMU are starts in its description; forces, lags and the like are in a Python file beside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labhil.analysis.patch import (
    MAX_ERROR_RATIO,
    STEP_DIVISORS,
    Attempt,
    Patch,
    temporary_files,
    unified_diff,
    write_patched,
)
from labhil.analysis.patch_check import PatchCheck, companion_force, refusal_of_unknown, rest_velocity
from labhil.analysis.patch_source import PatchSource
from labhil.errors import UsageError
from labhil.rig import RigFile, default_rig, load_rig
from labhil.simulators.companion import Usage, companion_text, sort_effects
from labhil.simulators.fmu import Mechanism, fmu_simulator
from labhil.simulators.fmu_mechanism import MAX_STEP
from labhil.simulators.fmu_patches import (
    DESCRIPTION,
    PatchedDescription,
    patch_fmu,
    read_description,
    with_description,
)
from labhil.simulators.simulator import Simulator

FMU_SUFFIX = ".fmu"


@dataclass(frozen=True)
class FmuBench:
    """An FMU with its rig file.

    Attributes:
        path: The FMU.
        rig: The rig file; None where there is none.
        simulator: The FMU as it was read.
    """

    path: Path
    rig: RigFile | None
    simulator: Simulator

    @classmethod
    def read(cls, path: Path, rig_file: Path | None) -> FmuBench:
        """Read an FMU with the signal names of a rig file, or with its own."""
        rig = None if rig_file is None else load_rig(rig_file)
        return cls(path, rig, _read(path, rig))

    def usage(self, step: float) -> Usage:
        """How a simulation with steps of at most ``step`` s calls the companion."""
        position, velocity = self.simulator.states
        signal = next(iter(self.simulator.inputs))
        return Usage(
            signal,
            f"{signal} += force({position}, {velocity}{{drive}})",
            signal,
            f"{signal} = command({signal}, dt), with command = Command()",
            "measured = sensor(output, dt), with sensor = Sensor()",
            "start_values = PARAMETERS (a tool may leave the starts of the binary itself)",
            step,
        )


def repair_fmu(
    source: PatchSource,
    into: Path,
    out: Path,
    rig_file: Path | None,
    holdout: float,
    progress: Callable[[str], None],
) -> Patch:
    """Write a copy of an FMU with identified starts, and the effects that it lacks as a Python file.

    Args:
        source: The result.
        into: The FMU.
        out: The new FMU.
        rig_file: The rig file of the diagnosis, where it had one.
        holdout: The share that was held out.
        progress: Called with a line of text before each stage.

    Returns:
        The patch that was written.

    Raises:
        UsageError: The files do not belong together, an effect has no law as a function, or the error of the
            FMU with its functions is too large.
    """
    if out.suffix != FMU_SUFFIX:
        raise UsageError(f"{out}: expected a new file that ends in {FMU_SUFFIX}, as {into} does")
    bench = FmuBench.read(into, rig_file)
    progress("scoring the diagnosed model on the held-out data")
    check = PatchCheck.of(source, into, bench.rig or default_rig(bench.simulator.name), holdout)
    text = read_description(into)
    starts = {name: quantity.start for name, quantity in bench.simulator.parameters.items()}
    patched = patch_fmu(text, starts, check.values)
    remaining = sort_effects(patched.remaining)
    if remaining.unknown:
        raise refusal_of_unknown(into, remaining.unknown)
    content, code = with_description(into, text.changed()), out.with_name(f"{out.stem}_effects.py")
    before = check.rmse_of(bench.simulator, {})
    attempts: list[Attempt] = []
    for divisor in (1, *(STEP_DIVISORS if remaining.forces else ())):
        remedy = f"steps of 1/{divisor}" if divisor > 1 else ""
        progress(f"running the repaired FMU on the held-out data{remedy and ', '}{remedy}")
        companion = _companion(bench, check, patched, out, divisor)
        rmse = _run(bench, check, patched, out, content, companion, divisor)
        attempts.append(check.attempt(remedy, rmse))
        if attempts[-1].ratio <= MAX_ERROR_RATIO:
            needed = bool(patched.starts or patched.remaining)
            diff = unified_diff(text, out / DESCRIPTION, by_element=True)
            write_patched(content, companion if needed else "", out, code)
            return Patch(
                out, code if needed else None, tuple(text.changes), tuple(patched.remaining),
                diff, source.promised, check.model.rmse, before, tuple(attempts), check.unit,
                run_by="the FMU",
            )  # fmt: skip
    raise check.refusal(attempts)


def _read(path: Path, rig: RigFile | None) -> Simulator:
    if rig is None or rig.model is None:
        return fmu_simulator(path)
    return fmu_simulator(path, inputs=rig.model.inputs, outputs=rig.model.outputs, name=rig.kind.name)


def _mechanism(simulator: Simulator) -> Mechanism:
    mechanism = simulator.stepped
    assert isinstance(mechanism, Mechanism)
    return mechanism


def _companion(
    bench: FmuBench, check: PatchCheck, patched: PatchedDescription, out: Path, divisor: int
) -> str:
    """The text of the Python file for steps of the roll-out divided by ``divisor``."""
    mechanism = _mechanism(bench.simulator)
    values = [check.values.get(name, quantity.start) for name, quantity in bench.simulator.parameters.items()]
    acceleration, still = mechanism.acceleration_at(values), np.zeros(2)
    without, with_unit_input = acceleration(still, still, np.array([0.0, 1.0]))
    step = min(MAX_STEP, check.dataset.test.period) / divisor
    at_rest = rest_velocity(patched.remaining, step, 1.0 / abs(with_unit_input - without))
    effects = sort_effects(patched.remaining)
    return companion_text(effects, out.name, bench.usage(step), at_rest, parameters=patched.starts)


def _run(
    bench: FmuBench,
    check: PatchCheck,
    patched: PatchedDescription,
    out: Path,
    content: bytes,
    companion: str,
    divisor: int,
) -> float:
    """RMSE of the new FMU, which is loaded under a temporary name from the folder of the new file."""
    with temporary_files(out) as (draft, code):
        draft.write_bytes(content)
        simulator = _read(draft, bench.rig)
        added = _mechanism(simulator).added_force
        added.substeps = divisor
        if sort_effects(patched.remaining).forces:
            added.force = companion_force(companion, code)
        return check.rmse_of(simulator, patched.remaining)
