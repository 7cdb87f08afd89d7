"""How far ahead a model predicts its outputs, given that it starts from an uncertain state.

An unstable rig, such as a ball on a beam that turns fast, multiplies every error of its state. Within its
predictability horizon an error of the size of the noise grows to the size of the signal (Lorenz, J. Atmos.
Sci. 20, 1963). A window that is longer has an initial state for which any model passes near its data, and
slopes that are the integrator's error as much as physics.
"""

from __future__ import annotations

import numpy as np

from labhil.identify.problem import Problem
from labhil.identify.window_states import FIRST_SECTION_IN_HORIZONS
from labhil.identify.windows import fit_windows
from labhil.physics.model import Model
from labhil.physics.record import Record
from labhil.signals import FloatArray

PERTURBATION = 1e-4
"""Change of an initial state, in scales of the states: small enough for a linear response."""


def predictability_horizon(
    model: Model, theta: FloatArray, record: Record, sigma: FloatArray, longest: float
) -> float:
    """Time in which an error of the initial state grows from the noise to the signal.

    Args:
        model: the model.
        theta: its parameter vector.
        record: what it is simulated beside.
        sigma: (c,), noise of the outputs, SI units.
        longest: length of the windows in which the growth is looked for, s.

    Returns:
        The time in s; ``longest`` where errors do not grow so far within it.
    """
    windows = fit_windows(record, longest)
    problem = Problem(model, record, windows, np.empty(0, dtype=np.int64), theta, sigma)
    if not problem.guess.shape[1]:
        return longest
    elapsed = record.t[windows.rows] - record.t[windows.first][windows.owner]
    deviation = np.sqrt(np.mean(_deviations(problem) ** 2, axis=(0, 2)))
    early = elapsed <= FIRST_SECTION_IN_HORIZONS * model.horizon
    growth = deviation / max(float(np.sqrt(np.mean(deviation[early] ** 2))), 1e-300)
    largest = float(np.max(np.std(record.outputs, axis=0) / sigma))
    beyond = elapsed[growth > largest]
    return float(beyond.min()) if len(beyond) else longest


def _deviations(problem: Problem) -> FloatArray:
    """Change of the simulated outputs by a small change of each initial state, (S, N, c), in noise levels."""
    theta, guess = problem.base, problem.guess
    model, record, windows = problem.model, problem.record, problem.windows
    with np.errstate(over="ignore", invalid="ignore"):
        reference = model.simulate(theta, record, windows, guess)
        changed = [
            model.simulate(theta, record, windows, guess + PERTURBATION * step)
            for step in np.diag(model.state_scale)
        ]
        return np.nan_to_num((np.array(changed) - reference) / problem.noise, posinf=1e100, neginf=-1e100)
