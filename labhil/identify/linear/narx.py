"""Polynomial NARX models: y(t) = Σ cᵢ·(a product of delayed outputs and inputs).

Terms are ranked by forward regression with orthogonal least squares (Chen, Billings and Luo 1989); their
number has the least Bayesian information criterion of the free-run simulation. The coefficients then minimise
the error of the free run itself: one-step prediction of a signal that is sampled fast hardly shows errors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy import optimize

from labhil.compiled import compiled
from labhil.identify.linear.data import ComplexArray, Orders, Sampled
from labhil.identify.linear.filters import DIFFERENCE_STEP, regress
from labhil.signals import FloatArray, IntArray

MAX_OUTPUT = 1e3
"""Output of a free run, in standard deviations of the measured one, beyond which it has diverged."""


@dataclass(frozen=True, slots=True)
class NarxModel:
    """A polynomial of delayed outputs and inputs.

    Attributes:
        orders: Numbers of delayed outputs and inputs, and the highest power.
        period: Sampling period, s.
        powers: (terms, lags) of the delayed outputs, then of the delayed inputs.
        coefficients: (terms,) for scaled signals.
        middles: Means of output and input, which are subtracted.
        sizes: Standard deviations of output and input, by which they are divided.
        loss: Mean squared error of the free run, unit².
        delay: Of the latest input, samples.
    """

    orders: Orders
    period: float
    powers: IntArray
    coefficients: FloatArray
    middles: tuple[float, float]
    sizes: tuple[float, float]
    loss: float
    delay: int
    name: str = "narx"

    @property
    def parameters(self) -> Mapping[str, float]:
        """Coefficients by term, of the scaled signals."""
        return {
            _term(row, self.orders, self.delay): float(c)
            for row, c in zip(self.powers, self.coefficients, strict=True)
        }

    @property
    def poles(self) -> ComplexArray:
        """Empty: the poles of a nonlinear model depend on the operating point."""
        return np.empty(0, dtype=np.complex128)

    def simulate(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """Simulate freely over the input (n,) after the first measured outputs, or from the mean output.

        The output is infinite from the sample on at which the simulation diverges.
        """
        scaled = (u - self.middles[1]) / self.sizes[1]
        before = np.zeros(_depth(self.orders, self.delay))
        if start is not None:
            known = (start[: len(before)] - self.middles[0]) / self.sizes[0]
            before[: len(known)] = known
        y = _free_run(before, scaled, self.powers, self.coefficients, self.orders.poles, self.delay)
        y[np.abs(y) >= MAX_OUTPUT] = np.inf
        return y * self.sizes[0] + self.middles[0]

    def describe(self) -> str:
        """The terms with their coefficients."""
        text = " ".join(f"{c:+.5g}·{name}" for name, c in self.parameters.items()).removeprefix("+")
        return f"y(t) = {text} (y and u scaled), T = {self.period:g} s"


def fit_narx(data: Sampled, orders: Orders, *, max_evaluations: int = 30) -> NarxModel:
    """Choose terms up to the power ``orders.degree`` and fit their coefficients.

    Args:
        data: Input and output.
        orders: Numbers of delayed outputs and inputs, and the highest power.
        max_evaluations: Steps of the final fit on the free run.

    Raises:
        ValueError: There are too few samples.
    """
    delay = data.least_delay + orders.delay
    first = _depth(orders, delay)
    if len(data) < 10 * first:
        raise ValueError(f"these lags need {10 * first} samples at least, found {len(data)}")
    middles = float(data.y.mean()), float(data.u.mean())
    sizes = float(np.std(data.y)) or 1.0, float(np.std(data.u)) or 1.0
    y, u = (data.y - middles[0]) / sizes[0], (data.u - middles[1]) / sizes[1]
    powers = _candidates(orders)
    columns = _columns(y, u, powers, orders, delay)
    chosen = _rank_terms(columns, y[first:])

    def run(count: int, coefficients: FloatArray) -> FloatArray:
        free = _free_run(y[:first], u, powers[chosen[:count]], coefficients, orders.poles, delay)
        return free[first:] - y[first:]

    count, coefficients = _choose_term_count(run, columns[:, chosen], y[first:])
    coefficients, loss = _fit_free_run(run, count, coefficients, max_evaluations)
    kept = powers[chosen[:count]]
    return NarxModel(orders, data.period, kept, coefficients, middles, sizes, loss * sizes[0] ** 2, delay)


Run = Callable[[int, FloatArray], FloatArray]
"""From how many terms and their coefficients to the errors of the free run."""


def _choose_term_count(
    run: Run, columns: FloatArray, target: FloatArray, *, max_evaluations: int = 6
) -> tuple[int, FloatArray]:
    """Choose the number of columns (n, terms), the best first, with the least BIC of the free run.

    The coefficients come second; ``max_evaluations`` are the steps of the fit for each number.
    """
    n = len(target)
    best = np.inf, 1, np.zeros(1)
    for count in range(1, columns.shape[1] + 1):
        start = regress(columns[:, :count], target)[0]
        coefficients, loss = _fit_free_run(run, count, start, max_evaluations)
        criterion = n * np.log(max(loss, 1e-300)) + count * np.log(n)
        if criterion < best[0]:
            best = criterion, count, coefficients
    return best[1], best[2]


def _fit_free_run(run: Run, count: int, start: FloatArray, evaluations: int) -> tuple[FloatArray, float]:
    """Minimise the mean squared error of the free run; coefficients, and that error."""
    solution = optimize.least_squares(
        lambda c: run(count, c), start, x_scale="jac", diff_step=DIFFERENCE_STEP, max_nfev=evaluations
    )
    return np.asarray(solution.x), 2 * float(solution.cost) / len(solution.fun)


def _rank_terms(
    columns: FloatArray, target: FloatArray, *, max_terms: int = 12, min_explained: float = 1e-9
) -> list[int]:
    """Rank columns (n, terms) by forward regression: each explains most of the residuals of earlier ones.

    It ends where the best column explains less than ``min_explained`` of the target's power.
    """
    orthogonal, residuals = columns.copy(), target.copy()
    power = float(target @ target)
    weight = np.einsum("nt,nt->t", columns, columns)
    chosen: list[int] = []
    for _ in range(min(max_terms, columns.shape[1])):
        size = np.einsum("nt,nt->t", orthogonal, orthogonal)
        size[size < 1e-12 * np.maximum(weight, 1e-300)] = np.inf
        share = (orthogonal.T @ residuals) ** 2 / size / power
        share[chosen] = 0.0
        best = int(np.argmax(share))
        if not share[best] > min_explained:
            break
        chosen.append(best)
        direction = orthogonal[:, best] / np.sqrt(size[best])
        residuals -= direction * (direction @ residuals)
        orthogonal -= np.outer(direction, direction @ orthogonal)
    return chosen


def _candidates(orders: Orders) -> IntArray:
    """All products of up to ``degree`` delayed signals as rows of powers, the constant first."""
    lags = orders.poles + orders.inputs
    rows = [np.zeros(lags, dtype=np.int64)]
    for degree in range(1, orders.degree + 1):
        rows += [
            np.bincount(factors, minlength=lags).astype(np.int64)
            for factors in combinations_with_replacement(range(lags), degree)
        ]
    return np.array(rows)


def _columns(y: FloatArray, u: FloatArray, powers: IntArray, orders: Orders, delay: int) -> FloatArray:
    """Values (n − first, terms) of the products, from the first sample whose past is known."""
    first, n = _depth(orders, delay), len(y)
    past = [y[first - i : n - i] for i in range(1, orders.poles + 1)]
    past += [u[first - delay - j : n - delay - j] for j in range(orders.inputs)]
    lags = np.column_stack(past)
    return np.column_stack([np.prod(lags**row, axis=1) for row in powers])


def _depth(orders: Orders, delay: int) -> int:
    """Samples of the past that a prediction needs."""
    return max(orders.poles, delay + orders.inputs - 1)


@compiled
def _free_run(
    before: FloatArray, u: FloatArray, powers: IntArray, coefficients: FloatArray, outputs: int, delay: int
) -> FloatArray:
    """Simulate after the outputs ``before``, (n,); MAX_OUTPUT from the sample on at which it diverges."""
    n, first = len(u), len(before)
    y = np.empty(n)
    y[: min(first, n)] = before[: min(first, n)]
    for t in range(first, n):
        total = 0.0
        for i in range(len(coefficients)):
            value = coefficients[i]
            for j in range(powers.shape[1]):
                lag = y[t - 1 - j] if j < outputs else u[t - delay - (j - outputs)]
                for _ in range(powers[i, j]):
                    value *= lag
            total += value
        if not abs(total) < MAX_OUTPUT:
            y[t:] = MAX_OUTPUT
            return y
        y[t] = total
    return y


def _term(row: IntArray, orders: Orders, delay: int) -> str:
    """A product as text."""
    names = [f"y(t−{i})" for i in range(1, orders.poles + 1)]
    names += [f"u(t−{delay + j})" if delay + j else "u(t)" for j in range(orders.inputs)]
    parts = [
        name if power == 1 else f"{name}^{power}"
        for name, power in zip(names, row.tolist(), strict=True)
        if power
    ]
    return "·".join(parts) or "1"
