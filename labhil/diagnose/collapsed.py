"""A baseline that fits only because a size of the rig gave way: a beam along which nothing pulls.

Where an effect is missing that the whole motion needs (an offset of the beam's angle), least squares may
rather have the ball roll nowhere: the gain falls to its bound, and beside such a baseline no addition looks
needed. So the search is made once more with these sizes kept near what is known of them.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

from labhil.diagnose.evidence import bic, effective_samples
from labhil.diagnose.judge import NEEDED_BIC, Data
from labhil.identify.fitted import Fitted
from labhil.physics.model import Model

FAR = 10.0
"""Factor from its nominal value beyond which a size has given way: an order of magnitude."""

NEAR = 3.0
"""Factor within which it is kept: what formulas, data sheets and guesses are off by, half of that order."""

NOISE = 1.05
"""A baseline that leaves no more than this many times the noise says what the sizes are, not what we knew."""


@dataclass(frozen=True, slots=True)
class Collapsed:
    """A size that the baseline alone takes to ``value`` (SI) where its ``nominal`` value is another one."""

    key: str
    value: float
    nominal: float
    unit: str

    @property
    def statement(self) -> str:
        """For people."""
        return (
            f"The baseline by itself takes {self.key} to {self.value:.4g} {self.unit}, against a nominal "
            f"{self.nominal:.4g} {self.unit}: what is missing there would be made up by a size of the rig."
        )


def given_way(data: Data, baseline: Fitted) -> tuple[Collapsed, ...]:
    """The rig's own sizes, none of which can be zero, that a baseline which leaves more than noise lost."""
    problem, found = baseline.problem, list[Collapsed]()
    for j, i in enumerate(problem.free):
        parameter, value, nominal = data.model.parameters[i], float(baseline.theta[i]), float(data.begin[i])
        if not problem.is_size(j) or baseline.noise < NOISE or not nominal > 0.0:
            continue
        if parameter.at_bound(value) or not nominal / FAR < value < nominal * FAR:
            found.append(Collapsed(parameter.key, value, nominal, parameter.unit))
    return tuple(found)


def kept_near(model: Model, sizes: Sequence[Collapsed]) -> Model:
    """The same model with these sizes bounded to what is credible of them."""
    nominal = {size.key: size.nominal for size in sizes}
    other = copy.copy(model)
    parameters = tuple(
        replace(p, lower=max(p.lower, nominal[p.key] / NEAR), upper=min(p.upper, nominal[p.key] * NEAR))
        if p.key in nominal
        else p
        for p in model.parameters
    )
    other.__dict__["parameters"] = parameters
    return other


def needed(data: Data, baseline: Fitted, kept: Fitted) -> bool:
    """Whether the searched data speak very strongly for the sizes that gave way.

    Else they hardly know them: another value does as well, and nothing collapsed.
    """
    effective = min(effective_samples(baseline), effective_samples(kept))
    return bic(baseline, effective) - bic(kept, effective) < NEEDED_BIC
