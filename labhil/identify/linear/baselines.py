"""The baselines by name, and the orders that are tried by default."""

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

FEWEST_SAMPLES = 60
HELD_OUT = 0.3
MOST_TO_CHOOSE = 10_000
"""Samples; of longer data a stretch around the held-out part's begin serves to choose orders."""
SHORTLIST = 3
BETTER = 0.99
"""A larger model is taken when its error on the held-out part is below that share of a smaller one's."""
DELAYS = (0, 1, 2, 4, 8)
"""Samples beyond the least that are tried as dead time."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """One kind of black box: how it is fitted, what it is, and the ``orders`` to choose among."""

    fit: Callable[[Sampled, Orders], LinearModel]
    description: str
    orders: tuple[Orders, ...]


def _orders(
    poles: tuple[int, ...], noise: tuple[int, ...] = (1,), degree: tuple[int, ...] = (2,)
) -> tuple[Orders, ...]:
    return tuple(
        Orders(p, k, m, degree=d) for p, m, d in product(poles, noise, degree) for k in sorted({1, p})
    )


def _square(poles: tuple[int, ...]) -> tuple[Orders, ...]:
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
    """Fit the baseline ``name`` to an input and an output (n,), sampled every ``period`` s.

    ``hold`` is what the input does between samples. Without ``orders`` they are chosen: each candidate
    is fitted to the first 70 % (of a stretch, where there are many samples), the three with the lowest
    Bayesian criterion run freely over the rest, and the smallest of the best is fitted to everything.
    Raises UnknownNameError, and RecordingError or ValueError for data or orders that cannot be used.
    """
    if name not in BASELINES:
        raise UnknownNameError("baseline", name, BASELINES)
    data = _check_data(u, y, period, hold)
    chosen = orders if orders is not None else choose_orders(name, data)
    return BASELINES[name].fit(data, chosen)


def choose_orders(name: str, data: Sampled) -> Orders:
    """The orders of the baseline ``name`` that the data support."""
    learn, judge = _split(data)
    delay = dead_time(learn)
    fitted = []
    for candidate in BASELINES[name].orders:
        orders = replace(candidate, delay=delay)
        if data.least_delay == 0 and name not in ("transfer_function", "state_space"):
            # an input that runs straight to the next sample moves the output there at once
            orders = replace(orders, inputs=orders.inputs + 1)
        model = BASELINES[name].fit(learn, orders)
        count = len(model.parameters)
        criterion = len(learn) * np.log(max(model.loss, 1e-300)) + count * np.log(len(learn))
        fitted.append((criterion, count, model))
    shortlist = sorted(fitted, key=lambda item: item[0])[:SHORTLIST]
    best: tuple[float, Orders] | None = None
    for _, _, model in sorted(shortlist, key=lambda item: item[1]):
        error = figures_of(judge.y, model.simulate(judge.u, judge.y)).rmse
        if best is None or error < BETTER * best[0]:
            best = error, model.orders
    return shortlist[0][2].orders if best is None else best[1]


def _split(data: Sampled) -> tuple[Sampled, Sampled]:
    """The part that candidates are fitted to and the part that they are judged on, of long data a stretch."""
    cut = round(len(data) * (1 - HELD_OUT))
    learn, judge = data.part(0, cut), data.part(cut, len(data))
    most = round(MOST_TO_CHOOSE * (1 - HELD_OUT))
    near = learn.part(max(cut - most, 0), cut), judge.part(0, MOST_TO_CHOOSE - most)
    return near if all(np.ptp(part.u) > 0 for part in near) else (learn, judge)


def dead_time(data: Sampled) -> int:
    """Samples of dead time beyond the least.

    By output-error models of second order; a longer one has to lower the error by a hundredth.
    """
    best = np.inf, 0
    for delay in DELAYS:
        orders = Orders(2, 3 - data.least_delay, delay=delay)
        losses = [simulation_loss(data, orders, f) for f in denominators(data, orders)]
        if min(losses) < BETTER**2 * best[0]:
            best = min(losses), delay
    return best[1]


def _check_data(u: FloatArray, y: FloatArray, period: float, hold: Hold) -> Sampled:
    u, y = np.asarray(u, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if u.ndim != 1 or u.shape != y.shape or len(u) < FEWEST_SAMPLES:
        raise RecordingError(
            f"a baseline needs one input and one output with the same {FEWEST_SAMPLES} samples or more, "
            f"found {u.shape} and {y.shape}"
        )
    if not (np.isfinite(u).all() and np.isfinite(y).all() and 0 < period < np.inf):
        raise RecordingError("a baseline needs finite samples and a positive period")
    if np.ptp(u) == 0:
        raise RecordingError("a baseline needs an input that changes; this one is constant")
    return Sampled(u, y, period, hold)
