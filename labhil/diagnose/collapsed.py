"""A baseline that fits only because a size of the rig gave way: a beam along which nothing pulls.

Where an effect is missing that the whole motion needs (an offset of the beam's angle), least squares may
rather have the ball roll nowhere: the gain falls to its bound, and beside such a baseline no addition looks
needed. So the search is made once more with these sizes kept near what is known of them.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

from labhil.diagnose.judge import Data
from labhil.identify.fitted import Fitted, covariances, fit_terms
from labhil.identify.identifiability import weak_parameters
from labhil.physics.model import Model

FAR = 10.0
"""Factor from its nominal value beyond which a size has given way: an order of magnitude."""

NEAR = FAR**0.5
"""Factor within which it is kept: there a value is closer to the nominal one than to one that gave way."""

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
            f"The baseline by itself takes {self.key} to {self.value:.4g} {self.unit}, far from its nominal "
            f"or typical {self.nominal:.4g} {self.unit}: a size of the rig would make up for what is missing."
        )


def far_from_nominal(data: Data, baseline: Fitted) -> tuple[Collapsed, ...]:
    """The rig's own sizes, never zero, that a baseline with more than noise left has far from nominal."""
    problem, collapsed = baseline.problem, list[Collapsed]()
    for j, i in enumerate(problem.free):
        parameter, value, nominal = data.model.parameters[i], float(baseline.theta[i]), float(data.begin[i])
        if not problem.is_positive_constant(j) or baseline.noise < NOISE or not nominal > 0.0:
            continue
        if parameter.at_bound(value) or not nominal / FAR < value < nominal * FAR:
            collapsed.append(Collapsed(parameter.key, value, nominal, parameter.unit))
    return tuple(collapsed)


def find_collapsed(data: Data, baseline: Fitted) -> tuple[Collapsed, ...]:
    """The sizes far from nominal that these data can determine at all.

    From a motor's speed alone inertia and torque constant are known as a ratio, and either may be anywhere.
    """
    far = far_from_nominal(data, baseline)
    return _knowable(data, baseline.terms, far) if far else ()


def _knowable(data: Data, terms: Sequence[str], lost: Sequence[Collapsed]) -> tuple[Collapsed, ...]:
    """The ``lost`` sizes that take part in no direction which these data leave undetermined."""
    start_fit = fit_terms(
        data.model, data.search, terms, data.window, data.sigma, start=data.begin, new_terms=(),
        iterations=0, thorough=False, held=data.held,
    )  # fmt: skip
    free = [data.model.parameters[i] for i in start_fit.problem.free]
    weak = weak_parameters(free, start_fit.theta[start_fit.problem.free], covariances(start_fit)[2], 1.0)
    unknown = {parameter.key for parameter, is_weak in zip(free, weak, strict=True) if is_weak}
    return tuple(size for size in lost if size.key not in unknown)


def are_restored(lost: Sequence[Collapsed], fitted: Fitted) -> bool:
    """Whether a fit has these sizes closer to their nominal values than to ones that gave way."""
    estimates = fitted.estimates
    return all(size.nominal / NEAR < estimates[size.key] < size.nominal * NEAR for size in lost)


def bound_near_nominal(model: Model, sizes: Sequence[Collapsed]) -> Model:
    """The same model with bounds near the nominal values of these sizes."""
    nominal = {size.key: size.nominal for size in sizes}
    bounded = copy.copy(model)
    parameters = tuple(
        replace(p, lower=max(p.lower, nominal[p.key] / NEAR), upper=min(p.upper, nominal[p.key] * NEAR))
        if p.key in nominal
        else p
        for p in model.parameters
    )
    bounded.__dict__["parameters"] = parameters
    return bounded
