"""ARX, ARMAX, output-error and Box-Jenkins models: y = B/F·u + offset + noise, polynomials in q⁻¹.

Fits minimise the prediction error (Ljung 1999, chapters 4, 7 and 10). Coefficients in which it is linear, the
initial state and the offset are projected out. The search is over the denominators, which are stable by
construction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from labhil.identify.linear.data import ComplexArray, Orders, Sampled
from labhil.identify.linear.filters import (
    continuous_poles,
    free_responses,
    free_run,
    input_columns,
    minimise_from_starts,
    polynomial_text,
    regress,
    stabilise,
    stable_polynomial,
    unconstrained_parameters,
)
from labhil.signals import FloatArray


@dataclass(frozen=True, slots=True)
class PolynomialModel:
    """y = ``b``/``f``·u + ``offset`` + ``c``/``d``·e, coefficients of q⁰, q⁻¹, … with f₀ = c₀ = d₀ = 1.

    ``b`` begins with the delay's zeros. For ARX and ARMAX ``d`` is ``f``, the A of the textbooks.
    """

    name: str
    orders: Orders
    period: float
    b: FloatArray
    f: FloatArray
    c: FloatArray
    d: FloatArray
    offset: float
    loss: float

    @property
    def parameters(self) -> Mapping[str, float]:
        """Coefficients by name: b1, f1 (a1 for ARX and ARMAX), c1, d1, offset."""
        shared = self.name in ("arx", "armax")
        kinds = {"a" if shared else "f": self.f, "c": self.c, "d": np.ones(1) if shared else self.d}
        coefficients = {
            f"b{i}": float(v) for i, v in enumerate(self.b) if i >= len(self.b) - self.orders.inputs
        }
        for kind, values in kinds.items():
            coefficients |= {f"{kind}{i}": float(v) for i, v in enumerate(values) if i > 0}
        return {**coefficients, "offset": self.offset}

    @property
    def poles(self) -> ComplexArray:
        """Poles of B/F in continuous time, rad/s."""
        return continuous_poles(np.roots(self.f), self.period)

    def simulate(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """Simulate over the input (n,), from rest or the state that fits ``start`` best."""
        return free_run(self.b, self.f, self.offset, u, start)

    def predict(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """One-step predictions (n,): ŷ = y − D/C·(y − B/F·u − offset), at rest before the first sample."""
        noise = y - self.simulate(u)
        return np.asarray(y - signal.lfilter(self.d, self.c, noise))

    def describe(self) -> str:
        """The model as an equation."""
        text = f"y = [{polynomial_text(self.b)}]/[{polynomial_text(self.f)}]·u + {self.offset:.6g}"
        if len(self.c) > 1 or len(self.d) > 1:
            text += f" + [{polynomial_text(self.c)}]/[{polynomial_text(self.d)}]·e"
        return f"{text}, T = {self.period:g} s"


def fit_arx(data: Sampled, orders: Orders) -> PolynomialModel:
    """Fit A(q)·y = B(q)·u + offset + e by linear least squares."""
    return _with_moving_average("arx", data, orders, np.ones(1))


def fit_armax(data: Sampled, orders: Orders) -> PolynomialModel:
    """Fit A(q)·y = B(q)·u + offset + C(q)·e; for a given C it is ARX of signals filtered by 1/C."""
    columns, target = _regressors(data, orders)

    def residual(theta: FloatArray) -> FloatArray:
        return _filtered_fit(columns, target, stable_polynomial(theta))[1]

    if orders.noise == 0:
        return _with_moving_average("armax", data, orders, np.ones(1))
    # white noise on the output alone is C = A: start there too, as far as the order of C allows
    thetas = [unconstrained_parameters(f)[: orders.noise] for f in denominators(data, orders)]
    starts = [np.append(theta, np.zeros(orders.noise - len(theta))) for theta in thetas]
    c = stable_polynomial(minimise_from_starts(residual, [np.zeros(orders.noise), *starts]))
    return _with_moving_average("armax", data, orders, c)


def fit_oe(data: Sampled, orders: Orders) -> PolynomialModel:
    """Fit y = B(q)/F(q)·u + offset + e by the simulation error."""

    def residual(theta: FloatArray) -> FloatArray:
        return _fit_numerator(data, orders, stable_polynomial(theta))[1]

    f = stable_polynomial(
        minimise_from_starts(residual, [unconstrained_parameters(f) for f in denominators(data, orders)])
    )
    coefficients, residuals = _fit_numerator(data, orders, f)
    unity = np.ones(1)
    return _model("oe", data, orders, (coefficients, f, unity, unity), residuals)


def fit_box_jenkins(data: Sampled, orders: Orders) -> PolynomialModel:
    """Fit y = B(q)/F(q)·u + offset + C(q)/D(q)·e, from the output-error fit as start.

    Raises:
        ValueError: ``orders.noise`` is 0.
    """
    if orders.noise == 0:
        raise ValueError("a Box-Jenkins model needs noise polynomials: noise must be 1 at least, found 0")
    first = fit_oe(data, orders)
    p, m = orders.poles, orders.noise
    residuals = data.y - first.simulate(data.u, data.y)
    theta = unconstrained_parameters(_autoregression(residuals, m))

    def parts(z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return stable_polynomial(z[:p]), stable_polynomial(z[p : p + m]), stable_polynomial(z[p + m :])

    def residual(z: FloatArray) -> FloatArray:
        f, c, d = parts(z)
        return _fit_numerator(data, orders, f, c, d)[1]

    begin = unconstrained_parameters(first.f)
    starts = [np.concatenate((begin, ma, theta)) for ma in (np.zeros(m), 0.5 * theta)]
    f, c, d = parts(minimise_from_starts(residual, starts))
    coefficients, residuals = _fit_numerator(data, orders, f, c, d)
    model = _model("box_jenkins", data, orders, (coefficients, f, c, d), residuals)
    # with drifting noise the prediction error hardly determines the offset: the free run does
    remainder = data.y - (model.simulate(data.u) - model.offset)
    columns = np.column_stack((np.ones(len(data)), free_responses(f, len(data))))
    return replace(model, offset=float(regress(columns, remainder)[0][0]))


def denominators(
    data: Sampled, orders: Orders, *, strides: tuple[int, ...] = (1, 3, 10, 30), rounds: int = 5
) -> list[FloatArray]:
    """Guess F by the iteration of Steiglitz and McBride (1965) on the data at several sampling rates.

    Args:
        data: Input and output.
        orders: Numbers of poles and numerator coefficients.
        strides: Every such sample is used: at a fast rate noise hides the changes from sample to sample.
        rounds: Of the iteration.

    Returns:
        A guess (poles + 1,) for each stride with enough samples.
    """
    guesses = []
    for stride in strides:
        few = Sampled(data.u[::stride], data.y[::stride], data.period * stride, data.hold)
        if len(few) < 20 * (orders.poles + orders.inputs):
            break
        f = np.ones(1)
        for _ in range(rounds):
            filtered = Sampled(
                signal.lfilter([1.0], f, few.u),
                signal.lfilter([1.0], f, few.y - few.y[0]),
                few.period,
                few.hold,
            )
            columns, target = _regressors(
                filtered, Orders(orders.poles, orders.inputs, delay=orders.delay // stride)
            )
            f = stabilise(np.append(1.0, regress(columns, target)[0][: orders.poles]))
        guesses.append(_finer(f, stride))
    return guesses or [np.append(1.0, np.full(orders.poles, -0.1))]


def simulation_loss(data: Sampled, orders: Orders, f: FloatArray) -> float:
    """Mean square simulation error (unit²) with this denominator and the best numerator."""
    return float(np.mean(np.square(_fit_numerator(data, orders, f)[1])))


def _finer(f: FloatArray, stride: int) -> FloatArray:
    """Convert a denominator for every ``stride``-th sample to every sample: poles to the power 1/stride."""
    if stride == 1:
        return f
    roots = np.roots(f).astype(np.complex128)
    return np.asarray(np.poly(np.abs(roots) ** (1 / stride) * np.exp(1j * np.angle(roots) / stride)).real)


def _fit_numerator(
    data: Sampled,
    orders: Orders,
    f: FloatArray,
    c: FloatArray | None = None,
    d: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Fit B and the offset, (inputs + 1,), for given F, C and D; the residuals come second."""
    n = len(data)
    inputs = input_columns(f, data.u, orders.inputs, data.least_delay + orders.delay)
    columns = np.column_stack((inputs, np.ones(n), free_responses(f, n)))
    if c is None or d is None:
        coefficients, residuals = regress(columns, data.y)
    else:
        whitened = signal.lfilter(d, c, columns, axis=0)
        past = free_responses(c, n)
        coefficients, residuals = regress(np.column_stack((whitened, past)), signal.lfilter(d, c, data.y))
    return coefficients[: orders.inputs + 1], residuals


