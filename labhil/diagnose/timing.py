"""When an input acts, by the rig's own model: held or straight between samples, and stamped late or not.

Half a sample is little beside what physics a model may lack, so nothing is concluded unless the better of two
fits leaves no more than noise.

In closed loop the fit of the outputs alone prefers an input that is too early: the command a sample later is
made of the noise of the output, and predicts it. So the joint likelihood of outputs and input is compared:
an input that is stamped late can have been made of older outputs only, and the information of a newer one
is lost (the direct method needs the order of causes right: Söderström and Stoica 1989, ch. 10).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from labhil.diagnose.fault import Fault, Kind
from labhil.diagnose.hold import jumps_of_levels
from labhil.diagnose.intake import TOLERATED, faults_of
from labhil.ending import EndedEarly
from labhil.errors import UsageError
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.windows import noise_of
from labhil.physics.measured_input import MEASURED_INPUTS
from labhil.physics.model import Metric, Model, Record
from labhil.signals import FloatArray, Hold

MOST_SAMPLES = 1000
"""That fits compare: what half a sample does to a simulation is far above the noise in fewer."""

ENOUGH = 0.9
"""Share of the most that inputs change among as many samples, from which the first such stretch is taken."""

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

PAST = 10
"""Samples of an input and of the outputs that predict what a controller does next."""

SMALLEST = 1e-6
"""Share of an input's spread below which what is left of a prediction is rounding."""

TERMS = ("viscous_friction", "coulomb_friction", "constant_force")
"""What nearly every rig has, and what delays its answers."""

BRIEFLY = 20
"""Steps of least squares of a fit that only says whether a thorough one is worth it.

With the right stamps a model comes to the noise in a dozen; what creeps on after that does so under any.
"""

PLAY = ("backlash", "dead_zone")
"""What moves the answers to a reversal, so that an offset and another stamp may stand in for it."""


def all_faults(model: Model, record: Record) -> tuple[Fault, ...]:
    """The faults that a record shows by itself, and a late input that only the rig's model shows."""
    faults = faults_of(record)
    if any(fault.share > TOLERATED.get(fault.kind, 1.0) for fault in faults):
        return faults
    try:
        late = late_input(model, record)
    except EndedEarly:  # whatever comes next ends as well, and has a result to show
        late = None
    return faults if late is None else (*faults, late)


def better_hold(model: Model, record: Record) -> Hold | None:
    """How the one input of a record runs between samples, by fits; None where they do not decide."""
    part = _part(model, record) if len(record.input_names) == 1 else None
    if part is None:
        return None
    best = _best_of(model, [(replace(part, input_holds=(hold,)), 0) for hold in Hold], 0)
    return None if best is None else tuple(Hold)[best[0]]


def late_input(model: Model, record: Record) -> Fault | None:
    """The fault of an input that is stamped late: the model fits to the noise with it earlier, and only then.

    Only one recording is looked at. Of several inputs each is tried by itself; where more than one would do
    as an explanation, the fault is that of the likeliest.
    """
    part = _part(model, record)
    if part is None:
        return None
    candidates: list[tuple[float, int, int]] = []
    for place in range(len(record.input_names)):
        if np.ptp(part.inputs[:, place]) == 0.0:
            continue
        tried = [(_earlier(part, place, samples), samples) for samples in range(FURTHEST + 1)]
        best = _best_of(model, tried, place)
        if best is not None and best[0]:
            candidates.append((best[1], place, best[0]))
    if not candidates:
        return None
    cost, place, samples = min(candidates)
    return None if _is_play(model, part, cost) else _late(record, record.input_names[place], samples)


def _late(record: Record, name: str, samples: int) -> Fault:
    shift = -samples * record.period
    count = f"{samples} sample{'s' if samples > 1 else ''}"
    say = (
        f"The outputs answer {name} {-shift:.3g} s ({count}) before it changes: "
        f"the model fits to the noise with {name} as much earlier, and not as it is stamped. Stamp both by "
        f"one clock, or import the table again with `[channels] {name} = {{ …, shift = {shift:.6g} }}`."
    )
    span = ((float(record.t[0]), float(record.t[-1])),)
    return Fault(Kind.LEAD, name, None, span, 1.0, say)


def why_untimed(model: Model, record: Record) -> str | None:
    """Why it is unknown whether an input is stamped late; None where the model was compared.

    No simulation times the drive of an arm, so there the question does not arise.
    """
    if model.metric is not Metric.WINDOWED_SIMULATION:
        return None
    measured = [name for name in record.input_names if name in MEASURED_INPUTS]
    if measured:
        name, reason = measured[0], "it is measured, and the filter and the noise of its sensor shift it, too"
    elif len(record.begins) > 1:
        name, reason = " or ".join(record.input_names), "only a recording by itself is looked at"
    else:
        return None
    return f"Whether {name} is stamped a sample or two late was not checked by the model: {reason}."


