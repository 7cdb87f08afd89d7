"""State-space models by subspace identification: x(t+1) = A·x + B·u, y = C·x + D·u + offset.

The pair (A, C) comes from the oblique projection of future outputs along future inputs on the past (N4SID:
Van Overschee and De Moor 1994). B, D, the offset and the initial state then follow from linear least squares
on the simulated output, which is more accurate than their estimates from the subspace.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import signal

from labhil.identify.linear.data import ComplexArray, Orders, Sampled
from labhil.identify.linear.filters import MAX_REFLECTION, continuous_poles, delayed, regress
from labhil.signals import FloatArray

MAX_REAL_POLE_IMAG = 1e-12
"""Imaginary part up to which a pole counts as real (rounding)."""

PSEUDOINVERSE_TOLERANCE = 1e-10
"""Singular values below this share of the largest count as zero."""


@dataclass(frozen=True, slots=True)
class StateSpaceModel:
    """Matrices ``a`` (k, k), ``b`` (k,), ``c`` (k,), ``d``; ``offset`` of the output; discrete time."""

    orders: Orders
    period: float
    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: float
    offset: float
    loss: float
    name: str = "state_space"

    @property
    def parameters(self) -> Mapping[str, float]:
        """Elements of the matrices: a11 …, b1 …, c1 …, d, offset."""
        k = len(self.b)
        coefficients = {f"a{i + 1}{j + 1}": float(self.a[i, j]) for i in range(k) for j in range(k)}
        coefficients |= {f"b{i + 1}": float(v) for i, v in enumerate(self.b)}
        coefficients |= {f"c{i + 1}": float(v) for i, v in enumerate(self.c)}
        return {**coefficients, "d": self.d, "offset": self.offset}

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues in continuous time, rad/s."""
        return continuous_poles(np.linalg.eigvals(self.a), self.period)

    def simulate(self, u: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """Simulate over the input (n,), from rest or the state that fits ``start`` best."""
        poles, vectors = np.linalg.eig(self.a)
        residues = (self.c @ vectors) * np.linalg.solve(vectors, self.b.astype(np.complex128))
        u = delayed(u, self.orders.delay)
        y = self.d * u + self.offset
        for pole, residue in zip(poles, residues, strict=True):
            y = y + (residue * signal.lfilter([0.0, 1.0], [1.0, -pole], u)).real
        if start is None or not len(start):
            return np.asarray(y)
        free = _free_responses(poles, len(u))
        m = min(len(start), len(u))
        return np.asarray(y + free @ regress(free[:m], start[:m] - y[:m])[0])

    def describe(self) -> str:
        """The matrices, row by row."""
        rows = "; ".join(" ".join(f"{v:.6g}" for v in row) for row in self.a.tolist())
        b, c = (" ".join(f"{v:.6g}" for v in m.tolist()) for m in (self.b, self.c))
        return (
            f"x⁺ = [{rows}]·x + [{b}]·u, y = [{c}]·x + {self.d:.6g}·u + {self.offset:.6g}, "
            f"T = {self.period:g} s"
        )


def fit_state_space(data: Sampled, orders: Orders) -> StateSpaceModel:
    """Fit a model of ``orders.poles`` states; D is zero for a held input.

    Raises:
        ValueError: There are too few samples for that order.
    """
    u = delayed(data.u, orders.delay)
    a, c = _observable_pair(u, data.y, orders.poles)
    poles, vectors = np.linalg.eig(a)
    size = np.abs(poles)
    reflected = poles / np.maximum(size, 1e-300) ** 2 * MAX_REFLECTION
    poles = np.where(size >= MAX_REFLECTION, reflected, poles)
    a = (vectors @ np.diag(poles) @ np.linalg.inv(vectors)).real
    n = len(data)
    direct = [u] if data.least_delay == 0 else []
    forced = _forced_responses(poles, u)
    columns = np.column_stack((forced, *direct, np.ones(n), _free_responses(poles, n)))
    coefficients, residuals = regress(columns, data.y)
    k = len(poles)
    b = _input_matrix(poles, vectors, c, coefficients[:k])
    d = float(coefficients[k]) if direct else 0.0
    return StateSpaceModel(
        orders,
        data.period,
        a,
        b,
        c,
        d,
        float(coefficients[k + len(direct)]),
        float(np.mean(np.square(residuals))),
    )


def _observable_pair(
    inputs: FloatArray,
    outputs: FloatArray,
    order: int,
    *,
    min_block_rows: int = 10,
    max_block_rows: int = 40,
) -> tuple[FloatArray, FloatArray]:
    """Estimate A and C from the column space of the oblique projection."""
    n = len(outputs)
    rows = min(max_block_rows, max(min_block_rows, 3 * order), n // 8)
    if rows <= order + 1:
        raise ValueError(f"{order} states need {8 * (order + 2)} samples at least, found {n}")
    rows = min(max_block_rows, n // 8) if n > 8 * max_block_rows else rows
    u = sliding_window_view(inputs - inputs.mean(), 2 * rows)
    y = sliding_window_view(outputs - outputs.mean(), 2 * rows)
    # a constant is projected out with the future inputs, so that an offset does not look like a state
    stacked = np.hstack((np.ones((len(u), 1)), u[:, rows:], u[:, :rows], y[:, :rows], y[:, rows:]))
    lower = np.asarray(np.linalg.qr(stacked, mode="r")).T
    past, future = slice(rows + 1, 3 * rows + 1), slice(3 * rows + 1, None)
    inverse = np.linalg.pinv(lower[past, past], rcond=PSEUDOINVERSE_TOLERANCE)
    oblique = lower[future, past] @ inverse @ lower[past, : 3 * rows + 1]
    left, sizes, _ = np.linalg.svd(oblique, full_matrices=False)
    observability = left[:, :order] * np.sqrt(sizes[:order])
    a = np.linalg.lstsq(observability[:-1], observability[1:], rcond=None)[0]
    return a, observability[0]


def _forced_responses(poles: ComplexArray, u: FloatArray) -> FloatArray:
    """Real responses of the modes to the input, (n, k): one of a real pole, two of a complex pair."""
    return _real_parts(poles, [signal.lfilter([0.0, 1.0], [1.0, -pole], u) for pole in poles])


def _free_responses(poles: ComplexArray, n: int) -> FloatArray:
    """Real free responses of the modes, (n, k)."""
    return _real_parts(poles, [pole ** np.arange(n) for pole in poles])


def _real_parts(poles: ComplexArray, responses: list[ComplexArray]) -> FloatArray:
    """Real columns (n, k): the imaginary part for the second pole of a pair, else the real part."""
    return np.column_stack(
        [
            response.imag if pole.imag < -MAX_REAL_POLE_IMAG else response.real
            for pole, response in zip(poles, responses, strict=True)
        ]
    )


def _input_matrix(poles: ComplexArray, vectors: ComplexArray, c: FloatArray, parts: FloatArray) -> FloatArray:
    """B from the coefficients of the real responses: residues are (C·v)·(v⁻¹·B), mode by mode."""
    residues = np.zeros(len(poles), dtype=np.complex128)
    for i, pole in enumerate(poles):
        if abs(pole.imag) <= MAX_REAL_POLE_IMAG:
            residues[i] = parts[i]
        elif pole.imag > 0:
            j = int(np.argmin(np.abs(poles - pole.conjugate())))
            # p·Re h + s·Im h = Re[(p − i·s)·h], and that of the conjugate is h's own conjugate
            residues[i] = (parts[i] + 1j * parts[j]) / 2
            residues[j] = residues[i].conjugate()
    return np.asarray((vectors @ (residues / (c @ vectors))).real)
