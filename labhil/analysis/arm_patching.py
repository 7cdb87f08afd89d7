"""Write a repaired file of an arm, and check it by MuJoCo's inverse dynamics on the held-out data.

Rigs with one joint are in ``patching.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from labhil.analysis.dataset import Dataset
from labhil.analysis.patch import (
    FIRM_FRICTION,
    MAX_ERROR_RATIO,
    MAX_STATED_RATIO,
    Attempt,
    Joint,
    Patch,
    companion_path,
    temporary_files,
    unified_diff,
    write_patched,
)
from labhil.analysis.patch_bench import StatedNames
from labhil.analysis.patch_source import PatchSource
from labhil.errors import UsageError
from labhil.identify.score import Score, score
from labhil.identify.windows import noise_of
from labhil.physics.model import index_of, start_values
from labhil.physics.terms import keyed
from labhil.python_file import module_of
from labhil.rig import RigFile
from labhil.simulators.arm import TORQUE, ArmFileModel, ArmSimulator, arm_simulator
from labhil.simulators.arm_companion import ArmCompanion
from labhil.simulators.arm_patches import ROTOR, PatchedArm, patch_arm
from labhil.simulators.arm_run import ArmFileRun, Companion
from labhil.simulators.xml_text import XmlText

PAYLOAD = "payload"


@dataclass(frozen=True)
class ArmBench:
    """An arm's file with its rig file.

    Attributes:
        path: The file.
        simulator: The arm that it describes.
        rig: The rig file, or a default one.
    """

    path: Path
    simulator: ArmSimulator
    rig: RigFile

    @classmethod
    def read(cls, into: Path, rig_file: Path | RigFile | None) -> ArmBench:
        """Read a file with the signal names of a rig file, or with its own."""
        stated = StatedNames.read(rig_file)
        simulator = arm_simulator(into, None, stated.outputs, stated.name)
        return cls(into, simulator, stated.rig_of(simulator.name))

    def constants(self, model: ArmFileModel, theta: np.ndarray) -> list[float] | None:
        """Return the torque constants, N·m/A; None where torques are measured."""
        if self.simulator.measures == TORQUE:
            return None
        return model.constants_at(theta)


def repair_arm(
    source: PatchSource,
    into: Path,
    out: Path,
    rig_file: Path | RigFile | None,
    holdout: float,
    progress: Callable[[str], None],
) -> Patch:
    """Write a repaired copy of an arm's file, if its error on held-out data is that of the diagnosed model.

    Args:
        source: The result.
        into: The file.
        out: The new file.
        rig_file: The rig file of the diagnosis, or its path, where it had one.
        holdout: The share that was held out.
        progress: Called with a line of text before each stage.

    Raises:
        UsageError: The files do not belong together, or the error of the repaired file is too large.
    """
    bench = ArmBench.read(into, rig_file)
    dataset = source.load_dataset(bench.rig, holdout)
    model = dataset.model
    if not isinstance(model, ArmFileModel):
        raise UsageError("expected a diagnosis of one recording of an arm, found one of several recordings")
    theta = _theta(model, source.values)
    progress("scoring the diagnosed model on the held-out data")
    promised = _score(model, theta, dataset)
    _check_stated_errors(into, source, promised)
    code = companion_path(out)
    before = _run(bench, model, into, _companion_without_effects(bench, model, theta), dataset, into)
    attempts: list[Attempt] = []
    for remedy in ("", FIRM_FRICTION):
        candidate, companion = _candidate(bench, model, theta, source.values, firm=bool(remedy))
        progress(f"running the repaired file on the held-out data{remedy and ', '}{remedy}")
        after = _run(bench, model, out, companion, dataset, into, candidate)
        attempts.append(Attempt(remedy, after.rmse, after.rmse / promised.rmse))
        if attempts[-1].ratio <= MAX_ERROR_RATIO:
            break
    else:
        raise UsageError(_refusal(into, attempts, promised.rmse, companion))
    write_patched(candidate.text.changed(), companion.text(out.name), out, code)
    joints = tuple(
        Joint(name, c.unit, b.rmse, p.rmse, c.rmse)
        for name, b, p, c in zip(
            bench.simulator.joints, before.channels, promised.channels, after.channels, strict=True
        )
    )
    return Patch(
        out, code, tuple(candidate.text.changes), tuple(candidate.remaining),
        unified_diff(candidate.text, out),
        source.promised, promised.rmse, before.rmse, tuple(attempts), "noise floors", joints,
        companion.unsupported,
    )  # fmt: skip


def _check_stated_errors(into: Path, source: PatchSource, promised: Score) -> None:
    """Raise UsageError where the error of the values exceeds the one that the result states."""
    for stated, channel in zip(source.channels, promised.channels, strict=False):
        if channel.rmse > MAX_STATED_RATIO * stated:
            raise UsageError(
                f"the result promises an error of {stated:.4g} {channel.unit} in {channel.channel} of joint "
                f"{channel.joint} on held-out data, and its values in {into} make one of {channel.rmse:.4g}: "
                "was it made with another file, --rig or --holdout?"
            )


def _theta(model: ArmFileModel, values: Mapping[str, float]) -> np.ndarray:
    theta, index = start_values(model.parameters), index_of(model.parameters)
    for key, value in values.items():
        if key in index:
            theta[index[key]] = value
    return theta


def _score(model: ArmFileModel, theta: np.ndarray, dataset: Dataset) -> Score:
    return score(model, theta, dataset.test, noise_of(dataset.test), None)


def _candidate(
    bench: ArmBench, model: ArmFileModel, theta: np.ndarray, values: Mapping[str, float], *, firm: bool
) -> tuple[PatchedArm, ArmCompanion]:
    """Write the values into the file and its companion, in memory."""
    inertial, payload = model.inertial_at(theta)
    base_keys = {key for key in values if key.startswith(("grouped_", "torque_constant["))}
    effects = {key: v for key, v in values.items() if key not in base_keys and not key.startswith(PAYLOAD)}
    text = XmlText.read(bench.path)
    patched = patch_arm(bench.simulator.arm, text, effects, inertial, payload, firm=firm)
    dry = [effects.get(keyed("coulomb_friction.level", j), 0.0) for j in range(model.joints)]
    rotors = {
        key for key, v in patched.remaining.items() if key.startswith(ROTOR) and v > 0.0 and patched.is_urdf
    }
    remaining = {key: v for key, v in patched.remaining.items() if key not in rotors}
    armature = tuple(patched.remaining[k] if k in rotors else 0.0 for k in _joint_keys(ROTOR, model.joints))
    constants = bench.constants(model, theta)
    return patched, ArmCompanion(
        remaining, constants, bench.simulator.joints, dry, patched.needs_firm_friction, armature
    )


def _joint_keys(name: str, joints: int) -> list[str]:
    return [keyed(name, joint) for joint in range(joints)]


def _companion_without_effects(bench: ArmBench, model: ArmFileModel, theta: np.ndarray) -> ArmCompanion:
    """Companion of the unchanged file: torque constants only."""
    return ArmCompanion({}, bench.constants(model, theta), bench.simulator.joints, [0.0] * model.joints)


def _run(
    bench: ArmBench,
    model: ArmFileModel,
    out: Path,
    companion: ArmCompanion,
    dataset: Dataset,
    into: Path,
    candidate: PatchedArm | None = None,
) -> Score:
    """Score a file with its companion, loaded under temporary names from the folder of the new file."""
    with temporary_files(out) as (draft, code):
        content = XmlText.read(into).content if candidate is None else candidate.text.changed()
        draft.write_bytes(content)
        code.write_text(companion.text(out.name), encoding="utf-8")
        outputs = {bench.simulator.output: bench.simulator.measures}
        simulator = arm_simulator(draft, None, outputs, bench.simulator.name)
        functions: Companion = cast("Companion", module_of(code))
        file_run = ArmFileRun(
            simulator, bench.rig, dataset.test, functions, model.cut_off, firm=companion.firm
        )
        return _score(file_run, start_values(file_run.parameters), dataset)


def _refusal(into: Path, attempts: list[Attempt], promised: float, companion: ArmCompanion) -> str:
    attempts_text = "; ".join(
        f"{a.beside or 'as it is'}: {a.rmse:.4g} ({a.ratio:.3f} times)" for a in attempts
    )
    without = (
        f"; run without {', '.join(companion.unsupported)}, which neither holds"
        if companion.unsupported
        else ""
    )
    return (
        f"{into}: expected the repaired file to make an error of {promised:.4g} noise floors on held-out "
        f"data, or up to {MAX_ERROR_RATIO:g} times that, found {attempts_text}{without}; nothing is written"
    )


__all__ = ["repair_arm"]
