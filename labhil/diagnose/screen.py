"""What absent terms promise beside a fitted model, by projection, without refitting."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from labhil.diagnose.evidence import effective_samples
from labhil.diagnose.judge import NEEDED_BIC, Data
from labhil.diagnose.structures.enumerate import candidates
from labhil.identify.fitted import Fitted
from labhil.identify.projection import Unexplained, orthonormal
from labhil.identify.waves import starts_beside
from labhil.physics.model import index_of, terms_named
from labhil.physics.terms import listed
from labhil.signals import FloatArray

Progress = Callable[[str], None]

COST = 2e-3
"""Share of the residuals that each parameter has to promise."""

ALLOWANCE = 0.5
"""Share of the evidence needed that a projection has to promise where only promising terms are refitted."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A group of terms with the share of the squared residuals that it promises to explain.

    ``promising`` says that this would be strong evidence, with some allowance for what a projection misses.
    """

    group: tuple[str, ...]
    share: float
    promising: bool


def rank(
    data: Data, current: Fitted, executor: Executor, progress: Progress
) -> tuple[list[Candidate], list[Candidate]]:
    """Absent terms, and pairs of them, those that promise most first.

    Pairs count from the start: one effect that hides another (a constant force under dry friction)
    would let a wrong third explain a little of both.
    """
    groups = candidates(data.model, current.terms)
    progress(f"screening {len(groups)} candidates and their pairs beside {', '.join(listed(current.terms))}")
    screen = Screen.of(data, current)
    columns = list(executor.map(screen.columns_of, groups))
    single = [screen.candidate([own], group) for own, group in zip(columns, groups, strict=True)]
    pairs = [
        screen.candidate([columns[i], columns[j]], joined)
        for i, j in combinations(range(len(groups)), 2)
        for joined in [tuple(dict.fromkeys((*groups[i], *groups[j])))]
        if not set(groups[i]) & set(groups[j])
    ]
    return sorted(single, key=lambda c: -c.share), sorted(pairs, key=lambda c: -c.share)


@dataclass(frozen=True, slots=True)
class Screen:
    """What candidates promise beside a fitted model, by projection, without refitting.

    Columns are slopes at neutral for parameters that act there, secants to their starts for the rest;
    what the model's own parameters and the windows' states explain is taken out first.
    """

    data: Data
    unexplained: Unexplained

    @classmethod
    def of(cls, data: Data, current: Fitted) -> Screen:
        """Prepare the projection that all candidates share."""
        return cls(data, Unexplained.of(current))

    def columns_of(self, group: Sequence[str]) -> FloatArray:
        """The group's projected columns (N, k), at those of its starts that explain most."""
        target = self.unexplained.target
        best, most = np.empty((len(target), 0)), -1.0
        for columns in _columns(self.data, self.unexplained, group):
            new = orthonormal(self.unexplained.beside(columns))
            explained = float(np.sum((new.T @ target) ** 2))
            if explained > most:
                best, most = new, explained
        return best

    def candidate(self, columns: Sequence[FloatArray], group: tuple[str, ...]) -> Candidate:
        """What these columns of a group promise."""
        share = self.promise(columns, group)
        added = sum(len(self.data.model.terms[name].parameters) for name in group)
        explained = min(max(share + COST * added, 0.0), 1.0 - 1e-9)
        effective = effective_samples(self.unexplained.fitted)
        gain = effective * np.log(1.0 - explained) + added * np.log(effective)
        return Candidate(group, share, bool(gain < ALLOWANCE * NEEDED_BIC))

    def promise(self, columns: Sequence[FloatArray], group: Sequence[str]) -> float:
        """Share of the squared residuals that these columns explain; more parameters must promise more."""
        target = self.unexplained.target
        new = columns[0] if len(columns) == 1 else orthonormal(np.column_stack(columns))
        total = float(target @ target)
        share = float(np.sum((new.T @ target) ** 2)) / total if total > 0 else 0.0
        return share - COST * sum(len(self.data.model.terms[name].parameters) for name in group)


def _columns(data: Data, unexplained: Unexplained, group: Sequence[str]) -> list[FloatArray]:
    """For each set of starts, what each parameter of the group changes in the residuals, (N, k)."""
    model, current = data.model, unexplained.fitted
    terms = terms_named(model, group)
    places = index_of(model.parameters)
    shapes = {p.key for term in terms for p in term.parameters if p.shape}
    sets = []
    for values in starts_beside(current, group):
        columns = []
        for term in terms:
            for parameter in term.parameters:
                if parameter.shape:
                    continue
                theta = current.theta.copy()
                for name in shapes:
                    theta[places[name]] = values[name]
                theta[places[parameter.key]] = values[parameter.key] or 1e-2 * parameter.scale
                columns.append(unexplained.changed(theta))
        sets.append(np.column_stack(columns))
    return sets
