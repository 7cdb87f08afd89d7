"""What a baseline is fitted to, what it offers, and how it is judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from labhil.signals import FloatArray, Hold

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class Sampled:
    """One input ``u`` and one output ``y``, both (n,), every ``period`` s; ``hold`` is the input's."""

    u: FloatArray
    y: FloatArray
    period: float
    hold: Hold = Hold.ZERO

    def __len__(self) -> int:
        return len(self.y)

    @property
    def least_delay(self) -> int:
        """Samples from the input to the first output that it can move: 1 when held, else 0."""
        return 1 if self.hold is Hold.ZERO else 0

    def part(self, first: int, last: int) -> Sampled:
        """The samples first … last − 1."""
        return Sampled(self.u[first:last], self.y[first:last], self.period, self.hold)


@dataclass(frozen=True, slots=True)
class Orders:
    """How large a baseline is.

    ``poles`` of the way from input to output (NARX: delayed outputs), ``inputs`` coefficients of its
    numerator (a transfer function has one zero less; NARX: delayed inputs), ``noise`` coefficients of
    each polynomial of the noise, ``delay`` samples of dead time beyond the least (an input that is held
    moves the next output, one that runs straight moves the output at once), ``degree`` of a
    nonlinearity: the bends of Hammerstein-Wiener's lines, the highest power of NARX.
    """

    poles: int = 2
    inputs: int = 2
    noise: int = 1
    delay: int = 0
    degree: int = 2

    def __post_init__(self) -> None:
        least = {"poles": 1, "inputs": 1, "noise": 0, "delay": 0, "degree": 1}
        for name, smallest in least.items():
            if getattr(self, name) < smallest:
                raise ValueError(f"{name} must be {smallest} at least, found {getattr(self, name)}")


class LinearModel(Protocol):
    """A fitted baseline."""

    @property
    def name(self) -> str:
        """Its name among the baselines."""
        ...

    @property
    def orders(self) -> Orders:
        """How large it is."""
        ...

    @property
    def loss(self) -> float:
        """Mean square of what its fit made small (prediction or simulation error), unit²."""
        ...

    @property
    def parameters(self) -> Mapping[str, float]:
        """Its coefficients by name."""
        ...

    @property
    def poles(self) -> ComplexArray:
        """Poles from input to output in continuous time, rad/s; empty where there are none to speak of."""
        ...

    def simulate(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """Output (n,) of a free run over the input (n,): nothing measured is fed back.

        ``start`` are measured outputs, from the first sample on, that the state at the first sample is
        made to suit by least squares; without them the run begins at rest.
        """
        ...

    def describe(self) -> str:
        """The model as an equation, for a person."""
        ...


@dataclass(frozen=True, slots=True)
class Figures:
    """Errors of a free run: ``mse`` in unit², ``rmse`` and ``max_abs_error`` in unit, ``r2`` a fraction.

    A run that leaves all bounds has infinite errors and an ``r2`` of −inf.
    """

    mse: float
    rmse: float
    r2: float
    max_abs_error: float


def figures_of(measured: FloatArray, simulated: FloatArray) -> Figures:
    """Compare a simulated output (n,) with the measured one; R² = 1 − SSE/SST."""
    if not np.isfinite(simulated).all():
        return Figures(np.inf, np.inf, -np.inf, np.inf)
    error = simulated - measured
    mse = float(np.mean(np.square(error)))
    spread = float(np.var(measured))
    r2 = 1.0 - mse / spread if spread > 0 else float("nan")
    return Figures(mse, float(np.sqrt(mse)), r2, float(np.max(np.abs(error))))
