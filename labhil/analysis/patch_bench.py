"""A simulator of one coordinate that can be repaired: its candidates, and how each is loaded and run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, Protocol

from labhil.analysis.patch import STEP_DIVISORS
from labhil.analysis.patch_check import PatchCheck
from labhil.errors import UsageError
from labhil.rig import RigFile, default_rig, load_rig
from labhil.simulators.companion import SortedEffects, Usage, companion_text, sort_effects
from labhil.simulators.simulator import Simulator
from labhil.simulators.stepped import MAX_STEP, JointForce
from labhil.simulators.xml_text import Change


class StatedNames(NamedTuple):
    """What a rig file states of a simulator's signals; None, and an empty name, where there is no rig file.

    Attributes:
        rig: The rig file.
        inputs: Names in the simulator's file by recorded input.
        outputs: Names in the simulator's file by recorded output.
        name: The rig kind.
    """

    rig: RigFile | None
    inputs: Mapping[str, str] | None
    outputs: Mapping[str, str] | None
    name: str

    @classmethod
    def read(cls, rig_file: Path | RigFile | None) -> StatedNames:
        """Read a rig file, where there is one."""
        if rig_file is None:
            return cls(None, None, None, "")
        rig = rig_file if isinstance(rig_file, RigFile) else load_rig(rig_file)
        if rig.model is None:
            return cls(rig, None, None, rig.kind.name)
        return cls(rig, rig.model.inputs, rig.model.outputs, rig.kind.name)

    def rig_of(self, name: str) -> RigFile:
        """Return the rig file, or a default one for the simulator of this name."""
        return self.rig or default_rig(name)


class FinerSteps(NamedTuple):
    """Steps of a simulation under a force: their length in s, and by what it is divided."""

    length: float
    divisor: int

    @property
    def remedy(self) -> str:
        """What was done, for a message; empty for nothing."""
        return f"steps of 1/{self.divisor}" if self.divisor > 1 else ""


def finer_steps(remaining: Mapping[str, float], period: float) -> Iterator[FinerSteps]:
    """Yield the steps in which a simulator is tried whose user steps it: finer ones only where forces act.

    Args:
        remaining: Values of the effects of its companion.
        period: Sampling period of the data, s.
    """
    for divisor in (1, *(STEP_DIVISORS if sort_effects(remaining).has_force else ())):
        yield FinerSteps(min(MAX_STEP, period) / divisor, divisor)


def check_suffix(out: Path, path: Path) -> None:
    """Check that a new file ends as the old one does.

    Raises:
        UsageError: It does not.
    """
    if out.suffix != path.suffix:
        raise UsageError(f"{out}: expected a new file that ends in {path.suffix}, as {path} does")


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
        own_solver: Whether it is run by its own solver; otherwise its accelerations are integrated.
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
    own_solver: bool = True

    @cached_property
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
