"""The baselines by name, and the choice of their orders on held-out data.

Theory of the models: Ljung, System Identification, 1999.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from labhil.errors import RecordingError, UnknownNameError
from labhil.identify.linear.blocks import fit_hammerstein_wiener
from labhil.identify.linear.data import LinearModel, Orders, Sampled, figures_of
from labhil.identify.linear.narx import fit_narx
from labhil.identify.linear.polynomial import (
    denominators,
    fit_armax,
    fit_arx,
    fit_box_jenkins,
    fit_oe,
    simulation_loss,
)
from labhil.identify.linear.state_space import fit_state_space
from labhil.identify.linear.transfer_function import fit_transfer_function
from labhil.signals import FloatArray, Hold

MAX_ERROR_RATIO = 0.99
"""Error of a larger model, or of a longer dead time, over the smaller one's, below which it is taken."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """One kind of black-box model.

    Attributes:
        fit: Fits it with given orders.
        description: What it is, as text.
        orders: Candidates among which the data decide.
    """

    fit: Callable[[Sampled, Orders], LinearModel]
    description: str
    orders: tuple[Orders, ...]


def _orders(
    poles: tuple[int, ...], noise: tuple[int, ...] = (1,), degree: tuple[int, ...] = (2,)
) -> tuple[Orders, ...]:
    """All combinations, each with one coefficient of the input and with as many as poles."""
    return tuple(
        Orders(p, k, m, degree=d) for p, m, d in product(poles, noise, degree) for k in sorted({1, p})
    )


def _square(poles: tuple[int, ...]) -> tuple[Orders, ...]:
    """Orders with as many coefficients of the input as poles."""
    return tuple(Orders(p, p) for p in poles)


BASELINES: Mapping[str, Baseline] = {
    "transfer_function": Baseline(
        fit_transfer_function, "transfer function in continuous time, by output error", _orders((1, 2, 3))
    ),
    "state_space": Baseline(
        fit_state_space, "state space, by a subspace method (N4SID)", _square((1, 2, 3, 4, 6))
    ),
    "arx": Baseline(fit_arx, "ARX, by linear least squares", _orders((1, 2, 3, 4, 6, 8))),
    "armax": Baseline(fit_armax, "ARMAX, by prediction error", _orders((1, 2, 3), noise=(1, 2))),
    "oe": Baseline(fit_oe, "output error", _orders((1, 2, 3, 4))),
    "box_jenkins": Baseline(fit_box_jenkins, "Box-Jenkins, by prediction error", _orders((1, 2, 3))),
    "hammerstein_wiener": Baseline(
        fit_hammerstein_wiener,
        "bent lines before and after an output-error model",
        tuple(Orders(p, p, degree=d) for p, d in product((1, 2, 3), (2, 4))),
    ),
    "narx": Baseline(
        fit_narx,
        "polynomial NARX, terms by forward regression, coefficients on the free run",
        tuple(Orders(p, p, degree=d) for p, d in product((1, 2, 3), (2, 3))),
    ),
}
"""All baselines by name."""


def fit_linear(
    name: str,
    u: FloatArray,
    y: FloatArray,
    period: float,
    orders: Orders | None = None,
    hold: Hold = Hold.ZERO,
) -> LinearModel:
    """Fit a baseline to an input and an output.

    Args:
        name: One of BASELINES.
        u: (n,) input.
        y: (n,) output.
        period: Sampling period, s.
        orders: How large the model is; by default :func:`choose_orders`.
        hold: What the input does between samples.

    Raises:
        UnknownNameError: There is no such baseline.
        RecordingError: The data cannot be used: too few samples, a constant input, values that are not
            finite.
        ValueError: The orders cannot be used with these data.
    """
    if name not in BASELINES:
        raise UnknownNameError("baseline", name, BASELINES)
    data = _check_data(u, y, period, hold)
    chosen = orders if orders is not None else choose_orders(name, data)
    return BASELINES[name].fit(data, chosen)


def choose_orders(
    name: str,
    data: Sampled,
    *,
    shortlist: int = 3,
    max_error_ratio: float = MAX_ERROR_RATIO,
) -> Orders:
    """Choose the orders of a baseline by the Bayesian information criterion and held-out data.

    Candidates are fitted to the first 70 % of the data. Those with the lowest criterion are simulated freely
    over the rest, from the smallest to the largest.

    Args:
        name: Of the baseline.
        data: Input and output.
        shortlist: Number of candidates that are simulated over the held-out data.
        max_error_ratio: RMSE there over that of the best smaller candidate, below which a larger one is
            taken.
    """
    train, test = _split(data)
    delay = dead_time(train)
    fitted = []
    for candidate in BASELINES[name].orders:
        orders = replace(candidate, delay=delay)
        if data.least_delay == 0 and name not in ("transfer_function", "state_space"):
            # an input that runs straight to the next sample moves the output there at once
            orders = replace(orders, inputs=orders.inputs + 1)
        model = BASELINES[name].fit(train, orders)
        count = len(model.parameters)
        criterion = len(train) * np.log(max(model.loss, 1e-300)) + count * np.log(len(train))
        fitted.append((criterion, count, model))
    finalists = sorted(fitted, key=lambda item: item[0])[:shortlist]
    best: tuple[float, Orders] | None = None
    for _, _, model in sorted(finalists, key=lambda item: item[1]):
        error = figures_of(test.y, model.simulate(test.u, test.y)).rmse
        if best is None or error < max_error_ratio * best[0]:
            best = error, model.orders
    return finalists[0][2].orders if best is None else best[1]


def _split(data: Sampled, *, test_share: float = 0.3, max_samples: int = 10_000) -> tuple[Sampled, Sampled]:
    """Training and test data; of long data only ``max_samples`` around the cut, where the input changes."""
    cut = round(len(data) * (1 - test_share))
    train, test = data.part(0, cut), data.part(cut, len(data))
    most = round(max_samples * (1 - test_share))
    near = train.part(max(cut - most, 0), cut), test.part(0, max_samples - most)
    return near if all(np.ptp(part.u) > 0 for part in near) else (train, test)


def dead_time(
    data: Sampled,
    *,
    candidates: tuple[int, ...] = (0, 1, 2, 4, 8),
    max_error_ratio: float = MAX_ERROR_RATIO,
) -> int:
    """Estimate the dead time with output-error models of second order.

    Args:
        data: Input and output.
        candidates: Dead times in samples, beyond the least one that the hold implies.
        max_error_ratio: RMSE over that of the best shorter dead time, below which a longer one is taken.

    Returns:
        Samples beyond the least.
    """
    best = np.inf, 0
    for delay in candidates:
        orders = Orders(2, 3 - data.least_delay, delay=delay)
        losses = [simulation_loss(data, orders, f) for f in denominators(data, orders)]
        if min(losses) < max_error_ratio**2 * best[0]:
            best = min(losses), delay
    return best[1]


def _check_data(u: FloatArray, y: FloatArray, period: float, hold: Hold, *, min_samples: int = 60) -> Sampled:
    """The data, or RecordingError where a baseline cannot be fitted to them."""
    u, y = np.asarray(u, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if u.ndim != 1 or u.shape != y.shape or len(u) < min_samples:
        raise RecordingError(
            f"a baseline needs one input and one output with the same {min_samples} samples or more, "
            f"found {u.shape} and {y.shape}"
        )
    if not (np.isfinite(u).all() and np.isfinite(y).all() and 0 < period < np.inf):
        raise RecordingError("a baseline needs finite samples and a positive period")
    if np.ptp(u) == 0:
        raise RecordingError("a baseline needs an input that changes; this one is constant")
    return Sampled(u, y, period, hold)
