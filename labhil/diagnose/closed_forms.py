"""A short formula for an estimated curve: the simplest family that lies within the curve's band.

Families are polynomials, a hinge, a step, a bump, the force of a magnet, and a sine; the one with the least
Bayesian information criterion (Schwarz 1978) is taken. Curves come from :mod:`labhil.diagnose.curve`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class CurveFamily:
    """A family of curves: a linear combination of functions of x that may have nonlinear shape parameters.

    Attributes:
        name: name of the family.
        n_shape: number of shape parameters: 0, 1 (a place) or 2 (a place and a width).
        columns: function of x (m,) and of the shape parameters that returns the functions, (m, k).
        text: function of the k coefficients and of the shape parameters that returns the formula.
    """

    name: str
    n_shape: int
    columns: Callable[[FloatArray, FloatArray], FloatArray]
    text: Callable[[FloatArray, FloatArray], str]


def _powers(order: int) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """The function that returns the powers of x up to an order."""
    return lambda x, p: np.column_stack([x**k for k in range(order + 1)])


def _with_constant(x: FloatArray, y: FloatArray) -> FloatArray:
    """A column of ones and ``y``, (m, 2)."""
    return np.column_stack([np.ones(len(x)), y])


def _normalised(x: FloatArray, p: FloatArray) -> FloatArray:
    """x as its distance from the place in widths, (m,)."""
    return np.asarray((x - p[0]) / p[1])


def _polynomial(a: FloatArray, p: FloatArray) -> str:
    """The formula of a polynomial with coefficients ``a``."""
    parts = [f"{c:.3g}" + ("" if k == 0 else "·x" if k == 1 else f"·x^{k}") for k, c in enumerate(a)]
    return " + ".join(parts)


FAMILIES: Sequence[CurveFamily] = (
    CurveFamily("constant", 0, _powers(0), _polynomial),
    CurveFamily("linear", 0, _powers(1), _polynomial),
    CurveFamily("quadratic", 0, _powers(2), _polynomial),
    CurveFamily("cubic", 0, _powers(3), _polynomial),
    CurveFamily(
        "hinge", 1,
        lambda x, p: _with_constant(x, np.maximum(x - p[0], 0.0)),
        lambda a, p: f"{a[0]:.3g} + {a[1]:.3g}·max(x − {p[0]:.3g}, 0)",
    ),
    CurveFamily(
        "step", 2,
        lambda x, p: _with_constant(x, np.tanh(_normalised(x, p))),
        lambda a, p: f"{a[0]:.3g} + {a[1]:.3g}·tanh((x − {p[0]:.3g})/{abs(p[1]):.3g})",
    ),
    CurveFamily(
        "bump", 2,
        lambda x, p: _with_constant(x, np.exp(-0.5 * _normalised(x, p) ** 2)),
        lambda a, p: f"{a[0]:.3g} + {a[1]:.3g}·exp(−½·((x − {p[0]:.3g})/{abs(p[1]):.3g})²)",
    ),
    CurveFamily(
        "magnet", 2,
        lambda x, p: _with_constant(x, _normalised(x, p) * np.exp(0.5 - 0.5 * _normalised(x, p) ** 2)),
        lambda a, p: f"{a[0]:.3g} + {a[1]:.3g}·z·exp(½ − ½·z²), z = (x − {p[0]:.3g})/{abs(p[1]):.3g}",
    ),
    CurveFamily(
        "sine", 2,
        lambda x, p: _with_constant(x, np.sin(_normalised(x, p))),
        lambda a, p: f"{a[0]:.3g} + {a[1]:.3g}·sin((x − {p[0]:.3g})/{abs(p[1]):.3g})",
    ),
)  # fmt: skip
"""All families, simpler ones first."""


def fit_closed_form(
    x: FloatArray,
    value: FloatArray,
    covariance: FloatArray,
    half_width: FloatArray,
    *,
    min_share_within: float = 0.95,
    min_relative_variance: float = 1e-6,
) -> str | None:
    """Fit a formula to an estimated curve.

    Formulas are compared by χ² under the covariance plus log(directions) per fitted number, which is the
    Bayesian information criterion (Schwarz 1978).

    Args:
        x: places (m,).
        value: values of the curve there (m,).
        covariance: covariance of the values (m, m).
        half_width: half of the width of the curve's pointwise band (m,).
        min_share_within: share of the places at which a formula lies within the band, at least.
        min_relative_variance: share of the largest eigenvalue of the covariance below which a direction is
            left out, as numerical error.

    Returns:
        The formula with the least criterion, as "f(x) = …"; None where none lies within the band.
    """
    variances, directions = np.linalg.eigh(covariance)
    strong = variances > min_relative_variance * variances[-1]
    whiten = (directions[:, strong] / np.sqrt(variances[strong])).T
    best, least = None, float("inf")
    for family in FAMILIES:
        coefficients, shape = _fit(family, x, value, whiten)
        error = family.columns(x, shape) @ coefficients - value
        if np.mean(np.abs(error) <= half_width) < min_share_within:
            continue
        criterion = float(np.sum((whiten @ error) ** 2))
        criterion += (len(coefficients) + family.n_shape) * float(np.log(np.sum(strong)))
        if criterion < least:
            best, least = f"f(x) = {family.text(coefficients, shape)}", criterion
    return None if best is None else best.replace("+ -", "− ").replace("-", "−").replace("− −", "+ ")


def _fit(
    family: CurveFamily,
    x: FloatArray,
    value: FloatArray,
    whiten: FloatArray,
    *,
    n_starts: int = 9,
    start_widths: tuple[float, ...] = (0.04, 0.1, 0.25),
) -> tuple[FloatArray, FloatArray]:
    """Coefficients and shape parameters of least χ².

    The search begins at the best point of a grid of ``n_starts`` places by ``start_widths``, shares of the
    range.
    """
    if not family.n_shape:
        return _coefficients(family, x, value, whiten, np.empty(0)), np.empty(0)
    span = float(np.ptp(x))
    places = x[0] + span * (np.arange(n_starts) + 0.5) / n_starts
    widths = span * np.array(start_widths if family.n_shape > 1 else start_widths[:1])
    starts = [np.array([place, width][: family.n_shape]) for place in places for width in widths]

    def residuals(shape: FloatArray) -> FloatArray:
        columns = family.columns(x, shape)
        return np.asarray(whiten @ (columns @ _coefficients(family, x, value, whiten, shape) - value))

    start = min(starts, key=lambda shape: float(np.sum(residuals(shape) ** 2)))
    low = [x[0], 0.01 * span][: family.n_shape]
    high = [x[-1], span][: family.n_shape]
    shape = least_squares(residuals, start, bounds=(low, high), x_scale=0.1 * span).x
    return _coefficients(family, x, value, whiten, shape), shape


def _coefficients(
    family: CurveFamily, x: FloatArray, value: FloatArray, whiten: FloatArray, shape: FloatArray
) -> FloatArray:
    """Coefficients of least χ² at given shape parameters."""
    return np.asarray(np.linalg.lstsq(whiten @ family.columns(x, shape), whiten @ value, rcond=None)[0])
