"""Write a repaired file from a diagnosis or a fit, and check it by simulation on the held-out data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from labhil.analysis.arm_patching import repair_arm
from labhil.analysis.fmu_patching import FMU_SUFFIX, FmuBench
from labhil.analysis.mujoco_patching import MujocoBench
from labhil.analysis.patch import (
    MAX_ERROR_RATIO,
    Attempt,
    Patch,
    companion_path,
    temporary_files,
    write_patched,
)
from labhil.analysis.patch_bench import Bench, Candidate
from labhil.analysis.patch_check import PatchCheck, companion_force, refusal_of_unknown
from labhil.analysis.patch_source import PatchSource, read_patch_source
from labhil.analysis.python_patching import PythonBench, split_name
from labhil.errors import UsageError
from labhil.physics.rigs import keeping_declarations
from labhil.recording.recording import Recording
from labhil.rig import RigFile
from labhil.simulators.companion import BRISTLES
from labhil.simulators.mjcf_file import load_model


def patch(
    result: Path,
    into: Path,
    out: Path,
    rig_file: Path | RigFile | None = None,
    *,
    holdout: float = 0.3,
    recordings: Sequence[Recording] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> Patch:
    """Write a repaired copy of a file, if its error on held-out data is that of the diagnosed model.

    Args:
        result: JSON of a diagnosis or a fit on that file.
        into: The file: MJCF, URDF, an FMU, or Python (``bench.py:pendulum``).
        out: The new file; nothing may be there.
        rig_file: The rig file of the diagnosis, or its path, where it had one.
        holdout: The share that was held out.
        recordings: Those of the result that were read already.
        progress: Called with a line of text before each stage.

    Returns:
        The patch that was written.

    Raises:
        UsageError: The new file exists already, the files do not belong together, or the error of the
            repaired file is too large.
    """
    for path in (out, companion_path(out)):
        if path.exists():
            raise UsageError(f"{path}: expected a new file, found one there; nothing is overwritten")
    source = read_patch_source(result, recordings)
    with keeping_declarations():
        if into.suffix == FMU_SUFFIX:
            return _repair(FmuBench.read(into, rig_file), source, out, holdout, progress)
        if (named := split_name(into)) is not None:
            return _repair(PythonBench.read(*named, rig_file), source, out, holdout, progress)
        if load_model(into).njnt > 1:
            return repair_arm(source, into, out, rig_file, holdout, progress)
        return _repair(MujocoBench.read(into, rig_file), source, out, holdout, progress)


def _repair(
    bench: Bench, source: PatchSource, out: Path, holdout: float, progress: Callable[[str], None]
) -> Patch:
    """Try the candidates of a file in turn, and write the first that keeps the promise."""
    bench.check_name(out)
    progress("scoring the diagnosed model on the held-out data")
    check = PatchCheck.of(source, bench.path, bench.rig, holdout)
    before = check.rmse_of(bench.original, {})
    attempts: list[Attempt] = []
    for left_out, candidate in _simplest_first(bench, check, out):
        remedy = " and ".join(part for part in (left_out, candidate.remedy) if part)
        progress(f"running the repaired file on the held-out data{remedy and ', '}{remedy}")
        if candidate.effects.unknown:
            raise refusal_of_unknown(bench.path, candidate.effects.unknown)
        attempts.append(check.attempt(remedy, _run(bench, candidate, out, check)))
        if attempts[-1].ratio <= MAX_ERROR_RATIO:
            code = companion_path(out) if candidate.needs_companion else None
            write_patched(candidate.content, candidate.companion(out.name), out, code)
            return Patch(
                out, code, candidate.changes, tuple(candidate.remaining), candidate.diff, source.promised,
                check.model.rmse, before, tuple(attempts), check.unit, run_by=bench.run_by,
            )  # fmt: skip
    raise check.refusal(attempts)


def _simplest_first(bench: Bench, check: PatchCheck, out: Path) -> Iterator[tuple[str, Candidate]]:
    """Yield the candidates, those without bristles first, each with what was left out.

    Bristles need a state beside the file and short steps; dry friction alone may keep the promise.
    """
    plain = {name: value for name, value in check.values.items() if not name.startswith(f"{BRISTLES}.")}
    if len(plain) < len(check.values):
        for candidate in bench.candidates(replace(check, values=plain), out):
            yield f"{BRISTLES} left out", candidate
    for candidate in bench.candidates(check, out):
        yield "", candidate


def _run(bench: Bench, candidate: Candidate, out: Path, check: PatchCheck) -> float:
    """RMSE of a candidate, which is loaded under a temporary name from the folder of the new file."""
    with temporary_files(out) as (draft, code):
        draft.write_bytes(candidate.content)
        force = None
        if candidate.effects.has_force:
            text = candidate.companion(out.name)
            force = companion_force(text, code, candidate.effects, check.dataset.test)
        return check.rmse_of(bench.load(draft, candidate, force), candidate.remaining)


__all__ = ["Attempt", "Patch", "patch"]
