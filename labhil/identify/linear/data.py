"""Data, orders and results of the baselines, and the figures by which they are compared."""

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
    """An evenly sampled input and output.

    Attributes:
        u: (n,) input.
        y: (n,) output.
        period: Sampling period, s.
        hold: What the input does between samples.
    """

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
    """Orders of a baseline.

    Attributes:
        poles: From input to output; of NARX the number of delayed outputs.
        inputs: Coefficients of the numerator (a transfer function has one zero less); of NARX the number of
            delayed inputs.
        noise: Coefficients of each polynomial of the noise model.
        delay: Dead time in samples beyond the least: a held input acts on the next output, one that runs
            straight from sample to sample acts on the output at once.
        degree: Of a nonlinearity: number of bends of Hammerstein-Wiener, highest power of NARX.
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
        """Its orders."""
        ...

    @property
    def loss(self) -> float:
        """Mean square of the error that its fit minimises (prediction or simulation error), unit²."""
        ...

    @property
    def parameters(self) -> Mapping[str, float]:
        """Its coefficients by name."""
        ...

    @property
    def poles(self) -> ComplexArray:
        """Poles from input to output in continuous time, rad/s; empty of a nonlinear model without any."""
        ...

    def simulate(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """Simulate freely: no measured output is fed back.

        Args:
            u: (n,) input.
            start: Measured outputs from the first sample on, to which the initial state is fitted by least
                squares; without them the simulation starts at rest.

        Returns:
            (n,) output.
        """
        ...

    def describe(self) -> str:
        """The model as an equation, as text."""
        ...


@dataclass(frozen=True, slots=True)
class Figures:
    """Errors of a free-run simulation; one that diverges has infinite errors and an ``r2`` of −inf.

    Attributes:
        mse: Mean squared error, unit².
        rmse: Its root, unit.
        r2: 1 − SSE/SST, a fraction.
        max_abs_error: Largest absolute error, unit.
    """

    mse: float
    rmse: float
    r2: float
    max_abs_error: float


def figures_of(measured: FloatArray, simulated: FloatArray) -> Figures:
    """Compare a simulated output (n,) with the measured one (n,)."""
    if not np.isfinite(simulated).all():
        return Figures(np.inf, np.inf, -np.inf, np.inf)
    error = simulated - measured
    mse = float(np.mean(np.square(error)))
    spread = float(np.var(measured))
    r2 = 1.0 - mse / spread if spread > 0 else float("nan")
    return Figures(mse, float(np.sqrt(mse)), r2, float(np.max(np.abs(error))))
