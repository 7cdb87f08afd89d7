"""Rigid-body parameters that motion identifies where no masses are known: grouped inertial parameters.

Of an arm's inertial parameters (60 of six joints) some have no effect and some act only together (Gautier
1990). A pivoted QR decomposition of the regressor of random motions finds a smallest set of columns that
span all others; each kept parameter then stands for itself plus a fixed combination of those left out.
Those that do not differ from zero in a given record are left out as well, the least significant first, as
long as any is: they would carry noise to other motions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from labhil.physics.arm.chain import Chain
from labhil.physics.arm.rigid_body import PER_LINK, upright
from labhil.signals import FloatArray

KINDS = (
    ("mass", "kg", "m"),
    ("first_moment_x", "kg·m", "mx"),
    ("first_moment_y", "kg·m", "my"),
    ("first_moment_z", "kg·m", "mz"),
    ("inertia_xx", "kg·m²", "xx"),
    ("inertia_yy", "kg·m²", "yy"),
    ("inertia_zz", "kg·m²", "zz"),
    ("inertia_xy", "kg·m²", "xy"),
    ("inertia_xz", "kg·m²", "xz"),
    ("inertia_yz", "kg·m²", "yz"),
)
"""Name, unit and symbol of a link's ten inertial parameters."""

PREFERRED = (6, 5, 4, 7, 8, 9, 1, 2, 3, 0)
"""Moments of inertia stand for a group before first moments, these before masses."""

POSES = 200
SMALLEST = 1e-8
SIGNIFICANT = 3.0
ROUNDS = 4
ALIKE = 1e-3
"""A column of which this share of its length is its own is a combination of others."""

FAINTEST = 1e-10
"""Of the largest eigenvalue of the scaled normal equations; less is unknown."""


