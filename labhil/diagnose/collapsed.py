"""Collapsed baselines: a fit that takes a rig's own size to an absurd value to absorb a missing effect.

Where an effect is missing on which the whole motion depends (an offset of the beam's angle), the best fit of
the baseline may be a ball that does not roll: the gain falls to its bound, and no addition improves such a
baseline. ``search_with_sizes.py`` then repeats the search with these sizes bounded near their nominal values.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

from labhil.diagnose.judge import Data
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.identifiability import weak_parameters
from labhil.physics.model import Model

COLLAPSE_FACTOR = 10.0
"""Ratio of a size to its nominal value, either way, from which it has collapsed: an order of magnitude."""

NEAR_FACTOR = COLLAPSE_FACTOR**0.5
"""Ratio within which a size is near nominal: the geometric mean of nominal and collapsed."""

COMPLETE_FIT_NOISE = 1.05
"""RMS of residuals, in units of the noise, below which a baseline fits, so that its sizes are right."""


@dataclass(frozen=True, slots=True)
class Collapsed:
    """A size of the rig that the baseline takes to ``value``, far from its ``nominal`` value (both SI)."""

    key: str
    value: float
    nominal: float
    unit: str

    @property
    def statement(self) -> str:
        """A sentence for people."""
        return (
            f"The baseline by itself takes {self.key} to {self.value:.4g} {self.unit}, far from its nominal "
            f"or typical {self.nominal:.4g} {self.unit}: a size of the rig would make up for what is missing."
        )


def far_from_nominal(
    data: Data,
    baseline: Fitted,
    *,
    collapse_factor: float = COLLAPSE_FACTOR,
    min_noise: float = COMPLETE_FIT_NOISE,
) -> tuple[Collapsed, ...]:
    """List the rig's own positive sizes that a baseline takes to a bound or far from nominal.

    Args:
        data: the data of the search; its start vector holds the nominal values.
        baseline: the fitted baseline.
        collapse_factor: ratio to the nominal value, either way, from which a size is far from it.
        min_noise: RMS of residuals, in units of the noise, below which the fitted sizes are right.

    Returns:
        The sizes; none if the baseline leaves no more than noise.
    """
    problem, collapsed = baseline.problem, list[Collapsed]()
    for j, i in enumerate(problem.free):
        parameter, value, nominal = data.model.parameters[i], float(baseline.theta[i]), float(data.begin[i])
        if not problem.is_positive_constant(j) or baseline.noise < min_noise or not nominal > 0.0:
            continue
        if parameter.at_bound(value) or not nominal / collapse_factor < value < nominal * collapse_factor:
            collapsed.append(Collapsed(parameter.key, value, nominal, parameter.unit))
    return tuple(collapsed)


def find_collapsed(data: Data, baseline: Fitted) -> tuple[Collapsed, ...]:
    """Find the collapsed sizes of a baseline: those far from nominal that the data determine.

    From a motor's speed alone only the ratio of inertia and torque constant is known, so that the value of
    either means nothing.

    Args:
        data: the data of the search.
        baseline: the fitted baseline.

    Returns:
        The collapsed sizes.
    """
    far = far_from_nominal(data, baseline)
    return _identifiable(data, baseline.terms, far) if far else ()


def _identifiable(data: Data, terms: Sequence[str], far: Sequence[Collapsed]) -> tuple[Collapsed, ...]:
    """Those of the sizes ``far`` from nominal that are in no direction which the data leave undetermined."""
    start_fit = fit_terms(
        data.model, data.search, terms, data.window, data.sigma, start=data.begin, new_terms=(),
        iterations=0, thorough=False, held=data.held,
    )  # fmt: skip
    free = [data.model.parameters[i] for i in start_fit.problem.free]
    weak = weak_parameters(free, start_fit.theta[start_fit.problem.free], start_fit.covariances[2], 1.0)
    unknown = {parameter.key for parameter, is_weak in zip(free, weak, strict=True) if is_weak}
    return tuple(size for size in far if size.key not in unknown)


def are_near_nominal(sizes: Sequence[Collapsed], fitted: Fitted, *, factor: float = NEAR_FACTOR) -> bool:
    """Decide whether a fit has collapsed sizes near their nominal values again.

    Args:
        sizes: the sizes that collapsed in the baseline.
        fitted: another fit.
        factor: ratio to the nominal value, either way, within which a size is near it.

    Returns:
        True if all of them are.
    """
    estimates = fitted.estimates
    return all(size.nominal / factor < estimates[size.key] < size.nominal * factor for size in sizes)


def bound_near_nominal(model: Model, sizes: Sequence[Collapsed], *, factor: float = NEAR_FACTOR) -> Model:
    """Bound sizes of a model near their nominal values.

    Args:
        model: the model.
        sizes: the sizes to bound.
        factor: ratio of both bounds to the nominal value.

    Returns:
        A copy of the model with these bounds.
    """
    nominal = {size.key: size.nominal for size in sizes}
    bounded = copy.copy(model)
    parameters = tuple(
        replace(p, lower=max(p.lower, nominal[p.key] / factor), upper=min(p.upper, nominal[p.key] * factor))
        if p.key in nominal
        else p
        for p in model.parameters
    )
    bounded.__dict__["parameters"] = parameters
    return bounded
