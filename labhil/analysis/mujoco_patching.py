"""Candidates for the repaired MuJoCo file of one joint."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from labhil.analysis.patch import FIRM_FRICTION, STEP_DIVISORS, unified_diff
from labhil.analysis.patch_bench import Candidate, StatedNames
from labhil.analysis.patch_check import PatchCheck, rest_velocity
from labhil.rig import RigFile
from labhil.simulators.companion import Usage
from labhil.simulators.mjcf import read_mechanism
from labhil.simulators.mjcf_file import MechanismFile
from labhil.simulators.patches import PatchedFile, patch_mjcf, shorten_step, stiffen_friction
from labhil.simulators.simulator import Simulator
from labhil.simulators.stepped import JointForce
from labhil.simulators.urdf_patches import patch_urdf, shorten_urdf_step, stiffen_model_friction
from labhil.simulators.xml_text import XmlText


@dataclass(frozen=True)
class MujocoBench:
    """A MuJoCo file of one joint with its rig file.

    Attributes:
        path: The file.
        described: The file's mechanism and signals.
        rig: The rig file, or a default one.
        stated: The names that the rig file states.
    """

    path: Path
    described: MechanismFile
    rig: RigFile
    stated: StatedNames
    run_by: str = "MuJoCo"

    @classmethod
    def read(cls, path: Path, rig_file: Path | RigFile | None) -> MujocoBench:
        """Read a file with the signal names of a rig file, or with its own."""
        stated = StatedNames.read(rig_file)
        described = read_mechanism(path, stated.inputs, stated.outputs, stated.name)
        return cls(path, described, stated.rig_of(described.simulator.name), stated)

    @property
    def original(self) -> Simulator:
        """The simulator of the file."""
        return self.described.simulator

    def check_name(self, out: Path) -> None:
        """Accept any name: MuJoCo reads the format from the file."""

    def candidates(self, check: PatchCheck, out: Path) -> Iterator[Candidate]:
        """Yield the file with the values, then with firmer friction and shorter steps."""
        plain = self._put(check)
        yield self._candidate(plain, out, "")
        has_friction = any(change.attribute in ("frictionloss", "friction") for change in plain.text.changes)
        for substeps in (1, *STEP_DIVISORS) if has_friction else STEP_DIVISORS:
            patched = self._put(check)
            if has_friction and self._is_urdf:
                patched = replace(patched, needs_firm_friction=True)
            elif has_friction:
                stiffen_friction(self.described, patched.text, substeps)
            if substeps > 1:
                shorten = shorten_urdf_step if self._is_urdf else shorten_step
                shorten(self.described, patched.text, substeps)
                patched = replace(patched, substeps=substeps)
            remedies = [FIRM_FRICTION] * has_friction + [f"steps of 1/{substeps}"] * (substeps > 1)
            yield self._candidate(patched, out, " and ".join(remedies))

    def load(self, draft: Path, candidate: Candidate, force: JointForce | None) -> Simulator:
        """Load a candidate with the force of its companion."""
        described = read_mechanism(draft, self.stated.inputs, self.stated.outputs, self.original.name)
        if candidate.firm:
            stiffen_model_friction(described.model, described.mechanism.timestep)
        if force is not None:
            described.mechanism.joint_force = force
        return described.simulator

    @cached_property
    def _is_urdf(self) -> bool:
        return XmlText.read(self.path).elements[0].tag == "robot"

    def _put(self, check: PatchCheck) -> PatchedFile:
        put = patch_urdf if self._is_urdf else patch_mjcf
        return put(self.described, XmlText.read(self.path), check.values)

    def _candidate(self, patched: PatchedFile, out: Path, remedy: str) -> Candidate:
        mechanism = self.described.mechanism
        inertia = mechanism.inertia([value.start for value in mechanism.values])
        return Candidate(
            patched.text.changed(),
            tuple(patched.text.changes),
            unified_diff(patched.text, out),
            patched.remaining,
            Usage.in_mujoco(next(iter(self.original.inputs))),
            rest_velocity(patched.remaining, mechanism.timestep / patched.substeps, inertia),
            remedy,
            firm=patched.needs_firm_friction,
            substeps=patched.substeps,
        )
