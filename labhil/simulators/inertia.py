"""Find physically consistent inertial parameters that load the joints like estimated ones.

Only combinations of a link's ten parameters can be estimated; a file needs all of them, and MuJoCo accepts
only consistent ones: those with a positive definite pseudo-inertia J = [[Σ, h], [hᵀ, m]], where h is mass
times centre and Σ = ½ tr(I)·1 − I (Wensing, Kim and Slotine 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from labhil.physics.arm.chain import Chain
from labhil.physics.arm.grouped import group_parameters
from labhil.physics.arm.rigid_body import PER_LINK, gravity_in_base
from labhil.signals import FloatArray

RADIUS = 0.1
"""m; changes of first and second moments have the weight of the same mass at this distance."""

MIN_MASS = 0.05
"""kg; lighter links have the weights of this mass."""

LOAD_TOLERANCE = 1e-4
"""Weight of an error of the joints' loads, as a share of the typical torque."""

ROTOR_TOLERANCE = 1e-6
"""Largest error of links that act like a rotor, as a share of the rotor's torque."""

MIN_MOMENT = 0.1
"""mm²; least second moment over mass, so that rounding keeps it positive."""

N_MOTIONS = 100


def pseudo_inertia(pi: FloatArray) -> FloatArray:
    """Return the pseudo-inertia (4, 4) of ten inertial parameters."""
    m, hx, hy, hz, xx, yy, zz, xy, xz, yz = pi
    i = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    out = np.empty((4, 4))
    out[:3, :3] = 0.5 * np.trace(i) * np.eye(3) - i
    out[:3, 3] = out[3, :3] = hx, hy, hz
    out[3, 3] = m
    return out


def _in_millimetres(j: FloatArray) -> FloatArray:
    scale = np.array([1e3, 1e3, 1e3, 1.0])
    return np.asarray(j * np.outer(scale, scale))


def parameters_of(j: FloatArray) -> FloatArray:
    """Return the ten inertial parameters of a pseudo-inertia (4, 4)."""
    sigma = j[:3, :3]
    i = np.trace(sigma) * np.eye(3) - sigma
    return np.array([j[3, 3], *j[:3, 3], i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])


def is_body(pi: FloatArray) -> bool:
    """Whether inertial parameters (10,) are physically consistent."""
    values = np.linalg.eigvalsh(_in_millimetres(pseudo_inertia(pi)))
    return bool(pi[0] > 0.0 and values[0] > MIN_MOMENT * pi[0])


@dataclass(frozen=True, slots=True)
class Bodies:
    """Inertial parameters (10 n,) of bodies, and the armature (n,) of their joints, kg·m²."""

    inertial: FloatArray
    armature: FloatArray


def nearest_bodies(
    chain: Chain, initial: FloatArray, target: FloatArray, fixed: FloatArray, armature: FloatArray
) -> Bodies:
    """Find the bodies and rotors nearest to the initial ones that load the joints like the target.

    Some inertia acts in the same way as a rotor's (of a joint on the base, about its axis). Their shares
    cannot be identified; they are chosen so that the bodies stay near the initial ones.

    Args:
        chain: The arm.
        initial: Inertial parameters of its bodies, (10 n,).
        target: Inertial parameters that bodies and ``fixed`` are to act like together, (10 n,).
        fixed: Other inertia that moves with each link and does not change, (10 n,).
        armature: Armature of the joints in addition to the target, kg·m², (n,).

    Returns:
        The nearest bodies; a body that needs no change is unchanged.
    """
    groups, rotor_equivalents = group_parameters(chain), _rotor_equivalents(chain)
    scale, load = _scales(initial), groups.shares @ (target - fixed - initial)
    if np.all(np.abs(load) <= 1e-12 * np.maximum(np.abs(groups.shares) @ scale, 1e-12)):
        return Bodies(initial, armature)
    rotor_scale = np.maximum(np.abs(armature), RADIUS**2)
    weighted = np.column_stack([groups.shares * scale, rotor_equivalents * rotor_scale])
    solution = np.linalg.lstsq(weighted, load, rcond=1e-10)[0]
    solution[np.abs(solution) < 1e-9] = 0.0
    change, rotor = scale * solution[: len(scale)], armature + rotor_scale * solution[len(scale) :]
    before, after = initial.reshape(-1, PER_LINK), (initial + change).reshape(-1, PER_LINK)
    bodies = all(np.array_equal(old, new) or is_body(new) for old, new in zip(before, after, strict=True))
    if bodies and np.all((rotor >= 0.0) | (rotor == armature)):
        return Bodies(initial + change, rotor)
    return _fit_bodies(chain, initial, armature, groups.shares, rotor_equivalents, load)


def _scales(initial: FloatArray) -> FloatArray:
    """Scale of the change of each parameter, (10 n,)."""
    mass = np.maximum(initial[::PER_LINK], MIN_MASS)
    per_mass = np.array([1.0, *[RADIUS] * 3, *[RADIUS**2] * 6])
    return np.asarray((mass[:, None] * per_mass).ravel())


