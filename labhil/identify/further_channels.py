"""Which further channel, or which known value, would free the directions that the data do not know."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from labhil.identify.fitted import Fitted, covariances
from labhil.identify.identifiability import Identifiability, identifiability, what_would_help
from labhil.identify.problem import Point, Problem
from labhil.identify.sensitivities import sensitivities
from labhil.physics.model import Record, index_of, start_values
from labhil.physics.rigs import model_for
from labhil.physics.several import names_per_recording
from labhil.physics.terms import Parameter, keyed
from labhil.rig import RigFile
from labhil.signals import FloatArray, Signal

SUPPOSED_NOISE = 0.02
"""Noise of a channel that nobody has measured yet, as a share of its RMS."""


def with_help(finding: Identifiability, rig: RigFile, fitted: Fitted) -> Identifiability:
    """The same finding with what would help: outputs of the rig that are not recorded, own parameters."""
    options: dict[str, Callable[[], Identifiability]] = {}
    record = fitted.problem.record
    for signal in rig.kind.outputs:
        if signal.width == 1 and signal.name not in record.output_names:
            options[signal.name] = partial(_with_channel, rig, fitted, signal)
    for j, place in enumerate(fitted.problem.free):
        parameter = fitted.problem.model.parameters[place]
        if parameter.term is None:
            option = keyed(f"known.{parameter.name}", None, parameter.recording)
            options[option] = partial(_with_known, fitted, j)
    return what_would_help(finding, options)


def _with_known(fitted: Fitted, j: int) -> Identifiability:
    """Identifiability when the free parameter ``j`` is known."""
    problem = fitted.problem
    _, _, jacobian = covariances(fitted)
    others = np.delete(np.arange(len(problem.free)), j)
    parameters = [problem.model.parameters[i] for i in problem.free[others]]
    values = fitted.theta[problem.free[others]]
    return identifiability(parameters, values, jacobian[:, others], fitted.noise)


def _with_channel(rig: RigFile, fitted: Fitted, signal: Signal) -> Identifiability:
    """Identifiability when ``signal`` is recorded too, as the fitted model simulates it."""
    old = fitted.problem
    further = _with_column(old.record, signal)
    model = model_for(rig, further, names_per_recording(old.model))
    theta = _carry_over(fitted, model.parameters)
    states = fitted.solution.point.states
    simulated = model.simulate(theta, further, old.windows, states)
    measured = np.zeros((len(further), simulated.shape[1]))
    measured[old.windows.rows] = simulated
    supposed = SUPPOSED_NOISE * max(float(np.sqrt(np.mean(measured[:, -1] ** 2))), 1e-12)
    sigma = np.append(fitted.noise * old.sigma, supposed)
    places = index_of(model.parameters)
    free = np.array([places[old.model.parameters[i].key] for i in old.free], dtype=np.int64)
    further = replace(further, outputs=measured)
    problem = Problem(model, further, old.windows, free, theta, sigma)
    point = Point(theta[free] / problem.scale, states)
    jacobian = sensitivities(problem, point, problem.residuals(point), 1.0) / problem.scale
    return identifiability([model.parameters[i] for i in free], theta[free], jacobian, 1.0)


def _with_column(record: Record, signal: Signal) -> Record:
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
    """The fitted vector in another model of the same rig, by key; what only that one has is neutral."""
    theta = start_values(parameters)
    places = index_of(parameters)
    for parameter, value in zip(fitted.problem.model.parameters, fitted.theta, strict=True):
        if parameter.key in places:
            theta[places[parameter.key]] = value
    return theta
