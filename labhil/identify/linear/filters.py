"""Polynomials in the delay operator, and the linear part of a fit projected out of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, signal

from labhil.compiled import compiled
from labhil.identify.linear.data import ComplexArray
from labhil.signals import FloatArray

MOST_REFLECTION = 1 - 1e-9
DIFFERENCE = 1e-6
MOST_EVALUATIONS = 40
NEGLIGIBLE = 1e-13
"""Share of a column that is left when the others have explained all of it."""
Residual = Callable[[FloatArray], FloatArray]


def stable(theta: FloatArray) -> FloatArray:
    """The polynomial 1 + f₁q⁻¹ + … whose reflection coefficients are tanh ``theta``.

    All its roots lie within the unit circle, whatever ``theta`` is, and any such polynomial has one
    (the step-up recursion of Levinson and Durbin): stability needs no constraint.
    """
    f = np.ones(1)
    for k in np.tanh(theta):
        f = np.append(f, 0.0) + k * np.append(0.0, f[::-1])
    return f


def unbounded(f: FloatArray) -> FloatArray:
    """The ``theta`` of a polynomial; roots outside of the unit circle are brought into it."""
    f = stabilise(f)
    theta = np.empty(len(f) - 1)
    for i in range(len(theta) - 1, -1, -1):
        k = float(np.clip(f[-1], -MOST_REFLECTION, MOST_REFLECTION))
        theta[i] = np.arctanh(k)
        f = (f[:-1] - k * f[:0:-1]) / (1 - k * k)
    return theta


def stabilise(f: FloatArray) -> FloatArray:
    """The polynomial with its roots outside of the unit circle reflected into it."""
    roots = np.roots(f)
    if not len(roots) or np.abs(roots).max() < MOST_REFLECTION:
        return np.asarray(f / f[0])
    outside = np.abs(roots) >= MOST_REFLECTION
    roots = roots.astype(np.complex128)
    roots[outside] /= np.abs(roots[outside]) ** 2
    roots *= np.minimum(1.0, MOST_REFLECTION / np.maximum(np.abs(roots), MOST_REFLECTION))
    return np.asarray(np.poly(roots).real)


def delayed(values: FloatArray, samples: int) -> FloatArray:
    """The values (n,) that many samples later, zero before."""
    out = np.zeros_like(values)
    out[samples:] = values[: len(values) - samples]
    return out


def free_responses(f: FloatArray, n: int) -> FloatArray:
    """What 1/f does from any state without an input, (n, order): a basis of it."""
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


def project(columns: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares: coefficients (p,) and residuals (n,) of y on the columns (n, p).

    A column that the earlier ones explain gets no coefficient.
    """
    rows = np.array(columns.T, dtype=np.float64, order="C")
    size = np.sqrt(np.einsum("pn,pn->p", rows, rows))
    rows /= np.where(size > 0, size, 1.0)[:, None]
    residuals = np.array(y, dtype=np.float64)
    coefficients = _orthogonalise(rows, residuals)
    return coefficients / np.where(size > 0, size, 1.0), residuals


@compiled
def _orthogonalise(rows: FloatArray, target: FloatArray) -> FloatArray:
    """Coefficients of ``target`` (n,) on the ``rows`` (p, n) of norm 1; both are overwritten by their rests.

    Modified Gram-Schmidt with the right-hand side carried along, which solves least squares as well as
    Householder's way does (Björck 1967), and without the threads that a library starts for each call.
    """
    p = len(rows)
    triangle = np.zeros((p, p))
    share = np.zeros(p)
    for i in range(p):
        norm = np.sqrt(np.dot(rows[i], rows[i]))
        if norm < NEGLIGIBLE:
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


def improve(residual: Residual, starts: Sequence[FloatArray], keep: int = 2) -> FloatArray:
    """The parameters with the smallest sum of squares, from the ``keep`` best of several starts."""
    cost = [float(np.sum(np.square(residual(start)))) for start in starts]
    ranked = [starts[i] for i in np.argsort(cost)[:keep] if np.isfinite(cost[i])]
    best = ranked[0]
    lowest = np.inf
    for start in ranked:
        solution = optimize.least_squares(
            residual, start, x_scale=1.0, diff_step=DIFFERENCE, max_nfev=MOST_EVALUATIONS, ftol=1e-9
        )
        if solution.cost < lowest:
            best, lowest = solution.x, solution.cost
    return best


def free_run(
    b: FloatArray, f: FloatArray, offset: float, u: FloatArray, start: FloatArray | None
) -> FloatArray:
    """B/F·u + offset, (n,), from rest or from the state that suits the measured outputs ``start`` best."""
    y = np.asarray(signal.lfilter(b, f, u)) + offset
    if start is None or not len(start) or len(f) == 1:
        return y
    free = free_responses(f, len(u))
    m = min(len(start), len(u))
    return y + free @ project(free[:m], start[:m] - y[:m])[0]


def continuous(poles: NDArray[np.inexact[Any]], period: float) -> ComplexArray:
    """Poles in the z plane as rad/s: ln(z)/T; those at zero (pure delays) are left out."""
    nonzero = poles[np.abs(poles) > 1e-9].astype(np.complex128)
    return np.asarray(np.sort_complex(np.log(nonzero) / period))


def polynomial_text(coefficients: FloatArray, sign: str = "−") -> str:
    """Coefficients of q⁰, q⁻¹, … as a sum."""
    powers = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
    parts = [
        f"{value:+.6g}" + (f"·q{sign.replace('−', '⁻')}{str(i).translate(powers)}" if i else "")
        for i, value in enumerate(coefficients.tolist())
        if value != 0.0
    ]
    return " ".join(parts).removeprefix("+") or "0"
