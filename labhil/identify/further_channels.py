"""Which further channel, or which known value, would make more parameters identifiable.

Each is tried on the fitted model by simulation (``identifiability`` has the criterion).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from labhil.identify.fitted import Fitted
from labhil.identify.identifiability import Identifiability, identifiability, with_helpful_options
from labhil.identify.problem import Point, Problem
from labhil.identify.sensitivities import sensitivities
from labhil.physics.model import index_of, start_values
from labhil.physics.record import Record
from labhil.physics.rigs import model_for
from labhil.physics.several import names_per_recording
from labhil.physics.terms import Parameter, keyed
from labhil.rig import RigFile
from labhil.signals import FloatArray, Signal


def suggest_measurements(
    result: Identifiability, rig: RigFile, fitted: Fitted, *, assumed_noise: float = 0.02
) -> Identifiability:
    """Name outputs to record and constants to measure that would determine more parameters.

    Args:
        result: Identifiability of the fit.
        rig: Its rig file; outputs of its kind that are not recorded are tried, and constants of the rig.
        fitted: The fit.
        assumed_noise: Noise of a channel that is not measured yet, as a share of its RMS (an assumption).

    Returns:
        ``result`` with their names in ``would_help``.
    """
    options: dict[str, Callable[[], Identifiability]] = {}
    record = fitted.problem.record
    for signal in rig.kind.outputs:
        if signal.width == 1 and signal.name not in record.output_names:
            options[signal.name] = partial(_with_channel, rig, fitted, signal, assumed_noise)
    for j, place in enumerate(fitted.problem.free):
        parameter = fitted.problem.model.parameters[place]
        if parameter.term is None:
            option = keyed(f"known.{parameter.name}", None, parameter.recording)
            options[option] = partial(_with_known, fitted, j)
    return with_helpful_options(result, options)


def _with_known(fitted: Fitted, j: int) -> Identifiability:
    """Identifiability when the free parameter ``j`` is known."""
    problem = fitted.problem
    _, _, jacobian = fitted.covariances
    others = np.delete(np.arange(len(problem.free)), j)
    parameters = [problem.model.parameters[i] for i in problem.free[others]]
    values = fitted.theta[problem.free[others]]
    return identifiability(parameters, values, jacobian[:, others], fitted.noise)


def _with_channel(rig: RigFile, fitted: Fitted, signal: Signal, assumed_noise: float) -> Identifiability:
    """Identifiability when ``signal`` is recorded too, as the fitted model simulates it."""
    old = fitted.problem
    further = _with_column(old.record, signal)
    model = model_for(rig, further, names_per_recording(old.model))
    theta = _carry_over(fitted, model.parameters)
    states = fitted.solution.point.states
    simulated = model.simulate(theta, further, old.windows, states)
    measured = np.zeros((len(further), simulated.shape[1]))
    measured[old.windows.rows] = simulated
    assumed_sigma = assumed_noise * max(float(np.sqrt(np.mean(measured[:, -1] ** 2))), 1e-12)
    sigma = np.append(fitted.noise * old.sigma, assumed_sigma)
    places = index_of(model.parameters)
    free = np.array([places[old.model.parameters[i].key] for i in old.free], dtype=np.int64)
    further = replace(further, outputs=measured)
    problem = Problem(model, further, old.windows, free, theta, sigma)
    point = Point(theta[free] / problem.scale, states)
    jacobian = sensitivities(problem, point, problem.residuals(point), 1.0) / problem.scale
    return identifiability([model.parameters[i] for i in free], theta[free], jacobian, 1.0)


def _with_column(record: Record, signal: Signal) -> Record:
    """The record with one more output, all zeros."""
    return replace(
        record,
        outputs=np.column_stack([record.outputs, np.zeros(len(record))]),
        output_names=(*record.output_names, signal.name),
        output_units=(*record.output_units, signal.unit),
        output_joints=(*record.output_joints, None) if record.output_joints else (),
        begins=tuple(
            replace(b, noise_scale=(*b.noise_scale, 1.0) if b.noise_scale else ()) for b in record.begins
        ),
    )


def _carry_over(fitted: Fitted, parameters: Sequence[Parameter]) -> FloatArray:
    """Parameter vector of another model of the same rig: fitted values by key, neutral ones for the rest."""
    theta = start_values(parameters)
    places = index_of(parameters)
    for parameter, value in zip(fitted.problem.model.parameters, fitted.theta, strict=True):
        if parameter.key in places:
            theta[places[parameter.key]] = value
    return theta