def _regressors(data: Sampled, orders: Orders) -> tuple[FloatArray, FloatArray]:
    """Columns −y(t−1) …, u(t−delay) …, 1, and y(t), from the first sample whose past is known."""
    delay, n = data.least_delay + orders.delay, len(data)
    first = max(orders.poles, delay + orders.inputs - 1)
    past = [-data.y[first - i : n - i] for i in range(1, orders.poles + 1)]
    inputs = [data.u[first - delay - j : n - delay - j] for j in range(orders.inputs)]
    return np.column_stack((*past, *inputs, np.ones(n - first))), data.y[first:]


def _filtered_fit(columns: FloatArray, target: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least squares of signals filtered by 1/C: coefficients, then residuals."""
    past = free_responses(c, len(target))
    filtered = signal.lfilter([1.0], c, columns, axis=0)
    return regress(np.column_stack((filtered, past)), signal.lfilter([1.0], c, target))


def _with_moving_average(name: str, data: Sampled, orders: Orders, c: FloatArray) -> PolynomialModel:
    """Fit A and B of an ARMAX model for a given C."""
    coefficients, residuals = _filtered_fit(*_regressors(data, orders), c)
    p, k = orders.poles, orders.inputs
    a = np.append(1.0, coefficients[:p])
    f = stabilise(a)
    if np.allclose(f, a, rtol=1e-12, atol=1e-12):
        numerator = np.append(coefficients[p : p + k], coefficients[p + k] / a.sum())
    else:
        # an unstable model cannot be simulated freely: reflect its poles and fit the numerator anew
        numerator, residuals = _fit_numerator(data, orders, f)
    return _model(name, data, orders, (numerator, f, c, f), residuals)


def _model(
    name: str,
    data: Sampled,
    orders: Orders,
    parts: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    residuals: FloatArray,
) -> PolynomialModel:
    """Assemble a model from numerator with offset, F, C and D."""
    numerator, f, c, d = parts
    b = np.append(np.zeros(data.least_delay + orders.delay), numerator[:-1])
    loss = float(np.mean(np.square(residuals)))
    return PolynomialModel(name, orders, data.period, b, f, c, d, float(numerator[-1]), loss)


def _autoregression(values: FloatArray, order: int) -> FloatArray:
    """Fit the polynomial 1 + d₁q⁻¹ + … that whitens values (n,), by least squares."""
    n = len(values)
    past = np.column_stack([values[order - i : n - i] for i in range(1, order + 1)])
    return np.append(1.0, -regress(past, values[order:])[0])
