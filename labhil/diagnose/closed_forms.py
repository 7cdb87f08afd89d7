"""A short formula for an estimated curve, where one lies within its band."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from labhil.signals import FloatArray

WITHIN = 0.95
"""Share of the places at which a formula has to lie within the pointwise band."""

FAINTEST = 1e-6
"""Share of the largest variance below which a direction of the curve's covariance is left out."""

PLACES, WIDTHS = 9, (0.04, 0.1, 0.25)
"""Where shapes are begun along the range, and how wide, as shares of it."""


@dataclass(frozen=True, slots=True)
class Form:
    """A family of curves: a sum of ``columns(x, shape)`` (m, k) with free factors, and a constant.

    ``text`` puts factors and shape into words. ``shaped`` says how many of place and width it has; a form
    that has a width but no place counts periods.
    """

    name: str
    shaped: int
    columns: Callable[[FloatArray, FloatArray], FloatArray]
    text: Callable[[FloatArray, FloatArray], str]


def _powers(order: int) -> Callable[[FloatArray, FloatArray], FloatArray]:
    return lambda x, p: np.column_stack([x**k for k in range(order + 1)])


def _with_constant(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.column_stack([np.ones(len(x)), y])


def _away(x: FloatArray, p: FloatArray) -> FloatArray:
    return np.asarray((x - p[0]) / p[1])


def _polynomial(a: FloatArray, p: FloatArray) -> str:
    parts = [f"{c:.3g}" + ("" if k == 0 else "·x" if k == 1 else f"·x^{k}") for k, c in enumerate(a)]
    return " + ".join(parts)


FORMS: Sequence[Form] = (
    Form("constant", 0, _powers(0), _polynomial),
    Form("linear", 0, _powers(1), _polynomial),
    Form("quadratic", 0, _powers(2), _polynomial),
    Form("cubic", 0, _powers(3), _polynomial),
    Form(
        "hinge", 1,
        lambda x, p: _with_constant(x, np.maximum(x - p[0], 0.0)),
        lambda a, p: f"{a[0]:.3g} + {a[1]:.3g}·max(x − {p[0]:.3g}, 0)",
    ),
    Form(
        "step", 2,
        lambda x, p: _with_constant(x, np.tanh(_away(x, p))),
        lambda a, p: f"{a[0]:.3g} + {a[1]:.3g}·tanh((x − {p[0]:.3g})/{abs(p[1]):.3g})",
    ),
    Form(
        "bump", 2,
        lambda x, p: _with_constant(x, np.exp(-0.5 * _away(x, p) ** 2)),
        lambda a, p: f"{a[0]:.3g} + {a[1]:.3g}·exp(−½·((x − {p[0]:.3g})/{abs(p[1]):.3g})²)",
    ),
    Form(
        "magnet", 2,
        lambda x, p: _with_constant(x, _away(x, p) * np.exp(0.5 - 0.5 * _away(x, p) ** 2)),
        lambda a, p: f"{a[0]:.3g} + {a[1]:.3g}·z·exp(½ − ½·z²), z = (x − {p[0]:.3g})/{abs(p[1]):.3g}",
    ),
    Form(
        "sine", 2,
        lambda x, p: _with_constant(x, np.sin(_away(x, p))),
        lambda a, p: f"{a[0]:.3g} + {a[1]:.3g}·sin((x − {p[0]:.3g})/{abs(p[1]):.3g})",
    ),
)  # fmt: skip
"""The simpler ones first."""


def closed_form(x: FloatArray, value: FloatArray, covariance: FloatArray, reach: FloatArray) -> str | None:
    """The formula that explains a curve best of those within its band; None where none does.

    ``value`` (m,) at places ``x`` (m,) with ``covariance`` (m, m); ``reach`` (m,) is half of the band.
    Formulas are compared by χ² under the covariance and Schwarz's price of their numbers.
    """
    variances, directions = np.linalg.eigh(covariance)
    strong = variances > FAINTEST * variances[-1]
    whiten = (directions[:, strong] / np.sqrt(variances[strong])).T
    best, least = None, float("inf")
    for form in FORMS:
        factors, shape = _fit(form, x, value, whiten)
        off = form.columns(x, shape) @ factors - value
        if np.mean(np.abs(off) <= reach) < WITHIN:
            continue
        price = float(np.sum((whiten @ off) ** 2))
        price += (len(factors) + form.shaped) * float(np.log(np.sum(strong)))
        if price < least:
            best, least = f"f(x) = {form.text(factors, shape)}", price
    return None if best is None else best.replace("+ -", "− ").replace("-", "−").replace("− −", "+ ")


def _fit(form: Form, x: FloatArray, value: FloatArray, whiten: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Factors and shape of least χ²."""
    if not form.shaped:
        return _factors(form, x, value, whiten, np.empty(0)), np.empty(0)
    span = float(np.ptp(x))
    places = x[0] + span * (np.arange(PLACES) + 0.5) / PLACES
    widths = span * np.array(WIDTHS if form.shaped > 1 else WIDTHS[:1])
    begins = [np.array([place, width][: form.shaped]) for place in places for width in widths]

    def off(shape: FloatArray) -> FloatArray:
        columns = form.columns(x, shape)
        return np.asarray(whiten @ (columns @ _factors(form, x, value, whiten, shape) - value))

    begin = min(begins, key=lambda shape: float(np.sum(off(shape) ** 2)))
    low = [x[0], 0.01 * span][: form.shaped]
    high = [x[-1], span][: form.shaped]
    shape = least_squares(off, begin, bounds=(low, high), x_scale=0.1 * span).x
    return _factors(form, x, value, whiten, shape), shape


def _factors(
    form: Form, x: FloatArray, value: FloatArray, whiten: FloatArray, shape: FloatArray
) -> FloatArray:
    return np.asarray(np.linalg.lstsq(whiten @ form.columns(x, shape), whiten @ value, rcond=None)[0])
