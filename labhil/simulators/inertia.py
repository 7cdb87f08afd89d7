"""Inertial parameters that bodies could have, near given ones, and that load the joints as estimated ones.

Only combinations of a link's ten parameters can be estimated; what a file holds are all of them, and MuJoCo
takes those only that a body could have. A body's are those whose pseudo-inertia J = [[Σ, h], [hᵀ, m]] is
positive, where h is mass times centre and Σ = ½ tr(I)·1 − I (Wensing, Kim and Slotine 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from labhil.physics.arm.chain import Chain
from labhil.physics.arm.grouped import group_parameters
from labhil.physics.arm.rigid_body import PER_LINK, gravity_in_base
from labhil.signals import FloatArray

REACH = 0.1
"""m; changes of first and second moments are weighed as those of the mass at this distance."""

LIGHTEST = 0.05
"""kg; a link that has less is weighed as if it had that."""

EXACT = 1e-4
"""Share of the typical torque by which the joints' loads may be missed where bodies need it."""

ALIKE = 1e-6
"""Share of a rotor's torque that links must not miss to act just as it."""

THIN = 0.1
"""mm² of a body's second moment over its mass at least: rounding must not take it away."""

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


def _in_millimetres(j: FloatArray) -> FloatArray:
    scale = np.array([1e3, 1e3, 1e3, 1.0])
    return np.asarray(j * np.outer(scale, scale))


def parameters_of(j: FloatArray) -> FloatArray:
    """Ten inertial parameters of a pseudo-inertia (4, 4)."""
    sigma = j[:3, :3]
    i = np.trace(sigma) * np.eye(3) - sigma
    return np.array([j[3, 3], *j[:3, 3], i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])


def is_body(pi: FloatArray) -> bool:
    """Whether a body may have these inertial parameters."""
    values = np.linalg.eigvalsh(_in_millimetres(pseudo_inertia(pi)))
    return bool(pi[0] > 0.0 and values[0] > THIN * pi[0])


@dataclass(frozen=True, slots=True)
class Realised:
    """Inertial parameters (10 n,) of bodies, and armature (n,) kg·m² that goes with them."""

    inertial: FloatArray
    armature: FloatArray


def realise(
    chain: Chain, begin: FloatArray, wanted: FloatArray, rest: FloatArray, armature: FloatArray
) -> Realised:
    """Bodies and rotors that load the joints as wanted ones do.

    Some inertia acts just as a rotor's (of a joint that the base carries, about its axis). Their shares
    cannot be identified, so that either may take from the other what brings the bodies near ``begin``.

    Args:
        chain: The arm.
        begin: What its bodies have, (10 n,).
        wanted: What they are to act like, with ``rest``, (10 n,).
        rest: What else moves with each link and stays as it is, (10 n,).
        armature: That of the joints beside what is wanted, kg·m², (n,).

    Returns:
        The nearest bodies to ``begin``; those of a link that need no change are unchanged.
    """
    groups, like_rotor = group_parameters(chain), _like_rotors(chain)
    size, load = _sizes(begin), groups.shares @ (wanted - rest - begin)
    if np.all(np.abs(load) <= 1e-12 * np.maximum(np.abs(groups.shares) @ size, 1e-12)):
        return Realised(begin, armature)
    free = np.maximum(np.abs(armature), REACH**2)
    weighed = np.column_stack([groups.shares * size, like_rotor * free])
    solution = np.linalg.lstsq(weighed, load, rcond=1e-10)[0]
    solution[np.abs(solution) < 1e-9] = 0.0
    change, rotor = size * solution[: len(size)], armature + free * solution[len(size) :]
    before, after = begin.reshape(-1, PER_LINK), (begin + change).reshape(-1, PER_LINK)
    bodies = all(np.array_equal(old, new) or is_body(new) for old, new in zip(before, after, strict=True))
    if bodies and np.all((rotor >= 0.0) | (rotor == armature)):
        return Realised(begin + change, rotor)
    return _nearest_bodies(chain, begin, armature, groups.shares, like_rotor, load)


def _sizes(begin: FloatArray) -> FloatArray:
    """What a usual change of each parameter is, (10 n,)."""
    mass = np.maximum(begin[::PER_LINK], LIGHTEST)
    per_mass = np.array([1.0, *[REACH] * 3, *[REACH**2] * 6])
    return np.asarray((mass[:, None] * per_mass).ravel())


def _motion(chain: Chain) -> tuple[FloatArray, FloatArray]:
    """Columns (N, 10 n) of a random motion, and those (N, n) of rotors."""
    random, n = np.random.default_rng(0), chain.joints
    q = random.uniform(-np.pi, np.pi, (MOTIONS, n))
    qd, qdd = random.normal(size=(2, MOTIONS, n))
    columns = chain.regressor(q, qd, qdd, gravity_in_base()).reshape(-1, n * PER_LINK)
    return columns, (qdd[:, :, None] * np.eye(n)).reshape(-1, n)


def _like_rotors(chain: Chain) -> FloatArray:
    """What a rotor's inertia adds to what can be estimated, (P, n); zero where it acts like nothing else."""
    columns, rotors = _motion(chain)
    kept = columns[:, list(group_parameters(chain).kept)]
    alike = np.linalg.lstsq(kept, rotors, rcond=1e-10)[0]
    missed = np.linalg.norm(rotors - kept @ alike, axis=0) / np.linalg.norm(rotors, axis=0)
    return np.where(missed < ALIKE, alike, 0.0)


def _nearest_bodies(
    chain: Chain,
    begin: FloatArray,
    armature: FloatArray,
    shares: FloatArray,
    like_rotor: FloatArray,
    load: FloatArray,
) -> Realised:
    """By Cholesky factors of the pseudo-inertias, with which every point is a body."""
    n, size, free = chain.joints, _sizes(begin), np.maximum(np.abs(armature), REACH**2)
    columns, _ = _motion(chain)
    torque = float(np.sqrt(np.mean((columns @ begin) ** 2)))
    # a change of what can be estimated is weighed by the torque that it makes
    kept = columns[:, list(group_parameters(chain).kept)] / (EXACT * torque * np.sqrt(len(columns)))
    r = np.linalg.qr(kept, mode="r")
    lower = np.tril_indices(4)

    def bodies(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        out = np.empty((n, PER_LINK))
        for link, entries in enumerate(z[n:].reshape(n, -1)):
            factor = np.zeros((4, 4))
            factor[lower] = entries
            thick = 2e-6 * THIN * factor[3] @ factor[3]
            out[link] = parameters_of(factor @ factor.T + np.diag([thick, thick, thick, 0.0]))
        return out.ravel(), z[:n] ** 2

    def residuals(z: FloatArray) -> FloatArray:
        pi, rotor = bodies(z)
        missed = shares @ (pi - begin) + like_rotor @ (rotor - armature) - load
        return np.concatenate([r @ missed, (pi - begin) / size, (rotor - armature) / free])

    start = [_factor(link)[lower] for link in begin.reshape(n, PER_LINK)]
    first = np.concatenate([np.sqrt(np.maximum(armature, 1e-6)), *start])
    pi, rotor = bodies(least_squares(residuals, first, x_scale="jac", max_nfev=100).x)
    return Realised(pi, np.where(np.any(like_rotor, axis=0), rotor, armature))


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


def shift_origin(pi: FloatArray, by: FloatArray) -> FloatArray:
    """The same body's parameters about an origin from which it lies ``by`` (3,) m farther."""
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
