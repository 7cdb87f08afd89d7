"""Write a repaired file from a diagnosis or a fit, and check it by simulation on the held-out data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from labhil.analysis.arm_patching import repair_arm
from labhil.analysis.fmu_patching import FMU_SUFFIX, repair_fmu
from labhil.analysis.patch import (
    FIRM_FRICTION,
    MAX_ERROR_RATIO,
    STEP_DIVISORS,
    Attempt,
    Patch,
    temporary_files,
    unified_diff,
    write_patched,
)
from labhil.analysis.patch_check import PatchCheck, companion_force, refusal_of_unknown, rest_velocity
from labhil.analysis.patch_source import read_patch_source
from labhil.errors import UsageError
from labhil.rig import RigFile, default_rig, load_rig
from labhil.rig_sections import ModelSection
from labhil.simulators.companion import Usage, companion_text, sort_effects
from labhil.simulators.mjcf import read_mechanism
from labhil.simulators.mjcf_file import MechanismFile, load_model
from labhil.simulators.patches import PatchedFile, patch_mjcf, shorten_step, stiffen_friction
from labhil.simulators.urdf_patches import patch_urdf, shorten_urdf_step, stiffen_model_friction
from labhil.simulators.xml_text import XmlText


def patch(
    result: Path,
    into: Path,
    out: Path,
    rig_file: Path | None = None,
    *,
    holdout: float = 0.3,
    progress: Callable[[str], None] = lambda text: None,
) -> Patch:
    """Write a repaired copy of a file, if its error on held-out data is that of the diagnosed model.

    Args:
        result: JSON of a diagnosis or a fit on that file.
        into: The file: MJCF, URDF or an FMU.
        out: The new file; nothing may be there.
        rig_file: The rig file of the diagnosis, where it had one.
        holdout: The share that was held out.
        progress: Called with a line of text before each stage.

    Returns:
        The patch that was written.

    Raises:
        UsageError: The new file exists already, the files do not belong together, or the error of the
            repaired file is too large.
    """
    code = out.with_name(f"{out.stem}_effects.py")
    for path in (out, code):
        if path.exists():
            raise UsageError(f"{path}: expected a new file, found one there; nothing is overwritten")
    source = read_patch_source(result)
    if into.suffix == FMU_SUFFIX:
        return repair_fmu(source, into, out, rig_file, holdout, progress)
    if load_model(into).njnt > 1:
        return repair_arm(source, into, out, rig_file, holdout, progress)
    bench = Bench.of(into, rig_file)
    progress("scoring the diagnosed model on the held-out data")
    check = PatchCheck.of(source, into, bench.rig, holdout)
    before = check.rmse_of(bench.described.simulator, {})
    attempts: list[Attempt] = []
    for remedy, candidate in _candidates(bench.described, into, check.values):
        progress(f"running the repaired file on the held-out data{remedy and ', ' + remedy}")
        remaining = sort_effects(candidate.remaining)
        if remaining.unknown:
            raise refusal_of_unknown(into, remaining.unknown)
        text = companion_text(
            remaining,
            out.name,
            Usage.in_mujoco(bench.signal),
            bench.rest_velocity(candidate),
            firm=candidate.needs_firm_friction,
        )
        attempts.append(check.attempt(remedy, _run_candidate(bench, candidate, text, out, check)))
        if attempts[-1].ratio <= MAX_ERROR_RATIO:
            needed = bool(candidate.remaining) or candidate.needs_firm_friction
            write_patched(candidate.text.changed(), text if needed else "", out, code)
            return Patch(
                out, code if needed else None, tuple(candidate.text.changes), tuple(candidate.remaining),
                unified_diff(candidate.text, out), source.promised, check.model.rmse, before, tuple(attempts),
                check.unit,
            )  # fmt: skip
    raise check.refusal(attempts)


@dataclass(frozen=True)
class Bench:
    """A MuJoCo file as it was read, with its rig file.

    Attributes:
        described: The file's mechanism and signals.
        rig: The rig file, or a default one.
        section: Its ``[model]``; None without a rig file.
    """

    described: MechanismFile
    rig: RigFile
    section: ModelSection | None

    @classmethod
    def of(cls, into: Path, rig_file: Path | None) -> Bench:
        """Read a file with the signal names of a rig file, or with its own."""
        rig = None if rig_file is None else load_rig(rig_file)
        section = None if rig is None else rig.model
        described = _describe(into, section, "" if rig is None else rig.kind.name)
        return cls(described, rig or default_rig(described.simulator.name), section)

    @property
    def signal(self) -> str:
        """Name of the recorded input."""
        return next(iter(self.described.simulator.inputs))

    def rest_velocity(self, candidate: PatchedFile) -> float:
        """Velocity below which a companion's dry friction is viscous."""
        mechanism = self.described.mechanism
        inertia = mechanism.inertia([value.start for value in mechanism.values])
        return rest_velocity(candidate.remaining, mechanism.timestep / candidate.substeps, inertia)


def _describe(file: Path, section: ModelSection | None, name: str) -> MechanismFile:
    """Read a file with the signal names of a rig file's section, or with its own."""
    inputs, outputs = (None, None) if section is None else (section.inputs, section.outputs)
    return read_mechanism(file, inputs, outputs, name)


def _candidates(
    described: MechanismFile, into: Path, values: Mapping[str, float]
) -> Iterator[tuple[str, PatchedFile]]:
    """Yield the file with the values, then with firmer friction and shorter steps; the remedy comes first."""
    urdf = XmlText.read(into).elements[0].tag == "robot"
    put, shorten = (patch_urdf, shorten_urdf_step) if urdf else (patch_mjcf, shorten_step)
    plain = put(described, XmlText.read(into), values)
    yield "", plain
    has_friction = any(change.attribute in ("frictionloss", "friction") for change in plain.text.changes)
    for substeps in (1, *STEP_DIVISORS) if has_friction else STEP_DIVISORS:
        candidate = put(described, XmlText.read(into), values)
        if has_friction and urdf:
            candidate = replace(candidate, needs_firm_friction=True)
        elif has_friction:
            stiffen_friction(described, candidate.text, substeps)
        if substeps > 1:
            shorten(described, candidate.text, substeps)
            candidate = replace(candidate, substeps=substeps)
        remedies = [FIRM_FRICTION] * has_friction + [f"steps of 1/{substeps}"] * (substeps > 1)
        yield " and ".join(remedies), candidate


def _run_candidate(bench: Bench, candidate: PatchedFile, text: str, out: Path, check: PatchCheck) -> float:
    """RMSE of a candidate, which is loaded under a temporary name from the folder of the new file."""
    with temporary_files(out) as (draft, code):
        draft.write_bytes(candidate.text.changed())
        described = _describe(draft, bench.section, bench.described.simulator.name)
        if candidate.needs_firm_friction:
            stiffen_model_friction(described.model, described.mechanism.timestep)
        if sort_effects(candidate.remaining).forces:
            described.mechanism.joint_force = companion_force(text, code)
        return check.rmse_of(described.simulator, candidate.remaining)


__all__ = ["Attempt", "Patch", "patch"]
