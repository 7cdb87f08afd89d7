"""What absent terms promise beside a fitted model, by projection, without refitting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labhil.diagnose.judge import Data
from labhil.identify.fitted import Fitted
from labhil.identify.projection import ProjectedResiduals, orthonormal
from labhil.identify.waves import starts_for_added_terms
from labhil.physics.model import index_of, terms_named
from labhil.signals import FloatArray

COST = 2e-3
"""Share of the residuals that each parameter has to promise."""


@dataclass(frozen=True, slots=True)
class Screen:
    """What candidates promise beside a fitted model, by projection, without refitting.

    Columns are slopes at neutral for parameters that act there, secants to their starts for the rest;
    what the model's own parameters and the windows' states explain is taken out first.
    """

    data: Data
    unexplained: ProjectedResiduals

    @classmethod
    def of(cls, data: Data, current: Fitted) -> Screen:
        """Prepare the projection that all candidates share."""
        return cls(data, ProjectedResiduals.of(current))

    def columns_of(self, group: Sequence[str]) -> FloatArray:
        """The group's projected columns (N, k), at those of its starts that explain most."""
        target = self.unexplained.target
        best, most = np.empty((len(target), 0)), -1.0
        for columns in _columns(self.data, self.unexplained, group):
            new = orthonormal(self.unexplained.project_out_all(columns))
            explained = float(np.sum((new.T @ target) ** 2))
            if explained > most:
                best, most = new, explained
        return best

    def promise(self, columns: Sequence[FloatArray], group: Sequence[str]) -> float:
        """Share of the squared residuals that these columns explain; more parameters must promise more."""
        target = self.unexplained.target
        new = columns[0] if len(columns) == 1 else orthonormal(np.column_stack(columns))
        total = float(target @ target)
        share = float(np.sum((new.T @ target) ** 2)) / total if total > 0 else 0.0
        return share - COST * sum(len(self.data.model.terms[name].parameters) for name in group)


def _columns(data: Data, unexplained: ProjectedResiduals, group: Sequence[str]) -> list[FloatArray]:
    """For each set of starts, what each parameter of the group changes in the residuals, (N, k)."""
    model, current = data.model, unexplained.fitted
    terms = terms_named(model, group)
    places = index_of(model.parameters)
    shapes = {p.key for term in terms for p in term.parameters if p.shape}
    sets = []
    for values in starts_for_added_terms(current, group):
        columns = []
        for term in terms:
            for parameter in term.parameters:
                if parameter.shape:
                    continue
                theta = current.theta.copy()
                for name in shapes:
                    theta[places[name]] = values[name]
                theta[places[parameter.key]] = values[parameter.key] or 1e-2 * parameter.scale
                columns.append(unexplained.residual_change(theta))
        sets.append(np.column_stack(columns))
    return sets
