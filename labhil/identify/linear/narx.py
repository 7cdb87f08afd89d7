"""Polynomial NARX: y(t) = Σ cᵢ·(a product of delayed outputs and inputs).

Terms are chosen one after another by how much more of the output each explains (forward regression with
orthogonal least squares: Chen, Billings and Luo 1989), as many as the free run supports. Their
coefficients are then improved on the free run itself, since one-step prediction of a signal that is
sampled fast forgives almost anything.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy import optimize

from labhil.compiled import compiled
from labhil.identify.linear.data import ComplexArray, Orders, Sampled
from labhil.identify.linear.filters import DIFFERENCE, project
from labhil.signals import FloatArray, IntArray

MOST_TERMS = 12
FEW_EVALUATIONS = 6
MOST_EVALUATIONS = 30
LARGEST = 1e3
"""A free run that leaves that many standard deviations of the output has no bounds."""
WORTH = 1e-9
"""Share of the output's power that a term must explain to be kept."""


@dataclass(frozen=True, slots=True)
class NarxModel:
    """``powers`` (terms, lags) of the delayed outputs, then inputs; ``coefficients`` (terms,).

    In units of ``sizes``: outputs less ``middles[0]`` over ``sizes[0]``, inputs likewise with [1].
    ``delay`` (samples) is that of the latest input.
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
        """None: its poles are different at every point."""
        return np.empty(0, dtype=np.complex128)

    def simulate(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """Free run over the input (n,) after the first measured outputs, or from the mean output.

        Infinite from where the run leaves all bounds.
        """
        scaled = (u - self.middles[1]) / self.sizes[1]
        before = np.zeros(_depth(self.orders, self.delay))
        if start is not None:
            known = (start[: len(before)] - self.middles[0]) / self.sizes[0]
            before[: len(known)] = known
        y = _free_run(before, scaled, self.powers, self.coefficients, self.orders.poles, self.delay)
        y[np.abs(y) >= LARGEST] = np.inf
        return y * self.sizes[0] + self.middles[0]

    def describe(self) -> str:
        """The terms with their coefficients."""
        text = " ".join(f"{c:+.5g}·{name}" for name, c in self.parameters.items()).removeprefix("+")
        return f"y(t) = {text} (y and u scaled), T = {self.period:g} s"


def fit_narx(data: Sampled, orders: Orders) -> NarxModel:
    """Choose terms up to ``orders.degree`` and fit them; ValueError when there are too few samples."""
    delay = data.least_delay + orders.delay
    first = _depth(orders, delay)
    if len(data) < 10 * first:
        raise ValueError(f"these lags need {10 * first} samples at least, found {len(data)}")
    middles = float(data.y.mean()), float(data.u.mean())
    sizes = float(np.std(data.y)) or 1.0, float(np.std(data.u)) or 1.0
    y, u = (data.y - middles[0]) / sizes[0], (data.u - middles[1]) / sizes[1]
    powers = _candidates(orders)
    columns = _columns(y, u, powers, orders, delay)
    chosen = _forward(columns, y[first:])

    def run(count: int, coefficients: FloatArray) -> FloatArray:
        free = _free_run(y[:first], u, powers[chosen[:count]], coefficients, orders.poles, delay)
        return free[first:] - y[first:]

    count, coefficients = _choose_term_count(run, columns[:, chosen], y[first:])
    coefficients, loss = _polish(run, count, coefficients, MOST_EVALUATIONS)
    kept = powers[chosen[:count]]
    return NarxModel(orders, data.period, kept, coefficients, middles, sizes, loss * sizes[0] ** 2, delay)


Run = Callable[[int, FloatArray], FloatArray]
"""From how many terms and their coefficients to the errors of the free run."""


def _choose_term_count(run: Run, columns: FloatArray, target: FloatArray) -> tuple[int, FloatArray]:
    """How many of the columns (n, terms), the best first, lower the free run's criterion (BIC)."""
    n = len(target)
    best = np.inf, 1, np.zeros(1)
    for count in range(1, columns.shape[1] + 1):
        start = project(columns[:, :count], target)[0]
        coefficients, loss = _polish(run, count, start, FEW_EVALUATIONS)
        criterion = n * np.log(max(loss, 1e-300)) + count * np.log(n)
        if criterion < best[0]:
            best = criterion, count, coefficients
    return best[1], best[2]


def _polish(run: Run, count: int, start: FloatArray, evaluations: int) -> tuple[FloatArray, float]:
    """Coefficients that make the free run's mean square error small, and that error."""
    solution = optimize.least_squares(
        lambda c: run(count, c), start, x_scale="jac", diff_step=DIFFERENCE, max_nfev=evaluations
    )
    return np.asarray(solution.x), 2 * float(solution.cost) / len(solution.fun)


def _forward(columns: FloatArray, target: FloatArray) -> list[int]:
    """The columns in the order in which they explain most of what the earlier ones left."""
    rest, residuals = columns.copy(), target.copy()
    power = float(target @ target)
    weight = np.einsum("nt,nt->t", columns, columns)
    chosen: list[int] = []
    for _ in range(min(MOST_TERMS, columns.shape[1])):
        size = np.einsum("nt,nt->t", rest, rest)
        size[size < 1e-12 * np.maximum(weight, 1e-300)] = np.inf
        share = (rest.T @ residuals) ** 2 / size / power
        share[chosen] = 0.0
        best = int(np.argmax(share))
        if not share[best] > WORTH:
            break
        chosen.append(best)
        direction = rest[:, best] / np.sqrt(size[best])
        residuals -= direction * (direction @ residuals)
        rest -= np.outer(direction, direction @ rest)
    return chosen


def _candidates(orders: Orders) -> IntArray:
    """All products of up to ``degree`` lags as rows of powers, the constant first."""
    lags = orders.poles + orders.inputs
    rows = [np.zeros(lags, dtype=np.int64)]
    for degree in range(1, orders.degree + 1):
        rows += [
            np.bincount(factors, minlength=lags).astype(np.int64)
            for factors in combinations_with_replacement(range(lags), degree)
        ]
    return np.array(rows)


def _columns(y: FloatArray, u: FloatArray, powers: IntArray, orders: Orders, delay: int) -> FloatArray:
    first, n = _depth(orders, delay), len(y)
    past = [y[first - i : n - i] for i in range(1, orders.poles + 1)]
    past += [u[first - delay - j : n - delay - j] for j in range(orders.inputs)]
    lags = np.column_stack(past)
    return np.column_stack([np.prod(lags**row, axis=1) for row in powers])


def _depth(orders: Orders, delay: int) -> int:
    return max(orders.poles, delay + orders.inputs - 1)


@compiled
def _free_run(
    before: FloatArray, u: FloatArray, powers: IntArray, coefficients: FloatArray, outputs: int, delay: int
) -> FloatArray:
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
        if not abs(total) < LARGEST:
            y[t:] = LARGEST
            return y
        y[t] = total
    return y


def _term(row: IntArray, orders: Orders, delay: int) -> str:
    names = [f"y(t−{i})" for i in range(1, orders.poles + 1)]
    names += [f"u(t−{delay + j})" if delay + j else "u(t)" for j in range(orders.inputs)]
    parts = [
        name if power == 1 else f"{name}^{power}"
        for name, power in zip(names, row.tolist(), strict=True)
        if power
    ]
    return "·".join(parts) or "1"