@dataclass(frozen=True, slots=True)
class Grouped:
    """Columns of the regressor that stand for all: ``kept`` (P,), with each one's combination in words.

    ``shares`` (P, 60) are what a unit of every inertial parameter adds to each of them.
    """

    kept: tuple[int, ...]
    combinations: tuple[str, ...]
    shares: FloatArray

    def names(self) -> list[tuple[str, str, int]]:
        """Name, unit and link (from 0) of each."""
        entries = [(*KINDS[c % PER_LINK][:2], c // PER_LINK) for c in self.kept]
        return [(f"grouped_{name}", unit, link) for name, unit, link in entries]

    def column(self, name: str, link: int) -> int:
        """Place among the 60 inertial parameters of one of them by name and link."""
        kinds = [f"grouped_{kind}" for kind, _, _ in KINDS]
        return PER_LINK * link + kinds.index(name)

    def embed(self, values: FloatArray) -> FloatArray:
        """Inertial parameters (60,) that act like these ``values`` (P,), everything else zero."""
        out = np.zeros(self.shares.shape[1])
        out[list(self.kept)] = values
        return out

    def only(self, chosen: Sequence[int]) -> Grouped:
        """Those at the places ``chosen``."""
        combinations = tuple(self.combinations[i] for i in chosen)
        return Grouped(tuple(self.kept[i] for i in chosen), combinations, self.shares[list(chosen)])


def grouped(links: Chain, seed: int = 0) -> Grouped:
    """The smallest set for upright gravity; what links farther out add goes with those nearer to the base."""
    random, n = np.random.default_rng(seed), links.joints
    q = random.uniform(-np.pi, np.pi, (POSES, n))
    qd, qdd = random.normal(size=(2, POSES, n))
    columns = links.regressor(q, qd, 3.0 * qdd, upright()).reshape(-1, n * PER_LINK)
    kept: list[int] = []
    basis = np.empty((len(columns), 0))
    for c in (PER_LINK * link + c for link in range(n) for c in PREFERRED):
        rest = columns[:, c] - basis @ (basis.T @ columns[:, c])
        rest -= basis @ (basis.T @ rest)
        size = float(np.linalg.norm(rest))
        if size > SMALLEST * max(float(np.linalg.norm(columns[:, c])), 1.0):
            kept.append(c)
            basis = np.column_stack([basis, rest / size])
    kept.sort()
    share, *_ = linalg.lstsq(columns[:, kept], columns)
    return Grouped(tuple(kept), tuple(_combination(kept[i], share[i]) for i in range(len(kept))), share)


def _combination(kept: int, shares: FloatArray) -> str:
    """In words: the parameter itself and, with factors, those that act only together with it."""
    text = _symbol(kept)
    for c in np.flatnonzero(np.abs(shares) > 1e-6):
        if c == kept:
            continue
        factor = float(shares[c])
        size = "" if abs(abs(factor) - 1.0) < 1e-6 else f"{abs(factor):.4g}·"
        text += f" {'+' if factor > 0 else '−'} {size}{_symbol(int(c))}"
    return text


def _symbol(c: int) -> str:
    return f"{KINDS[c % PER_LINK][2]}_{c // PER_LINK}"


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """Least squares of currents on columns, joint by joint.

    ``gram`` XᵀX (6, P, P), ``moment`` Xᵀy (6, P), ``power`` yᵀy (6,), ``count`` of samples (6,).
    """

    gram: FloatArray
    moment: FloatArray
    power: FloatArray
    count: FloatArray

    @classmethod
    def of(cls, columns: FloatArray, measured: FloatArray, judged: np.ndarray) -> NormalEquations:
        """From columns (n, 6, P), currents (n, 6) and flags (n, 6) of the samples that count."""
        x = columns * judged[:, :, None]
        y = measured * judged
        return cls(
            np.stack([x[:, j].T @ x[:, j] for j in range(x.shape[1])]),
            np.einsum("njp,nj->jp", x, y),
            np.sum(y**2, axis=0),
            judged.sum(axis=0).astype(np.float64),
        )

    def solve(self, chosen: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Values and covariance of the chosen columns, each joint weighted by its own residuals' spread.

        What the data do not know at all comes out as zero with a huge variance.
        """
        at = np.ix_(range(len(self.gram)), chosen, chosen)
        count = np.maximum(self.count, 1.0)
        variances = np.maximum(self.power / count, 1e-12)
        for _ in range(ROUNDS):
            gram = np.einsum("jpq,j->pq", self.gram[at], 1.0 / variances)
            moment = np.einsum("jp,j->p", self.moment[:, chosen], 1.0 / variances)
            size = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
            strength, directions = np.linalg.eigh(gram / np.outer(size, size))
            known = strength > FAINTEST
            inverse = (directions / np.where(known, strength, np.inf)) @ directions.T
            unknown = (directions * np.where(known, 0.0, 1.0 / FAINTEST)) @ directions.T
            values = inverse @ (moment / size) / size
            covariance = (inverse + unknown) / np.outer(size, size)
            explained = 2.0 * self.moment[:, chosen] @ values - np.einsum(
                "jpq,p,q->j", self.gram[at], values, values
            )
            variances = np.maximum((self.power - explained) / count, 1e-12)
        return values, covariance


def independent(equations: NormalEquations, candidates: int) -> list[int]:
    """Columns of which none is a combination of the others in these data: the first ``candidates`` in order.

    All columns beyond those are kept. Where few joints move, many parameters act alike; those nearer to
    the base then stand for the others.
    """
    gram = np.einsum("jpq,j->pq", equations.gram, 1.0 / np.maximum(equations.power, 1e-12))
    size = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
    gram = gram / np.outer(size, size)
    chosen = list(range(candidates, len(gram)))
    for c in range(candidates):
        shares = np.linalg.lstsq(gram[np.ix_(chosen, chosen)], gram[chosen, c], rcond=FAINTEST)[0]
        if gram[c, c] - gram[c, chosen] @ shares > ALIKE**2:
            chosen.append(c)
    return sorted(chosen)


def significant(equations: NormalEquations, candidates: int, memory: float) -> list[int]:
    """Which of the first ``candidates`` columns differ from zero in these data.

    Of those that act alike one is left; then the least significant is taken out as long as it is under
    ``SIGNIFICANT`` standard errors. Variances are ``memory`` times those of white residuals.
    """
    chosen = independent(equations, candidates)
    while True:
        values, covariance = equations.solve(chosen)
        ratio = np.abs(values) / np.sqrt(memory * np.maximum(np.diag(covariance), 1e-300))
        removable = [i for i, c in enumerate(chosen) if c < candidates]
        weakest = min(removable, key=lambda i: ratio[i], default=None)
        if weakest is None or ratio[weakest] > SIGNIFICANT:
            return [chosen[i] for i in removable]
        del chosen[weakest]


def memory(residuals: FloatArray, least: float = 0.05) -> float:
    """By how much variances grow because residuals (n, …) remember their neighbours (first-order process).

    No more than the residuals of a process whose correlation is 1 − ``least``.
    """
    power = float(np.sum(residuals**2))
    rho = float(np.sum(residuals[1:] * residuals[:-1])) / max(power, 1e-300)
    return (1.0 + rho) / max(1.0 - rho, least) if rho > 0.0 else 1.0