def _part(model: Model, record: Record) -> Record | None:
    """The samples that are compared; None where a comparison means nothing."""
    if model.metric is not Metric.WINDOWED_SIMULATION:
        return None
    if len(record) < FEWEST_SAMPLES or np.any(np.diff(record.t) <= 0.0):
        return None
    if why_untimed(model, record) is not None:
        return None
    part = _busiest(record)
    moves = np.ptp(part.inputs) > 0.0 and np.isfinite(np.hstack([part.inputs, part.outputs])).all()
    return part if moves else None


def _busiest(record: Record) -> Record:
    """The samples of a record among which its inputs change most: what comes before them may be rest."""
    if len(record) <= MOST_SAMPLES:
        return record
    change = np.abs(np.diff(record.inputs, axis=0, prepend=record.inputs[:1]))
    moved = np.cumsum(np.sum(change / np.maximum(np.ptp(record.inputs, axis=0), 1e-300), axis=1))
    over = moved[MOST_SAMPLES - 1 :] - np.r_[0.0, moved[:-MOST_SAMPLES]]
    first = int(np.argmax(over >= ENOUGH * over.max()))
    return record.part(first, first + MOST_SAMPLES)


def _surprise(record: Record, place: int, newest: int) -> float:
    """Twice the negative log likelihood of the input ``place``, but for a constant, given its causes.

    These are its own past and the outputs up to the one ``newest`` samples earlier. An input that is held in
    levels counts as having none: a relay's jumps are too few to say much of the noise.
    """
    u = record.inputs[:, place]
    if len(jumps_of_levels(u)):
        return 0.0
    rows = np.arange(PAST, len(u))[:, None]
    # the oldest are the same ones whatever the newest, so that more of them never predict less
    regressors = [
        u[rows - np.arange(1, PAST)],
        *(y[rows - np.arange(newest, PAST)] for y in record.outputs.T),
    ]
    a = np.hstack(
        [np.ones_like(rows), *((signal - signal.mean()) / (np.std(signal) or 1.0) for signal in regressors)]
    )
    residuals = u[rows[:, 0]] - a @ np.linalg.lstsq(a, u[rows[:, 0]], rcond=None)[0]
    return float(len(u) * np.log(np.mean(residuals**2) + (SMALLEST * np.std(u)) ** 2))


def _earlier(record: Record, place: int, samples: int) -> Record:
    """The record with one of its inputs so many samples earlier; at its end that stays as it was."""
    if not samples:
        return record
    inputs = record.inputs.copy()
    # the last rows know no later input
    inputs[:, place] = np.r_[inputs[samples:, place], inputs[-1:, place].repeat(samples)]
    return replace(record, inputs=inputs)


def _best_of(model: Model, records: Sequence[tuple[Record, int]], place: int) -> tuple[int, float] | None:
    """Which of the records, with how much earlier the input ``place`` is, a model explains far better.

    With its cost, the surprise of its input over that of the first included.

    Brief fits propose it, thorough ones confirm it: a brief fit may stay in a local minimum, which is far
    worse than another's best.
    """
    # an output depends on one more sample of an input that is straight between samples
    newest = [earlier + (record.input_holds[place] is Hold.LINEAR) for record, earlier in records]
    original = records[0][0]
    surprises = np.array([_surprise(original, place, n) for n in newest])
    candidates = [record for record, _ in records]
    if _clearly_best(_fits(model, candidates, thorough=False), surprises) is None:
        return None
    fits = _fits(model, candidates, thorough=True)
    best = _clearly_best(fits, surprises)
    return None if best is None else (best, fits[best].solution.cost + float(surprises[best] - surprises[0]))


def _is_play(model: Model, record: Record, cost: float) -> bool:
    """Whether play explains a record as well as a late input does at this cost."""
    for play in PLAY:
        fits = _fits(model, [record], thorough=True, more=(play,)) if play in model.terms else []
        if any(fit.solution.cost < cost + 2.0 * FAR_BETTER for fit in fits):
            return True
    return False


def _fits(
    model: Model, records: Iterable[Record], *, thorough: bool, more: Sequence[str] = ()
) -> list[Fitted]:
    terms = [term for term in (*TERMS, *more) if term in model.terms]
    length, fit = IN_HORIZONS * model.horizon, partial(fit_terms, new_terms=(), thorough=thorough)
    if not thorough:
        fit = partial(fit, iterations=BRIEFLY)
    try:
        return [fit(model, r, terms, length, noise_of(r)) for r in records]
    except (UsageError, np.linalg.LinAlgError):
        return []


def _clearly_best(fits: list[Fitted], surprises: FloatArray) -> int | None:
    """Which fit is far better than the first, or, being the first, than all others; None where none is."""
    if not fits:
        return None
    costs = np.array([fit.solution.cost for fit in fits]) + surprises
    best = int(np.argmin(costs))
    rival_cost = costs[0] if best else np.min(costs[1:])
    sure = rival_cost - costs[best] > 2.0 * FAR_BETTER and fits[best].noise < TO_THE_NOISE
    return best if sure else None
