"""Hammerstein-Wiener models: a static nonlinearity, a linear model, a static nonlinearity.

w = g(u), x = B/F·w, y = h(x): g and h are piecewise linear and extrapolate linearly. The start is a
Hammerstein model (h linear), which is linear in products of the coefficients of g and B; a singular value
decomposition separates them (Bai 1998). Then all parameters are estimated together, with the values of h
projected out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import optimize, signal

from labhil.identify.linear.data import ComplexArray, Orders, Sampled
from labhil.identify.linear.filters import (
    continuous_poles,
    free_responses,
    input_columns,
    minimise_from_starts,
    polynomial_text,
    regress,
    stabilise,
    stable_polynomial,
    unconstrained_parameters,
)
from labhil.identify.linear.polynomial import denominators
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class PiecewiseLinear:
    """``offset`` + ``slopes``₀·v + Σ ``slopes``ᵢ·max(v − ``bends``ᵢ, 0), v = (value − middle)/size."""

    middle: float
    size: float
    bends: FloatArray
    slopes: FloatArray
    offset: float = 0.0

    def __call__(self, values: FloatArray) -> FloatArray:
        """The function's values, element by element."""
        return self.offset + _hinge_columns((values - self.middle) / self.size, self.bends) @ self.slopes


@dataclass(frozen=True, slots=True)
class HammersteinWienerModel:
    """y = ``after``(``b``/``f``·``before``(u)), coefficients of q⁰, q⁻¹, …"""

    orders: Orders
    period: float
    before: PiecewiseLinear
    b: FloatArray
    f: FloatArray
    after: PiecewiseLinear
    loss: float
    name: str = "hammerstein_wiener"

    @property
    def parameters(self) -> Mapping[str, float]:
        """Slopes of the nonlinearities (g0 …, h0 …), b and f by power, and the offset."""
        coefficients = {f"g{i}": float(v) for i, v in enumerate(self.before.slopes)}
        coefficients |= {
            f"b{i}": float(v) for i, v in enumerate(self.b) if i >= len(self.b) - self.orders.inputs
        }
        coefficients |= {f"f{i}": float(v) for i, v in enumerate(self.f) if i > 0}
        coefficients |= {f"h{i}": float(v) for i, v in enumerate(self.after.slopes)}
        return {**coefficients, "offset": self.after.offset}

    @property
    def poles(self) -> ComplexArray:
        """Poles of B/F in continuous time, rad/s."""
        return continuous_poles(np.roots(self.f), self.period)

    def simulate(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """Simulate over the input (n,), from rest or the state that fits ``start`` best."""
        x = np.asarray(signal.lfilter(self.b, self.f, self.before(u)))
        if start is None or not len(start):
            return self.after(x)
        m = min(len(start), len(u))
        free = free_responses(self.f, len(u))

        def residual(state: FloatArray) -> FloatArray:
            return self.after(x[:m] + free[:m] @ state) - start[:m]

        # where h is flat the state has no effect: start from the state for h without its bends
        slope = self.after.slopes[0] / self.after.size or 1.0
        begin = regress(free[:m], (start[:m] - self.after(x[:m])) / slope)[0]
        state = optimize.least_squares(residual, begin, x_scale="jac", max_nfev=50).x
        return self.after(x + free @ state)

    def describe(self) -> str:
        """The three blocks as equations."""
        return (
            f"w = g(u), x = [{polynomial_text(self.b)}]/[{polynomial_text(self.f)}]·w, y = h(x), "
            f"g and h with {len(self.before.bends)} bends, T = {self.period:g} s"
        )


def fit_hammerstein_wiener(data: Sampled, orders: Orders, *, max_bend: float = 1.5) -> HammersteinWienerModel:
    """Fit a Hammerstein-Wiener model.

    Args:
        data: Input and output.
        orders: Poles, numerator coefficients (``inputs``), and ``degree`` bends in each nonlinearity.
        max_bend: Bends of h lie within so many standard deviations of x.
    """
    middle, size = float(data.u.mean()), float(np.std(data.u)) or 1.0
    v = (data.u - middle) / size
    bends = np.asarray(np.quantile(v, np.linspace(0, 1, orders.degree + 2)[1:-1]), dtype=np.float64)
    bent = _hinge_columns(v, bends)
    f, slopes, numerator = _hammerstein(data, orders, bent)
    p, k, delay = orders.poles, orders.inputs, data.least_delay + orders.delay
    knots = np.linspace(-max_bend, max_bend, orders.degree + 2, dtype=np.float64)[1:-1]

    def unpack(z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return stable_polynomial(z[:p]), z[p : p + k], z[p + k : -p]

    def output(z: FloatArray) -> FloatArray:
        f, b, g = unpack(z)
        padded = np.append(np.zeros(delay), b)
        return np.asarray(signal.lfilter(padded, f, bent @ g)) + free_responses(f, len(data)) @ z[-p:]

    def fit_output(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        columns = np.column_stack(
            (_hinge_columns((x - x.mean()) / (np.std(x) or 1.0), knots), np.ones(len(x)))
        )
        return regress(columns, data.y)

    z = minimise_from_starts(
        lambda z: fit_output(output(z))[1],
        [np.concatenate((unconstrained_parameters(f), numerator, slopes, np.zeros(p)))],
        keep=1,
    )
    x = output(z)
    coefficients, residuals = fit_output(x)
    f, b, g = unpack(z)
    before = PiecewiseLinear(middle, size, bends, g)
    after = PiecewiseLinear(
        float(x.mean()), float(np.std(x)) or 1.0, knots, coefficients[:-1], float(coefficients[-1])
    )
    padded = np.append(np.zeros(delay), b)
    return HammersteinWienerModel(
        orders, data.period, before, padded, f, after, float(np.mean(np.square(residuals)))
    )


def _hammerstein(
    data: Sampled, orders: Orders, bent: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """F, the slopes of g and the coefficients of B when h is linear."""
    n, count, delay = len(data), bent.shape[1], data.least_delay + orders.delay

    def columns(f: FloatArray) -> FloatArray:
        inputs = [input_columns(f, bent[:, i], orders.inputs, delay) for i in range(count)]
        return np.column_stack((*inputs, np.ones(n), free_responses(f, n)))

    def residual(theta: FloatArray) -> FloatArray:
        return regress(columns(stable_polynomial(theta)), data.y)[1]

    starts = [unconstrained_parameters(f) for f in denominators(data, orders)]
    f = stabilise(stable_polynomial(minimise_from_starts(residual, starts)))
    products = regress(columns(f), data.y)[0][: count * orders.inputs].reshape(count, orders.inputs)
    left, sizes, right = np.linalg.svd(products)
    slopes, numerator = left[:, 0], right[0]
    return f, slopes, float(sizes[0]) * numerator


def _hinge_columns(v: FloatArray, bends: FloatArray) -> FloatArray:
    """Basis of piecewise linear functions at ``v`` (n,), (n, bends + 1)."""
    return np.column_stack((v, *(np.maximum(v - bend, 0.0) for bend in bends)))
