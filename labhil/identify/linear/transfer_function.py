"""Transfer functions in continuous time, by output error: y(s) = N(s)/D(s)·u(s) + offset.

Between samples the input is held or runs straight, as its hold says. The numerator, the offset and the
initial state are projected out, so that only coefficients of the denominator are searched. It is a product of
s² + a₁s + a₀ and s + a₀ with positive coefficients, searched as logarithms, and so has no root in the right
half-plane.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import signal

from labhil.identify.linear.data import ComplexArray, Orders, Sampled
from labhil.identify.linear.filters import delayed, free_responses, free_run, minimise_from_starts, regress
from labhil.identify.linear.polynomial import denominators
from labhil.signals import FloatArray, Hold

MAX_LOG_COEFFICIENT = 30.0
"""Bound of the logarithms of coefficients in units of the sampling period: keeps exponentials finite."""


@dataclass(frozen=True, slots=True)
class TransferFunctionModel:
    """``numerator`` and ``denominator`` in falling powers of s (rad/s), the denominator's first being 1.

    ``period`` (s) and ``hold`` are those of the data that it was fitted to, and of what it simulates.
    """

    orders: Orders
    period: float
    hold: Hold
    numerator: FloatArray
    denominator: FloatArray
    offset: float
    loss: float
    name: str = "transfer_function"

    @property
    def parameters(self) -> Mapping[str, float]:
        """Coefficients by power of s: n0 …, d0 …, and the offset."""
        coefficients = {f"n{len(self.numerator) - 1 - i}": float(v) for i, v in enumerate(self.numerator)}
        order = len(self.denominator) - 1
        coefficients |= {f"d{order - i}": float(v) for i, v in enumerate(self.denominator) if i > 0}
        return {**coefficients, "offset": self.offset}

    @property
    def poles(self) -> ComplexArray:
        """Poles, rad/s."""
        return np.asarray(np.sort_complex(np.roots(self.denominator).astype(np.complex128)))

    def simulate(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """Simulate over the input (n,), from rest or the state that fits ``start`` best."""
        powers, f = _discretise(self.denominator, len(self.numerator), self.period, self.hold)
        return free_run(self.numerator[::-1] @ powers, f, self.offset, delayed(u, self.orders.delay), start)

    def describe(self) -> str:
        """The model as a quotient of polynomials in s."""
        samples = self.orders.delay
        delay = f"·exp(−{samples * self.period:g}·s)" if samples else ""
        quotient = f"({_powers(self.numerator)})/({_powers(self.denominator)})"
        return f"G(s) = {quotient}{delay}, offset {self.offset:.6g}"


def fit_transfer_function(data: Sampled, orders: Orders) -> TransferFunctionModel:
    """Fit a transfer function with ``orders.poles`` poles and ``orders.inputs`` − 1 zeros.

    Raises:
        ValueError: There are not fewer zeros than poles.
    """
    if orders.inputs > orders.poles:
        raise ValueError(
            f"a transfer function of {orders.poles} poles has fewer zeros, found {orders.inputs - 1}"
        )

    def residual(theta: FloatArray) -> FloatArray:
        return _fit_numerator(data, orders, _denominator(theta, data.period))[1]

    theta = minimise_from_starts(residual, _starts(data, orders))
    denominator = _denominator(theta, data.period)
    coefficients, residuals = _fit_numerator(data, orders, denominator)
    numerator = coefficients[: orders.inputs][::-1]
    loss = float(np.mean(np.square(residuals)))
    return TransferFunctionModel(
        orders, data.period, data.hold, numerator, denominator, float(coefficients[orders.inputs]), loss
    )


def _fit_numerator(data: Sampled, orders: Orders, denominator: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit the coefficients of s⁰, s¹, … and the offset for a given denominator; residuals come second."""
    n = len(data)
    u = delayed(data.u, orders.delay)
    powers, f = _discretise(denominator, orders.inputs, data.period, data.hold)
    columns = [signal.lfilter(b, f, u) for b in powers]
    return regress(np.column_stack((*columns, np.ones(n), free_responses(f, n))), data.y)


