"""A simulator of one coordinate that can be repaired: its candidates, and how each is loaded and run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from labhil.analysis.patch_check import PatchCheck
from labhil.rig import RigFile
from labhil.simulators.companion import SortedEffects, Usage, companion_text, sort_effects
from labhil.simulators.simulator import Simulator
from labhil.simulators.stepped import JointForce
from labhil.simulators.xml_text import Change


@dataclass(frozen=True)
class Candidate:
    """A repaired file in memory.

    Attributes:
        content: Its bytes.
        changes: Its changes.
        diff: The changes as a unified diff.
        remaining: Values of effects that the file cannot hold.
        usage: How a simulation calls the functions of its companion.
        at_rest: Velocity below which dry friction of the companion is viscous, SI.
        remedy: What was done beside setting values; empty for nothing.
        parameters: Values that a program has to set.
        firm: Whether the user has to make the dry friction of the file firm after loading.
        substeps: Number by which the time step of the simulation is divided.
    """

    content: bytes
    changes: tuple[Change, ...]
    diff: str
    remaining: Mapping[str, float]
    usage: Usage
    at_rest: float
    remedy: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    firm: bool = False
    substeps: int = 1

    @property
    def effects(self) -> SortedEffects:
        """The remaining effects by the place where they act."""
        return sort_effects(self.remaining)

    @property
    def needs_companion(self) -> bool:
        """Whether anything is left that the file does not hold."""
        return bool(self.remaining or self.parameters or self.firm)

    def companion(self, file: str) -> str:
        """Return the text of the companion of a file with this name."""
        return companion_text(
            self.effects, file, self.usage, self.at_rest, firm=self.firm, parameters=self.parameters
        )


class Bench(Protocol):
    """A file with a simulator of one coordinate, with its rig file."""

    @property
    def path(self) -> Path:
        """The file."""
        ...

    @property
    def rig(self) -> RigFile:
        """The rig file, or a default one."""
        ...

    @property
    def original(self) -> Simulator:
        """The simulator as it was read, so that it can be stepped."""
        ...

    @property
    def run_by(self) -> str:
        """What simulates the repaired file, for a sentence."""
        ...

    def check_name(self, out: Path) -> None:
        """Check the name of the new file.

        Raises:
            UsageError: It does not end as that of the old one.
        """
        ...

    def candidates(self, check: PatchCheck, out: Path) -> Iterator[Candidate]:
        """Yield the file with the values, then with remedies beside them.

        Raises:
            UsageError: The values have no place in the file.
        """
        ...

    def load(self, draft: Path, candidate: Candidate, force: JointForce | None) -> Simulator:
        """Load a candidate that was written under a temporary name, with the force of its companion."""
        ...
