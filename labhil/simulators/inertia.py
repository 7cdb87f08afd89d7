"""Inertial parameters that bodies could have, near given ones, and that load the joints as estimated ones.

Only combinations of a link's ten parameters can be estimated; what a file holds are all of them, and MuJoCo
takes those only that a body could have. A body's are those whose pseudo-inertia J = [[Σ, h], [hᵀ, m]] is
positive, where h is mass times centre and Σ = ½ tr(I)·1 − I (Wensing, Kim and Slotine 2018).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from labhil.physics.arm.chain import Chain
from labhil.physics.arm.grouped import grouped
from labhil.physics.arm.rigid_body import PER_LINK, upright
from labhil.signals import FloatArray

REACH = 0.1
"""m; changes of first and second moments are weighed as those of the mass at this distance."""

LIGHTEST = 0.05
"""kg; a link that has less is weighed as if it had that."""

EXACT = 1e-4
"""Share of the typical torque by which the joints' loads may be missed where bodies need it."""

THIN = 1e-9
MOTIONS = 100


def pseudo_inertia(pi: FloatArray) -> FloatArray:
    """The matrix (4, 4) of ten inertial parameters."""
    m, hx, hy, hz, xx, yy, zz, xy, xz, yz = pi
    i = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    out = np.empty((4, 4))
    out[:3, :3] = 0.5 * np.trace(i) * np.eye(3) - i
    out[:3, 3] = out[3, :3] = hx, hy, hz
    out[3, 3] = m
    return out


def parameters_of(j: FloatArray) -> FloatArray:
    """Ten inertial parameters of a pseudo-inertia (4, 4)."""
    sigma = j[:3, :3]
    i = np.trace(sigma) * np.eye(3) - sigma
    return np.array([j[3, 3], *j[:3, 3], i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])


def is_body(pi: FloatArray) -> bool:
    """Whether a body may have these inertial parameters."""
    values = np.linalg.eigvalsh(pseudo_inertia(pi))
    return bool(values[0] > -THIN * max(values[-1], THIN))


def realised(chain: Chain, begin: FloatArray, wanted: FloatArray, rest: FloatArray) -> FloatArray:
    """Inertial parameters of bodies that load the joints as wanted ones do.

    Args:
        chain: The arm.
        begin: What its bodies have, (10 n,).
        wanted: What they are to act like, with ``rest``, (10 n,).
        rest: What else moves with each link and stays as it is, (10 n,).

    Returns:
        The nearest parameters to ``begin`` (10 n,); those of a link that need no change are unchanged.
    """
    own = grouped(chain)
    size = _sizes(begin)
    change = wanted - rest - begin
    load = own.shares @ change
    if np.all(np.abs(load) <= 1e-12 * np.maximum(np.abs(own.shares) @ size, 1e-12)):
        return begin
    weighed = own.shares * size
    least = size * np.linalg.lstsq(weighed, load, rcond=1e-10)[0]
    least[np.abs(least) < 1e-9 * size] = 0.0
    found = begin + least
    links = found.reshape(-1, PER_LINK)
    if all(is_body(link) for link in links):
        return np.asarray(found)
    return _nearest_bodies(chain, begin, own.shares, own.shares @ (begin + change), size)


def _sizes(begin: FloatArray) -> FloatArray:
    """What a usual change of each parameter is, (10 n,)."""
    mass = np.maximum(begin[::PER_LINK], LIGHTEST)
    one = np.array([1.0, *[REACH] * 3, *[REACH**2] * 6])
    return np.asarray((mass[:, None] * one).ravel())


def _nearest_bodies(
    chain: Chain, begin: FloatArray, shares: FloatArray, load: FloatArray, size: FloatArray
) -> FloatArray:
    """By Cholesky factors of the pseudo-inertias, with which every point is a body."""
    random, n = np.random.default_rng(0), chain.joints
    q = random.uniform(-np.pi, np.pi, (MOTIONS, n))
    qd, qdd = random.normal(size=(2, MOTIONS, n))
    columns = chain.regressor(q, qd, qdd, upright()).reshape(-1, n * PER_LINK)
    torque = float(np.sqrt(np.mean((columns @ begin) ** 2)))
    # a change of what can be estimated is weighed by the torque that it makes
    loads = np.linalg.lstsq(shares.T, columns.T, rcond=1e-10)[0]
    r = np.linalg.qr(loads.T / (EXACT * torque * np.sqrt(len(columns))), mode="r")
    lower = np.tril_indices(4)

    def bodies(z: FloatArray) -> FloatArray:
        out = np.empty((n, PER_LINK))
        for link, own in enumerate(z.reshape(n, -1)):
            factor = np.zeros((4, 4))
            factor[lower] = own
            out[link] = parameters_of(factor @ factor.T)
        return out.ravel()

    def residuals(z: FloatArray) -> FloatArray:
        pi = bodies(z)
        return np.concatenate([r @ (shares @ pi - load), (pi - begin) / size])

    start = np.concatenate([_factor(link)[lower] for link in begin.reshape(n, PER_LINK)])
    return np.asarray(bodies(least_squares(residuals, start, x_scale="jac", max_nfev=200).x))


def _factor(pi: FloatArray) -> FloatArray:
    """Cholesky factor of a pseudo-inertia, of a thin body that of a slightly thicker one."""
    values, axes = np.linalg.eigh(pseudo_inertia(pi))
    thick = np.maximum(values, 1e-6 * max(float(values[-1]), 1e-6))
    return np.asarray(np.linalg.cholesky((axes * thick) @ axes.T))


def at_centre(pi: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Mass (kg), centre (3,) m and inertia (3, 3) at the centre, kg·m², of ten inertial parameters."""
    m, hx, hy, hz, xx, yy, zz, xy, xz, yz = pi
    centre = np.array([hx, hy, hz]) / m
    i = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return float(m), centre, np.asarray(i - m * (centre @ centre * np.eye(3) - np.outer(centre, centre)))
