"""What absent terms promise beside a fitted model, by projection, without refitting."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from labhil.diagnose.evidence import effective_samples
from labhil.diagnose.judge import NEEDED_BIC, Data
from labhil.identify.fitted import Fitted
from labhil.identify.problem import Linearised, Point, Problem
from labhil.physics.model import Model, index_of, starts_of, terms_named
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
    progress(f"screening {len(groups)} candidates and their pairs beside {', '.join(current.terms)}")
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


def candidates(model: Model, present: Sequence[str]) -> list[tuple[str, ...]]:
    """Every absent term, together with those that it builds on (Stribeck friction on Coulomb friction)."""
    absent = [name for name in model.terms if name not in present]
    return [(*(t for t in model.terms[name].with_terms if t in absent), name) for name in absent]


@dataclass(frozen=True, slots=True)
class Screen:
    """What candidates promise beside a fitted model, by projection, without refitting.

    Columns are slopes at neutral for parameters that act there, secants to their starts for the rest;
    what the model's own parameters and the windows' states explain is taken out first.
    """

    data: Data
    current: Fitted
    lin: Linearised
    basis: FloatArray
    target: FloatArray

    @classmethod
    def of(cls, data: Data, current: Fitted) -> Screen:
        """Prepare the projection that all candidates share."""
        problem = current.problem
        residuals = current.solution.residuals
        lin = problem.linearise(current.solution.point, residuals)
        own = problem.project(lin, np.column_stack([lin.by_parameters, residuals]))
        basis, target = _orthonormal(own[:, :-1]), own[:, -1]
        return cls(data, current, lin, basis, target - basis @ (basis.T @ target))

    def columns_of(self, group: Sequence[str]) -> FloatArray:
        """The group's projected columns (N, k), at those of its starts that explain most."""
        best, most = np.empty((len(self.target), 0)), -1.0
        for columns in _columns(self.data, self.current, group):
            new = self.current.problem.project(self.lin, columns)
            new = _orthonormal(new - self.basis @ (self.basis.T @ new))
            explained = float(np.sum((new.T @ self.target) ** 2))
            if explained > most:
                best, most = new, explained
        return best

    def candidate(self, columns: Sequence[FloatArray], group: tuple[str, ...]) -> Candidate:
        """What these columns of a group promise."""
        share = self.promise(columns, group)
        added = sum(len(self.data.model.terms[name].parameters) for name in group)
        explained = min(max(share + COST * added, 0.0), 1.0 - 1e-9)
        effective = effective_samples(self.current)
        gain = effective * np.log(1.0 - explained) + added * np.log(effective)
        return Candidate(group, share, bool(gain < ALLOWANCE * NEEDED_BIC))

    def promise(self, columns: Sequence[FloatArray], group: Sequence[str]) -> float:
        """Share of the squared residuals that these columns explain; more parameters must promise more."""
        new = columns[0] if len(columns) == 1 else _orthonormal(np.column_stack(columns))
        total = float(self.target @ self.target)
        share = float(np.sum((new.T @ self.target) ** 2)) / total if total > 0 else 0.0
        return share - COST * sum(len(self.data.model.terms[name].parameters) for name in group)


def _columns(data: Data, current: Fitted, group: Sequence[str]) -> list[FloatArray]:
    """For each set of starts, what each parameter of the group changes in the residuals, (N, k)."""
    model, problem = data.model, current.problem
    terms = terms_named(model, group)
    places = index_of(model.parameters)
    before = current.solution.residuals
    sets = []
    for values in starts_of(model, terms, data.search):
        columns = []
        shapes = {p.key for term in terms for p in term.parameters if p.shape}
        for term in terms:
            for parameter in term.parameters:
                if parameter.shape:
                    continue
                theta = current.theta.copy()
                for name in shapes:
                    theta[places[name]] = values[name]
                theta[places[parameter.key]] = values[parameter.key] or 1e-2 * parameter.scale
                columns.append(residuals_at(problem, theta, current.solution.point.states) - before)
        sets.append(np.column_stack(columns))
    return sets


def residuals_at(problem: Problem, theta: FloatArray, states: FloatArray) -> FloatArray:
    """Residuals (N·c,) of a problem's windows at another vector ``theta``, all of it held."""
    nothing = np.empty(0, dtype=np.int64)
    moved = Problem(problem.model, problem.record, problem.windows, nothing, theta, problem.sigma)
    return moved.residuals(Point(np.empty(0), states))


def _orthonormal(columns: FloatArray) -> FloatArray:
    """An orthonormal basis of the span of columns (N, k), those of no length left out."""
    length = np.linalg.norm(columns, axis=0)
    columns = columns[:, length > 1e-9 * max(float(length.max(initial=0.0)), 1e-300)]
    if not columns.shape[1]:
        return columns
    left, singular, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return np.asarray(left[:, singular > 1e-8])
