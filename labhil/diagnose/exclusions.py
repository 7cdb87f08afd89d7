"""Exclusion limits: the largest size of an absent term that the data could hide.

The responses of absent terms are in ``discrepancy.py``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from labhil.diagnose.answer import Excluded, Undecided
from labhil.diagnose.collapsed import COMPLETE_FIT_NOISE
from labhil.diagnose.discrepancy import AbsentEffect, AbsentEffects
from labhil.identify.fitted import Fitted


def exclusions(
    absent: AbsentEffects, possible: Collection[str]
) -> tuple[tuple[Excluded, ...], tuple[Undecided, ...]]:
    """Compute the largest size of every absent term that the data could hide (99 %).

    Args:
        absent: the terms that the final model lacks.
        possible: keys of terms that may be present, which get no entry.

    Returns:
        The limits, and the terms that the data could hide at any size.
    """
    at_bound, variation = _sizes_at_bound(absent.fitted), Variation.of(absent.fitted)
    reason = (
        f"nothing can be excluded beside a model whose {at_bound[0]} is at its bound"
        if at_bound
        else "these data would not show it, however large: what the model has already makes up for it"
    )
    limits, unseen = list[Excluded](), dict[tuple[str, int | None], Undecided]()
    for effect, largest in _largest_hidden(absent):
        term, parameter = effect.term, effect.parameter
        if term.key in possible:
            continue
        if at_bound or _is_beyond_linear(effect, largest, variation):
            unseen[term.name, term.joint] = Undecided(term.name, term.joint, (), reason)
        else:
            limits.append(Excluded(term.name, term.joint, largest, parameter.unit, 0.99, parameter.recording))
    return tuple(limits), tuple(unseen.values())


def _largest_hidden(absent: AbsentEffects) -> Iterator[tuple[AbsentEffect, float]]:
    """Largest size of every absent term: magnitude of its linearised estimate plus its 99 % error, SI units.

    Residuals are correlated within a window, so that the error is the larger of that from noise and that
    from differences between windows (cluster-robust errors: Liang and Zeger, Biometrika 73, 1986).
    """
    problem, residuals, slopes = absent.fitted.problem, absent.fitted.solution.residuals, absent.slopes
    basis, _ = np.linalg.qr(slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300))
    for effect in absent.effects:
        column = effect.response - basis @ (basis.T @ effect.response)
        power = float(column @ column)
        if power <= 1e-12:  # a small size has no effect below a threshold
            continue
        value = -float(column @ residuals) / power
        contributions = column * (residuals + value * column)
        noise = absent.fitted.noise / np.sqrt(power)
        error = max(noise, float(np.linalg.norm(problem.per_window(contributions))) / power)
        yield effect, float((abs(value) + stats.norm.ppf(0.995) * error) * effect.parameter.scale)


@dataclass(frozen=True, slots=True)
class Variation:
    """How much the outputs vary.

    Attributes:
        norm: norm about their mean, in units of the noise.
        ranges: the largest range by unit; 1 for a share of something, which has no unit.
    """

    norm: float
    ranges: Mapping[str, float]

    @classmethod
    def of(cls, fitted: Fitted) -> Variation:
        """The variation of the outputs that a model was fitted to."""
        problem = fitted.problem
        outputs, units = problem.record.outputs[problem.windows.rows], problem.record.output_units
        scaled = (outputs - outputs.mean(axis=0)) / problem.sigma
        ranges = sorted(zip(np.ptp(outputs, axis=0).tolist(), units, strict=True))
        return cls(float(np.linalg.norm(scaled)), {"1": 1.0} | {unit: largest for largest, unit in ranges})


def _is_beyond_linear(effect: AbsentEffect, size: float, variation: Variation) -> bool:
    """Whether a size is above its bound or the range of an output, or its response above all variation.

    Responses are no longer linear there, so that a limit would exclude nothing.
    """
    parameter = effect.parameter
    if size > max(abs(parameter.lower), abs(parameter.upper)):
        return True
    if size > variation.ranges.get(parameter.unit, np.inf):
        return True
    return bool(np.linalg.norm(effect.response) * size / parameter.scale > variation.norm)


def _sizes_at_bound(fitted: Fitted, min_noise: float = COMPLETE_FIT_NOISE) -> list[str]:
    """Keys of the rig's own sizes at a bound, of a fit that leaves more than noise.

    Responses mean nothing beside them: an input without effect may have any dead zone. In a fit to the noise
    a size at its bound is one that the data do not show, such as the inductance of a motor.
    """
    problem = fitted.problem
    if fitted.noise < min_noise:
        return []
    parameters = [problem.model.parameters[i] for i in problem.free]
    sizes = [p for p in parameters if p.term is None and p.is_positive]
    return [size.key for size in sizes if size.at_bound(fitted.estimates[size.key])]
