"""When an input acts, by the rig's own model: held or straight between samples, and stamped late or not.

Half a sample is little beside what physics a model may lack, so nothing is concluded unless the better of two
fits leaves no more than noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from labhil.diagnose.fault import Fault, Kind
from labhil.diagnose.intake import TOLERATED, faults_of
from labhil.errors import UsageError
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.windows import noise_of
from labhil.physics.measured_input import MEASURED_INPUTS
from labhil.physics.model import Metric, Model, Record
from labhil.signals import FloatArray, Hold

MOST_SAMPLES = 1000
"""That fits compare: what half a sample does to a simulation is far above the noise in fewer."""

FEWEST_SAMPLES = 200
"""From which they are compared."""

IN_HORIZONS = 0.1875
"""Length of their windows: short ones lead to the neighbourhood of the estimates from any start."""

TO_THE_NOISE = 1.2
"""RMSE over noise up to which a model is right enough to time an input: what it lacks looks like delay."""

FAR_BETTER = 20.0
"""Difference of log likelihoods: odds of 1 to 5e8, for what then counts as known."""

FURTHEST = 2
"""Samples of lead that are tried."""

ANSWERED_WITHIN = 4
"""Samples within which a controller answers noise of its measurement."""

CLEAR = 4.0
"""Standard errors by which that stands out: by chance in 1 of 4000 recordings, which then are not timed."""

TERMS = ("viscous_friction", "coulomb_friction")
"""What nearly every rig has, and what delays its answers."""


def all_faults(model: Model, record: Record) -> tuple[Fault, ...]:
    """The faults that a record shows by itself, and a late input that only the rig's model shows."""
    found = faults_of(record)
    if any(fault.share > TOLERATED.get(fault.kind, 1.0) for fault in found):
        return found
    late = late_input(model, record)
    return found if late is None else (*found, late)


def better_hold(model: Model, record: Record) -> Hold | None:
    """How the one input of a record runs between samples, as fits tell; None where they are not sure."""
    part = _part(model, record)
    if part is None:
        return None
    best = _best_of(model, [replace(part, input_holds=(hold,)) for hold in Hold])
    return None if best is None else tuple(Hold)[best]


def late_input(model: Model, record: Record) -> Fault | None:
    """The fault of an input that is stamped late: the model fits to the noise with it earlier, and only then.

    Only one recording with one input is looked at.
    """
    part = _part(model, record)
    if part is None:
        return None
    best = _best_of(model, [_earlier(part, samples) for samples in range(FURTHEST + 1)])
    if not best:
        return None
    name, shift = record.input_names[0], -best * record.period
    count = f"{best} sample{'s' if best > 1 else ''}"
    say = (
        f"The outputs answer {name} {-shift:.3g} s ({count}) before it changes: "
        f"the model fits to the noise with {name} as much earlier, and not as it is stamped. Stamp both by "
        f"one clock, or import the table again with `[channels] {name} = {{ …, shift = {shift:.6g} }}`."
    )
    whole = ((float(record.t[0]), float(record.t[-1])),)
    return Fault(Kind.LEAD, name, None, whole, 1.0, say)


def why_untimed(model: Model, record: Record) -> str | None:
    """Why nothing is known of whether the one input is stamped late; None where the model was asked.

    What drives an arm is timed by no simulation, and is not asked about either.
    """
    if model.metric is not Metric.WINDOWED_SIMULATION or len(record.input_names) != 1:
        return None
    name = record.input_names[0]
    if name in MEASURED_INPUTS:
        reason = "it is measured, and the filter and the noise of its sensor shift it, too"
    elif len(record.begins) > 1:
        reason = "only a recording by itself is looked at"
    elif len(record) >= FEWEST_SAMPLES and _is_fed_back(record.part(0, MOST_SAMPLES)):
        reason = "a controller answers the noise of the output, after which an early input fits better"
    else:
        return None
    return f"Whether {name} is stamped a sample or two late was not checked by the model: {reason}."


def _part(model: Model, record: Record) -> Record | None:
    """The samples that are compared; None where a comparison means nothing."""
    if model.metric is not Metric.WINDOWED_SIMULATION or len(record.input_names) != 1:
        return None
    if len(record) < FEWEST_SAMPLES or np.any(np.diff(record.t) <= 0.0):
        return None
    if why_untimed(model, record) is not None:
        return None
    part = record.part(0, MOST_SAMPLES)
    moves = np.ptp(part.inputs) > 0.0 and np.isfinite(np.hstack([part.inputs, part.outputs])).all()
    return part if moves else None


def _is_fed_back(record: Record) -> bool:
    """Whether a controller answers the noise of an output at once.

    Its command a sample later then tells something of that noise, so that the command a sample earlier
    explains a part of it: in closed loop a fit prefers an input that is a little too early (Söderström and
    Stoica 1989, ch. 10, on the bias of direct identification). Third differences hold noise and no motion.
    """
    answer = np.diff(record.inputs[:, 0], 3)
    for noise in np.diff(record.outputs, 3, axis=0).T:
        size = float(np.linalg.norm(noise) * np.linalg.norm(answer))
        for lag in range(1, ANSWERED_WITHIN + 1):
            if abs(float(noise[:-lag] @ answer[lag:])) * np.sqrt(len(noise)) > CLEAR * size > 0.0:
                return True
    return False


def _earlier(record: Record, samples: int) -> Record:
    """The record with its inputs so many samples earlier; at its end they stay as they were."""
    if not samples:
        return record
    inputs: FloatArray = np.concatenate([record.inputs[samples:], record.inputs[-1:].repeat(samples, axis=0)])
    # the last rows know no later input
    return replace(record, inputs=inputs)


def _best_of(model: Model, records: Sequence[Record]) -> int | None:
    """Which of the records a model fits far better; brief fits propose it, thorough ones confirm it.

    A brief fit may stay in a local minimum, which is far worse than another's best.
    """
    if _clearly_best(_fits(model, records, thorough=False)) is None:
        return None
    return _clearly_best(_fits(model, records, thorough=True))


def _fits(model: Model, records: Iterable[Record], *, thorough: bool) -> list[Fitted]:
    terms = [term for term in TERMS if term in model.terms]
    length = IN_HORIZONS * model.horizon
    try:
        return [
            fit_terms(model, r, terms, length, noise_of(r), new_terms=(), thorough=thorough) for r in records
        ]
    except (UsageError, np.linalg.LinAlgError):
        return []


def _clearly_best(fits: list[Fitted]) -> int | None:
    """Which fit is far better than the first, or, being the first, than all others; None where none is."""
    if not fits:
        return None
    costs = np.array([fit.solution.cost for fit in fits])
    best = int(np.argmin(costs))
    other = costs[0] if best else np.min(costs[1:])
    sure = other - costs[best] > 2.0 * FAR_BETTER and fits[best].noise < TO_THE_NOISE
    return best if sure else None
