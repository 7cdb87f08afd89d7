"""Base (grouped) inertial parameters of an arm: the combinations that motion identifies (Gautier 1990).

Of the inertial parameters (60 for six joints) some have no effect and some act only together. Orthogonalising
the regressor of random motions column by column gives a smallest set of columns that span all others; each
kept parameter stands for itself plus a fixed combination of those left out. Parameters that do not differ
significantly from zero in a record are removed too, the least significant first: they would add noise to
predictions of other motions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from labhil.physics.arm.chain import Chain
from labhil.physics.arm.rigid_body import PER_LINK, gravity_in_base
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
"""Order in which parameters represent a group: moments of inertia, first moments, mass."""

MIN_EIGENVALUE = 1e-10
"""Least identified eigenvalue of the scaled normal equations, near rounding."""


@dataclass(frozen=True, slots=True)
class Grouped:
    """Columns ``kept`` (P,) of the regressor that span all others.

    ``combinations`` (P,) are the combinations in words; ``shares`` (P, 60) is the contribution of a unit of
    each inertial parameter to each grouped one.
    """

    kept: tuple[int, ...]
    combinations: tuple[str, ...]
    shares: FloatArray

    def names(self) -> list[tuple[str, str, int]]:
        """Name, unit and link (from 0) of each grouped parameter."""
        entries = [(*KINDS[c % PER_LINK][:2], c // PER_LINK) for c in self.kept]
        return [(f"grouped_{name}", unit, link) for name, unit, link in entries]

    def column(self, name: str, link: int) -> int:
        """Index among the 60 inertial parameters by name and link."""
        kinds = [f"grouped_{kind}" for kind, _, _ in KINDS]
        return PER_LINK * link + kinds.index(name)

    def embed(self, values: FloatArray) -> FloatArray:
        """Inertial parameters (60,) equivalent to grouped ``values`` (P,), with zeros elsewhere."""
        out = np.zeros(self.shares.shape[1])
        out[list(self.kept)] = values
        return out

    def only(self, chosen: Sequence[int]) -> Grouped:
        """Select grouped parameters by index."""
        combinations = tuple(self.combinations[i] for i in chosen)
        return Grouped(tuple(self.kept[i] for i in chosen), combinations, self.shares[list(chosen)])


def group_parameters(links: Chain, seed: int = 0, *, poses: int = 200, tolerance: float = 1e-8) -> Grouped:
    """Find the grouped parameters of an arm on an upright base.

    Parameters of links near the base represent those of links farther out.

    Args:
        links: The rigid bodies.
        seed: Seed of the random motion.
        poses: Number of random poses.
        tolerance: Relative length of a column's independent part below which it depends on others.

    Returns:
        The grouped parameters.
    """
    random, n = np.random.default_rng(seed), links.joints
    q = random.uniform(-np.pi, np.pi, (poses, n))
    qd, qdd = random.normal(size=(2, poses, n))
    columns = links.regressor(q, qd, 3.0 * qdd, gravity_in_base()).reshape(-1, n * PER_LINK)
    kept: list[int] = []
    basis = np.empty((len(columns), 0))
    for c in (PER_LINK * link + c for link in range(n) for c in PREFERRED):
        rest = columns[:, c] - basis @ (basis.T @ columns[:, c])
        rest -= basis @ (basis.T @ rest)
        size = float(np.linalg.norm(rest))
        if size > tolerance * max(float(np.linalg.norm(columns[:, c])), 1.0):
            kept.append(c)
            basis = np.column_stack([basis, rest / size])
    kept.sort()
    share, *_ = linalg.lstsq(columns[:, kept], columns)
    return Grouped(tuple(kept), tuple(_combination(kept[i], share[i]) for i in range(len(kept))), share)


def _combination(kept: int, shares: FloatArray) -> str:
    """Combination in words: the parameter and, with factors, those that act only together with it."""
    text = _symbol(kept)
    for c in np.flatnonzero(np.abs(shares) > 1e-6):
        if c == kept:
            continue
        factor = float(shares[c])
        size = "" if abs(abs(factor) - 1.0) < 1e-6 else f"{abs(factor):.4g}·"
        text += f" {'+' if factor > 0 else '−'} {size}{_symbol(int(c))}"
    return text


def _symbol(c: int) -> str:
    """Symbol of an inertial parameter with its link."""
    return f"{KINDS[c % PER_LINK][2]}_{c // PER_LINK}"


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """Normal equations of the least squares of currents on columns, joint by joint.

    ``gram`` is XᵀX (6, P, P), ``moment`` Xᵀy (6, P), ``power`` yᵀy (6,) and ``count`` the samples (6,).
    """

    gram: FloatArray
    moment: FloatArray
    power: FloatArray
    count: FloatArray

    @classmethod
    def of(cls, columns: FloatArray, measured: FloatArray, judged: np.ndarray) -> NormalEquations:
        """Compute them from columns (n, 6, P), currents (n, 6) and flags (n, 6) of the samples that count."""
        x = columns * judged[:, :, None]
        y = measured * judged
        return cls(
            np.stack([x[:, j].T @ x[:, j] for j in range(x.shape[1])]),
            np.einsum("njp,nj->jp", x, y),
            np.sum(y**2, axis=0),
            judged.sum(axis=0).astype(np.float64),
        )

    def solve(self, chosen: Sequence[int], *, iterations: int = 4) -> tuple[FloatArray, FloatArray]:
        """Solve for the chosen columns by iteratively reweighted least squares.

        Joints are weighted by the inverse variance of their residuals. Directions that the data do not
        identify get zero with a very large variance.

        Args:
            chosen: Columns.
            iterations: Iterations of the weights.

        Returns:
            Values (p,) and covariance (p, p).
        """
        at = np.ix_(range(len(self.gram)), chosen, chosen)
        count = np.maximum(self.count, 1.0)
        variances = np.maximum(self.power / count, 1e-12)
        for _ in range(iterations):
            gram = np.einsum("jpq,j->pq", self.gram[at], 1.0 / variances)
            moment = np.einsum("jp,j->p", self.moment[:, chosen], 1.0 / variances)
            size = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
            strength, directions = np.linalg.eigh(gram / np.outer(size, size))
            known = strength > MIN_EIGENVALUE
            inverse = (directions / np.where(known, strength, np.inf)) @ directions.T
            unknown = (directions * np.where(known, 0.0, 1.0 / MIN_EIGENVALUE)) @ directions.T
            values = inverse @ (moment / size) / size
            covariance = (inverse + unknown) / np.outer(size, size)
            explained = 2.0 * self.moment[:, chosen] @ values - np.einsum(
                "jpq,p,q->j", self.gram[at], values, values
            )
            variances = np.maximum((self.power - explained) / count, 1e-12)
        return values, covariance


def select_independent(
    equations: NormalEquations, candidates: int, *, min_own_share: float = 1e-3
) -> list[int]:
    """Select linearly independent columns among the first ``candidates``, in order; keep all others.

    Where few joints move, many parameters are collinear; those nearer to the base are kept.

    Args:
        equations: The normal equations.
        candidates: Number of columns that may be dropped.
        min_own_share: Least length of a column's independent part over its length.

    Returns:
        The selected columns, sorted.
    """
    gram = np.einsum("jpq,j->pq", equations.gram, 1.0 / np.maximum(equations.power, 1e-12))
    size = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
    gram = gram / np.outer(size, size)
    chosen = list(range(candidates, len(gram)))
    for c in range(candidates):
        shares = np.linalg.lstsq(gram[np.ix_(chosen, chosen)], gram[chosen, c], rcond=MIN_EIGENVALUE)[0]
        if gram[c, c] - gram[c, chosen] @ shares > min_own_share**2:
            chosen.append(c)
    return sorted(chosen)


def select_significant(
    equations: NormalEquations, candidates: int, inflation: float, *, min_t_ratio: float = 3.0
) -> list[int]:
    """Select the columns among the first ``candidates`` that differ significantly from zero.

    Collinear columns are dropped first; then the least significant one is removed repeatedly.

    Args:
        equations: The normal equations.
        candidates: Number of columns that may be dropped.
        inflation: Variances over those of white residuals (:func:`variance_inflation`).
        min_t_ratio: Least value over standard error of a column that is kept.

    Returns:
        The selected candidates.
    """
    chosen = select_independent(equations, candidates)
    while True:
        values, covariance = equations.solve(chosen)
        ratio = np.abs(values) / np.sqrt(inflation * np.maximum(np.diag(covariance), 1e-300))
        removable = [i for i, c in enumerate(chosen) if c < candidates]
        weakest = min(removable, key=lambda i: ratio[i], default=None)
        if weakest is None or ratio[weakest] > min_t_ratio:
            return [chosen[i] for i in removable]
        del chosen[weakest]


def variance_inflation(residuals: FloatArray, least: float = 0.05) -> float:
    """Variance inflation (1 + ρ)/(1 − ρ) by residuals (n, …) of correlation ρ at lag 1 (AR(1) process).

    1 − ρ is taken as ``least`` at least.
    """
    power = float(np.sum(residuals**2))
    rho = float(np.sum(residuals[1:] * residuals[:-1])) / max(power, 1e-300)
    return (1.0 + rho) / max(1.0 - rho, least) if rho > 0.0 else 1.0
