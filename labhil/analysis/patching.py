"""Write a repaired MuJoCo file from a diagnosis or a fit, and check it by simulation on the held-out data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from labhil.analysis.arm_patching import repair_arm
from labhil.analysis.dataset import Dataset, load_dataset
from labhil.analysis.patch import (
    FIRM_FRICTION,
    MAX_ERROR_RATIO,
    MAX_STATED_RATIO,
    Attempt,
    Patch,
    temporary_files,
    unified_diff,
    write_patched,
)
from labhil.analysis.patch_source import read_patch_source
from labhil.errors import UsageError
from labhil.identify.score import Score, score
from labhil.identify.windows import noise_of
from labhil.physics.model import Model, index_of, start_values
from labhil.python_file import object_of
from labhil.rig import RigFile, default_rig, load_rig
from labhil.rig_sections import ModelSection
from labhil.simulators.companion import SortedEffects, companion_text, sort_effects
from labhil.simulators.mjcf import read_mechanism
from labhil.simulators.mjcf_file import MechanismFile, load_model
from labhil.simulators.patches import PatchedFile, patch_mjcf, shorten_step, stiffen_friction
from labhil.simulators.rolled_out import RolledOutModel
from labhil.simulators.urdf_patches import patch_urdf, shorten_urdf_step, stiffen_model_friction
from labhil.simulators.xml_text import XmlText

STEP_DIVISORS = (2, 4, 8, 16)
"""By which the file's time step is divided, in turn, where it is too long."""

DRY_FRICTION_TERMS = (
    "coulomb_friction",
    "static_friction",
    "position_dependent_friction",
    "load_dependent_friction",
)


def patch(
    result: Path,
    into: Path,
    out: Path,
    rig_file: Path | None = None,
    *,
    holdout: float = 0.3,
    progress: Callable[[str], None] = lambda text: None,
) -> Patch:
    """Write a repaired copy of a MuJoCo file, if its error on held-out data is that of the diagnosed model.

    Args:
        result: JSON of a diagnosis or a fit on that file.
        into: The file.
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
    if load_model(into).njnt > 1:
        return repair_arm(source, into, out, rig_file, holdout, progress)
    if source.horizon is None:
        raise UsageError(f"{result}: expected a simulation of {into}, found inverse dynamics of another file")
    bench = Bench.of(into, rig_file)
    dataset = load_dataset(source.search, bench.rig, source.test or None, holdout)
    values = {**_known_values(bench.rig), **source.values}
    progress("scoring the diagnosed model on the held-out data")
    model = _error(dataset.model, dataset, source.values, source.horizon)
    if model.rmse > MAX_STATED_RATIO * source.promised:
        raise UsageError(
            f"{result}: promises an error of {source.promised:.4g} on held-out data, and its values in "
            f"{into} make one of {model.rmse:.4g}: was it made with another file, --rig or --holdout?"
        )
    before = bench.run(bench.described, dataset, {}, source.horizon)
    attempts: list[Attempt] = []
    for remedy, candidate in _candidates(bench.described, into, values):
        progress(f"running the repaired file on the held-out data{remedy and ', ' + remedy}")
        remaining = sort_effects(candidate.remaining)
        text = companion_text(
            remaining,
            out.name,
            bench.signal,
            bench.rest_velocity(candidate),
            firm=candidate.needs_firm_friction,
        )
        rmse = _run_candidate(bench, candidate, text, out, dataset, source.horizon)
        attempts.append(Attempt(remedy, rmse, rmse / model.rmse))
        if attempts[-1].ratio <= MAX_ERROR_RATIO and not remaining.unknown:
            needed = bool(candidate.remaining) or candidate.needs_firm_friction
            write_patched(candidate.text, text if needed else "", out, code)
            return Patch(
                out, code if needed else None, tuple(candidate.text.changes),
                tuple(candidate.remaining), unified_diff(candidate.text, out), source.promised, model.rmse,
                before,
                tuple(attempts),
                model.channels[0].unit if len(model.channels) == 1 else "noise floors",
            )  # fmt: skip
    raise UsageError(_refusal(into, attempts, model.rmse, remaining))


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
        """Velocity below which a companion's dry friction is viscous, so that one step cannot reverse it."""
        mechanism, remaining = self.described.mechanism, candidate.remaining
        inertia = mechanism.inertia([value.start for value in mechanism.values])
        level = sum(abs(number) for name, number in remaining.items() if name.startswith(DRY_FRICTION_TERMS))
        return max(2.0 * mechanism.timestep / candidate.substeps * level / inertia, 1e-6)

    def run(
        self, described: MechanismFile, dataset: Dataset, values: Mapping[str, float], horizon: float
    ) -> float:
        """RMSE of a file that MuJoCo simulates; ``values`` are effects that are applied in addition."""
        bare = default_rig(described.simulator.name)
        model = RolledOutModel(described.simulator, bare, dataset.test)
        return _error(model, dataset, values, horizon).rmse


def _describe(file: Path, section: ModelSection | None, name: str) -> MechanismFile:
    """Read a file with the signal names of a rig file's section, or with its own."""
    inputs, outputs = (None, None) if section is None else (section.inputs, section.outputs)
    return read_mechanism(file, inputs, outputs, name)


def _known_values(rig: RigFile) -> dict[str, float]:
    """The numbers of ``[known]`` in a rig file."""
    return {name: value for name in rig.kind.known if (value := rig.known_number(name)) is not None}


def _error(model: Model, dataset: Dataset, values: Mapping[str, float], horizon: float) -> Score:
    """Score a model with these values on the held-out data."""
    theta, index = start_values(model.parameters), index_of(model.parameters)
    for name, value in values.items():
        if name in index:
            theta[index[name]] = value
    return score(model, theta, dataset.test, noise_of(dataset.test), horizon)


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


def _run_candidate(
    bench: Bench, candidate: PatchedFile, text: str, out: Path, dataset: Dataset, horizon: float
) -> float:
    """RMSE of a candidate, which is loaded under a temporary name from the folder of the new file."""
    with temporary_files(out) as (draft, code):
        draft.write_bytes(candidate.text.changed())
        described = _describe(draft, bench.section, bench.described.simulator.name)
        if candidate.needs_firm_friction:
            stiffen_model_friction(described.model, described.mechanism.timestep)
        if sort_effects(candidate.remaining).forces:
            code.write_text(text, encoding="utf-8")
            push: Any = object_of(f"{code.name}:force", code.parent)
            described.mechanism.joint_force = push
        return bench.run(described, dataset, candidate.remaining, horizon)


def _refusal(into: Path, attempts: list[Attempt], model: float, remaining: SortedEffects) -> str:
    """The message where no candidate is written; ``model`` is the RMSE of the diagnosed model."""
    if remaining.unknown:
        return (
            f"{into}: no way is known to write {', '.join(remaining.unknown)} of this size into a file (an "
            "armature cannot be negative: correct the inertia of the body); nothing is written"
        )
    tried = "; ".join(f"{a.beside or 'as it is'}: {a.rmse:.4g} ({a.ratio:.2f} times)" for a in attempts)
    return (
        f"{into}: expected the repaired file to make an error of {model:.4g} on held-out data, or up to "
        f"{MAX_ERROR_RATIO:g} times that, found {tried}; nothing is written"
    )


__all__ = ["Attempt", "Patch", "patch"]
