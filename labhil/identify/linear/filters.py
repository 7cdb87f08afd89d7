"""Polynomials in the delay operator q⁻¹, and least squares with the linear part projected out.

Shared by the baselines of this folder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, signal

from labhil.compiled import compiled
from labhil.identify.linear.data import ComplexArray
from labhil.signals import FloatArray

MAX_REFLECTION = 1 - 1e-9
"""Largest modulus of reflection coefficients and roots: within the unit circle, up to rounding."""

DIFFERENCE_STEP = 1e-6
"""Relative step of finite differences."""

MIN_COLUMN_NORM = 1e-13
"""Norm of a unit column, orthogonal to earlier ones, below which it depends on them (rounding)."""

Residual = Callable[[FloatArray], FloatArray]


def stable_polynomial(theta: FloatArray) -> FloatArray:
    """The polynomial 1 + f₁q⁻¹ + … whose reflection coefficients are tanh ``theta``.

    Its roots lie within the unit circle for any ``theta``, and each such polynomial has a ``theta`` (step-up
    recursion of Levinson and Durbin), so that a search for stable models needs no constraint.
    """
    f = np.ones(1)
    for k in np.tanh(theta):
        f = np.append(f, 0.0) + k * np.append(0.0, f[::-1])
    return f


def unconstrained_parameters(f: FloatArray) -> FloatArray:
    """Inverse of :func:`stable_polynomial`; roots outside of the unit circle are reflected into it first."""
    f = stabilise(f)
    theta = np.empty(len(f) - 1)
    for i in range(len(theta) - 1, -1, -1):
        k = float(np.clip(f[-1], -MAX_REFLECTION, MAX_REFLECTION))
        theta[i] = np.arctanh(k)
        f = (f[:-1] - k * f[:0:-1]) / (1 - k * k)
    return theta


def stabilise(f: FloatArray) -> FloatArray:
    """The polynomial with its roots outside of the unit circle reflected into it."""
    roots = np.roots(f)
    if not len(roots) or np.abs(roots).max() < MAX_REFLECTION:
        return np.asarray(f / f[0])
    outside = np.abs(roots) >= MAX_REFLECTION
    roots = roots.astype(np.complex128)
    roots[outside] /= np.abs(roots[outside]) ** 2
    roots *= np.minimum(1.0, MAX_REFLECTION / np.maximum(np.abs(roots), MAX_REFLECTION))
    return np.asarray(np.poly(roots).real)


def delayed(values: FloatArray, samples: int) -> FloatArray:
    """Delay values (n,) by a number of samples, with zeros before."""
    out = np.zeros_like(values)
    out[samples:] = values[: len(values) - samples]
    return out


def free_responses(f: FloatArray, n: int) -> FloatArray:
    """Basis (n, order) of the free responses of 1/f to initial states."""
    order = len(f) - 1
    if order == 0:
        return np.empty((n, 0))
    kicks = np.zeros((n, order))
    kicks[np.arange(min(order, n)), np.arange(min(order, n))] = 1.0
    return np.asarray(signal.lfilter([1.0], f, kicks, axis=0))


def input_columns(f: FloatArray, u: FloatArray, inputs: int, delay: int) -> FloatArray:
    """Responses of 1/f to the input, delayed by ``delay`` … ``delay + inputs − 1`` samples, (n, inputs)."""
    filtered = signal.lfilter([1.0], f, u)
    return np.column_stack([delayed(filtered, delay + j) for j in range(inputs)])


def regress(columns: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Linear least squares of ``y`` (n,) on columns (n, p).

    Returns:
        Coefficients (p,), zero of a column that depends on earlier ones, and residuals (n,).
    """
    rows = np.array(columns.T, dtype=np.float64, order="C")
    size = np.sqrt(np.einsum("pn,pn->p", rows, rows))
    rows /= np.where(size > 0, size, 1.0)[:, None]
    residuals = np.array(y, dtype=np.float64)
    coefficients = _orthogonalise(rows, residuals)
    return coefficients / np.where(size > 0, size, 1.0), residuals


@compiled
def _orthogonalise(rows: FloatArray, target: FloatArray) -> FloatArray:
    """Coefficients of ``target`` (n,) on the ``rows`` (p, n) of norm 1; residuals overwrite both.

    Modified Gram-Schmidt with the right-hand side carried along is as accurate as Householder's method
    (Björck 1967), and starts no threads as a library does for each call.
    """
    p = len(rows)
    triangle = np.zeros((p, p))
    share = np.zeros(p)
    for i in range(p):
        norm = np.sqrt(np.dot(rows[i], rows[i]))
        if norm < MIN_COLUMN_NORM:
            continue
        triangle[i, i] = norm
        rows[i] /= norm
        for j in range(i + 1, p):
            triangle[i, j] = np.dot(rows[i], rows[j])
            rows[j] -= triangle[i, j] * rows[i]
        share[i] = np.dot(rows[i], target)
        target -= share[i] * rows[i]
    solution = np.zeros(p)
    for i in range(p - 1, -1, -1):
        if triangle[i, i] > 0.0:
            solution[i] = (share[i] - np.dot(triangle[i, i + 1 :], solution[i + 1 :])) / triangle[i, i]
    return solution


def minimise_from_starts(
    residual: Residual, starts: Sequence[FloatArray], keep: int = 2, *, max_evaluations: int = 40
) -> FloatArray:
    """Minimise a sum of squares from the best of several starts.

    Args:
        residual: Residuals as a function of the parameters.
        starts: Candidate start values, each (p,).
        keep: Number of starts, the best ones, from which a minimum is searched.
        max_evaluations: Steps from each.

    Returns:
        (p,) the parameters with the smallest sum.
    """
    cost = [float(np.sum(np.square(residual(start)))) for start in starts]
    ranked = [starts[i] for i in np.argsort(cost)[:keep] if np.isfinite(cost[i])]
    best = ranked[0]
    lowest = np.inf
    for start in ranked:
        solution = optimize.least_squares(
            residual, start, x_scale=1.0, diff_step=DIFFERENCE_STEP, max_nfev=max_evaluations, ftol=1e-9
        )
        if solution.cost < lowest:
            best, lowest = solution.x, solution.cost
    return best


def free_run(
    b: FloatArray, f: FloatArray, offset: float, u: FloatArray, start: FloatArray | None
) -> FloatArray:
    """Simulate B/F·u + offset, (n,), from rest or the state that fits measured outputs ``start`` best."""
    y = np.asarray(signal.lfilter(b, f, u)) + offset
    if start is None or not len(start) or len(f) == 1:
        return y
    free = free_responses(f, len(u))
    m = min(len(start), len(u))
    return y + free @ regress(free[:m], start[:m] - y[:m])[0]


def continuous_poles(poles: NDArray[np.inexact[Any]], period: float) -> ComplexArray:
    """Convert poles in the z plane to rad/s: ln(z)/T; poles at zero (pure delays) are left out."""
    nonzero = poles[np.abs(poles) > 1e-9].astype(np.complex128)
    return np.asarray(np.sort_complex(np.log(nonzero) / period))


def polynomial_text(coefficients: FloatArray, sign: str = "−") -> str:
    """Write coefficients of q⁰, q⁻¹, … as a sum."""
    powers = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
    parts = [
        f"{value:+.6g}" + (f"·q{sign.replace('−', '⁻')}{str(i).translate(powers)}" if i else "")
        for i, value in enumerate(coefficients.tolist())
        if value != 0.0
    ]
    return " ".join(parts).removeprefix("+") or "0"