def _motion(chain: Chain) -> tuple[FloatArray, FloatArray]:
    """Regressor (N, 10 n) of the links along a random motion, and that of the rotors (N, n)."""
    random, n = np.random.default_rng(0), chain.joints
    q = random.uniform(-np.pi, np.pi, (N_MOTIONS, n))
    qd, qdd = random.normal(size=(2, N_MOTIONS, n))
    columns = chain.regressor(q, qd, qdd, gravity_in_base()).reshape(-1, n * PER_LINK)
    return columns, (qdd[:, :, None] * np.eye(n)).reshape(-1, n)


def _rotor_equivalents(chain: Chain) -> FloatArray:
    """Estimable parameters that act like a rotor's inertia, (P, n); 0 where none does."""
    columns, rotors = _motion(chain)
    estimable = columns[:, list(group_parameters(chain).kept)]
    shares_of_rotor = np.linalg.lstsq(estimable, rotors, rcond=1e-10)[0]
    residual = np.linalg.norm(rotors - estimable @ shares_of_rotor, axis=0) / np.linalg.norm(rotors, axis=0)
    return np.where(residual < ROTOR_TOLERANCE, shares_of_rotor, 0.0)


def _fit_bodies(
    chain: Chain,
    initial: FloatArray,
    armature: FloatArray,
    shares: FloatArray,
    rotor_equivalents: FloatArray,
    load: FloatArray,
) -> Bodies:
    """Fit Cholesky factors of the pseudo-inertias, so that every point is consistent."""
    n, scale, rotor_scale = chain.joints, _scales(initial), np.maximum(np.abs(armature), RADIUS**2)
    columns, _ = _motion(chain)
    torque = float(np.sqrt(np.mean((columns @ initial) ** 2)))
    # the weight of a change of an estimable parameter is the torque that it makes
    estimable = columns[:, list(group_parameters(chain).kept)] / (
        LOAD_TOLERANCE * torque * np.sqrt(len(columns))
    )
    r = np.linalg.qr(estimable, mode="r")
    lower = np.tril_indices(4)

    def bodies(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        out = np.empty((n, PER_LINK))
        for link, entries in enumerate(z[n:].reshape(n, -1)):
            factor = np.zeros((4, 4))
            factor[lower] = entries
            min_moment = 2e-6 * MIN_MOMENT * factor[3] @ factor[3]
            out[link] = parameters_of(factor @ factor.T + np.diag([min_moment, min_moment, min_moment, 0.0]))
        return out.ravel(), z[:n] ** 2

    def residuals(z: FloatArray) -> FloatArray:
        pi, rotor = bodies(z)
        residual = shares @ (pi - initial) + rotor_equivalents @ (rotor - armature) - load
        return np.concatenate([r @ residual, (pi - initial) / scale, (rotor - armature) / rotor_scale])

    start = [_cholesky(link)[lower] for link in initial.reshape(n, PER_LINK)]
    first = np.concatenate([np.sqrt(np.maximum(armature, 1e-6)), *start])
    pi, rotor = bodies(least_squares(residuals, first, x_scale="jac", max_nfev=100).x)
    return Bodies(pi, np.where(np.any(rotor_equivalents, axis=0), rotor, armature))


def _cholesky(pi: FloatArray) -> FloatArray:
    """Cholesky factor of a pseudo-inertia; of a singular one that of a slightly thicker body."""
    values, axes = np.linalg.eigh(pseudo_inertia(pi))
    moments = np.maximum(values, 1e-6 * max(float(values[-1]), 1e-6))
    return np.asarray(np.linalg.cholesky((axes * moments) @ axes.T))


def centroidal(pi: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return mass (kg), centre (3,) m and inertia at the centre (3, 3) kg·m² of ten inertial parameters."""
    m, hx, hy, hz, xx, yy, zz, xy, xz, yz = pi
    centre = np.array([hx, hy, hz]) / m
    i = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return float(m), centre, np.asarray(i - m * (centre @ centre * np.eye(3) - np.outer(centre, centre)))


def shift_origin(pi: FloatArray, by: FloatArray) -> FloatArray:
    """Return the parameters of a body after a shift of the body by ``by`` (3,) m."""
    if not np.any(by):
        return pi
    m, h = pi[0], np.asarray(pi[1:4])
    new = h + m * by

    def steiner(first: FloatArray) -> FloatArray:
        """m·(c² − c·cᵀ) of a first moment m·c, (3, 3)."""
        return np.asarray((first @ first * np.eye(3) - np.outer(first, first)) / m) if m else np.zeros((3, 3))

    change = steiner(new) - steiner(h)
    moments = pi[4:] + np.array([*np.diag(change), change[0, 1], change[0, 2], change[1, 2]])
    return np.array([m, *new, *moments])