def _discretise(
    denominator: FloatArray, count: int, period: float, hold: Hold
) -> tuple[FloatArray, FloatArray]:
    """Discretise s⁰/D(s), s¹/D(s), …: numerators (count, order + 1) and their denominator, in q⁻¹.

    The states x, x′, x″, … of 1/D(s) change over a period by a matrix exponential; an input that runs
    straight from u₀ to u₁ adds a ramp to the held one.
    """
    order = len(denominator) - 1
    # one unit of time per sample gives the matrices' elements similar sizes
    den = denominator * period ** np.arange(order + 1)
    block = np.zeros((order + 2, order + 2))
    block[: order - 1, 1:order] = np.eye(order - 1)
    block[order - 1, :order] = -den[:0:-1]
    block[order - 1, order] = 1.0
    block[order, order + 1] = 1.0
    step = _exponential(block)
    a, held, ramp = (
        step[:order, :order],
        step[:order, order : order + 1],
        step[:order, order + 1 :],
    )
    out, none = np.eye(order)[:count], np.zeros((count, 1))
    if hold is Hold.ZERO:
        b, f = signal.ss2tf(a, held, out, none)
    else:
        b, f = signal.ss2tf(a, held - ramp, out, none)
        b = b + np.roll(signal.ss2tf(a, ramp, out, none)[0], -1, axis=1)
    return b * (period ** (order - np.arange(count)))[:, None], np.asarray(f)


def _exponential(matrix: FloatArray) -> FloatArray:
    """Matrix exponential by scaling and squaring of a series; for small matrices faster than a library's."""
    squarings = max(0, int(np.ceil(np.log2(max(float(np.abs(matrix).sum(axis=1).max()), 1e-300)))) + 2)
    scaled = matrix / 2.0**squarings
    term = total = np.eye(len(matrix))
    for i in range(1, 16):
        term = term @ scaled / i
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return total


def _denominator(theta: FloatArray, period: float) -> FloatArray:
    """Polynomial in s from logarithms of pairs (a₁·T, a₀·T²), and of one a₀·T for an odd order."""
    values = np.exp(np.clip(theta, -MAX_LOG_COEFFICIENT, MAX_LOG_COEFFICIENT / 6))
    den = np.ones(1)
    for i in range(0, len(values) - 1, 2):
        den = np.polymul(den, [1.0, values[i] / period, values[i + 1] / period**2])
    return np.polymul(den, [1.0, values[-1] / period]) if len(values) % 2 else den


def _starts(
    data: Sampled,
    orders: Orders,
    *,
    damping_ratios: tuple[float, ...] = (0.3, 1.0, 4.0),
    n_corners: int = 5,
) -> list[FloatArray]:
    """Start values: poles of discrete fits, and a grid of corner frequencies and damping ratios."""
    starts = [
        start
        for f in denominators(data, Orders(orders.poles, orders.poles, delay=orders.delay))
        if (start := _logarithms(np.roots(f).astype(np.complex128))) is not None
    ]
    corners = np.geomspace(4.0 / len(data), 0.5, n_corners)
    for corner, damping in product(corners, damping_ratios):
        pair = [np.log(2 * damping * corner), 2 * np.log(corner)]
        pairs = [
            value + shift
            for shift in range(orders.poles // 2)
            for value in (pair[0] + shift, pair[1] + shift)
        ]
        starts.append(np.array(pairs + [np.log(corner)] * (orders.poles % 2)))
    return starts


def _logarithms(poles: ComplexArray) -> FloatArray | None:
    """The ``theta`` of poles in the z plane; None where they have no equivalent in continuous time."""
    if np.any(np.abs(poles) < 1e-12) or np.any((poles.imag == 0) & (poles.real <= 0)):
        return None
    s = np.log(poles)
    s = np.minimum(s.real, -1e-9) + 1j * s.imag
    pairs = s[s.imag > 0]
    real = np.sort(s[s.imag == 0].real)
    factors = [(-2 * pair.real, abs(pair) ** 2) for pair in pairs]
    factors += [(-(p + q), p * q) for p, q in zip(real[0::2], real[1::2], strict=False)]
    single = [-real[-1]] if len(real) % 2 else []
    return np.log(np.array([value for factor in factors for value in factor] + single))


def _powers(coefficients: FloatArray) -> str:
    """A polynomial in s as text."""
    top = len(coefficients) - 1
    parts = []
    for i, value in enumerate(coefficients.tolist()):
        power = top - i
        parts.append(f"{value:+.6g}" + ("" if power == 0 else "·s" if power == 1 else f"·s^{power}"))
    return " ".join(parts).removeprefix("+")
