"""When an input acts, by fits of the rig's model: its hold between samples, and whether its stamps are late.

Half a sample of delay is little beside the physics that a model may lack, so a result counts only where the
better of two fits leaves no more than noise.

In closed loop a fit of the outputs alone prefers an input that is too early: the command one sample later is
made of the noise of the output, and predicts it. So the joint likelihood of outputs and input is compared: an
input that is stamped late can depend on older outputs only, and the information of a newer one is lost. (The
direct method needs the right causal order: Söderström and Stoica, *System Identification*, 1989, ch. 10.)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from labhil.diagnose.fault import TOLERATED_SHARE, Fault, FaultKind
from labhil.diagnose.hold import level_changes
from labhil.diagnose.intake import detect_faults
from labhil.ending import EndedEarly
from labhil.errors import UsageError
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.windows import noise_of
from labhil.physics.measured_input import MEASURED_INPUTS
from labhil.physics.model import Metric, Model
from labhil.physics.record import Record
from labhil.signals import FloatArray, Hold


@dataclass(frozen=True, slots=True)
class TimingOptions:
    """What is compared to time an input, and from which difference on.

    Attributes:
        min_samples: samples of a recording from which fits are compared.
        max_samples: samples that fits compare at most: what half a sample of delay does to a simulation is
            far above the noise in fewer.
        min_relative_activity: the first stretch of ``max_samples`` is taken in which the inputs change at
            least this share of the most that they change in any.
        window_in_horizons: length of the windows of these fits in horizons of the model. Short windows lead
            to the neighbourhood of the estimates from any start.
        max_noise_ratio: residuals over noise up to which a model may time an input: physics that it lacks
            looks like delay.
        min_log_likelihood_difference: difference of log likelihoods that decides: odds of e²⁰ = 5e8 to 1.
        max_lead_samples: largest lead in samples that is tried.
        order: past samples of the input and of the outputs that predict the next input.
        min_residual_share: share of an input's standard deviation below which the residual of its prediction
            is rounding.
        iterations_of_brief_fit: steps of least squares of a fit that only shows whether a thorough one is
            worth it. With the right stamps a model reaches the noise in a dozen; slow progress after that
            comes with any stamps.
        terms: terms of the compared models: what nearly every rig has, and what delays its answers.
        play_terms: terms that change the response to a reversal, and so can pass for a late input.
    """

    min_samples: int = 200
    max_samples: int = 1000
    min_relative_activity: float = 0.9
    window_in_horizons: float = 0.1875
    max_noise_ratio: float = 1.2
    min_log_likelihood_difference: float = 20.0
    max_lead_samples: int = 2
    order: int = 10
    min_residual_share: float = 1e-6
    iterations_of_brief_fit: int = 20
    terms: tuple[str, ...] = ("viscous_friction", "coulomb_friction", "constant_force")
    play_terms: tuple[str, ...] = ("backlash", "dead_zone")


TIMING_OPTIONS = TimingOptions()
"""The comparison that the intake makes."""


def detect_all_faults(model: Model, record: Record) -> tuple[Fault, ...]:
    """Find the faults that a record shows by itself, and a late input that only the rig's model shows.

    Args:
        model: model of the rig.
        record: one or several recordings as they were measured.

    Returns:
        The faults. A late input is looked for only where the other faults are tolerated.
    """
    faults = detect_faults(record)
    if any(fault.share > TOLERATED_SHARE.get(fault.kind, 1.0) for fault in faults):
        return faults
    try:
        late = detect_late_input(model, record)
    except EndedEarly:  # the caller ends as well, and has a result to show
        late = None
    return faults if late is None else (*faults, late)


def estimate_hold(model: Model, record: Record, *, options: TimingOptions = TIMING_OPTIONS) -> Hold | None:
    """Estimate how the one input of a record runs between samples, by a fit for each hold.

    Args:
        model: model of the rig.
        record: a recording with one input.
        options: what is compared.

    Returns:
        The hold with the better fit; None where the fits do not decide.
    """
    part = _comparable_part(model, record, options) if len(record.input_names) == 1 else None
    if part is None:
        return None
    best = _best_of(model, [(replace(part, input_holds=(hold,)), 0) for hold in Hold], 0, options)
    return None if best is None else tuple(Hold)[best[0]]


def detect_late_input(
    model: Model, record: Record, *, options: TimingOptions = TIMING_OPTIONS
) -> Fault | None:
    """Find an input whose stamps are late: only with that input earlier the model fits to the noise.

    Each input is tried by itself. Where more than one explains the data, the likeliest is taken.

    Args:
        model: model of the rig.
        record: one recording; of several recordings nothing is compared.
        options: what is compared.

    Returns:
        The fault; None where no input is late, or where the fits do not decide.
    """
    part = _comparable_part(model, record, options)
    if part is None:
        return None
    candidates: list[tuple[float, int, int]] = []
    for column in range(len(record.input_names)):
        if np.ptp(part.inputs[:, column]) == 0.0:
            continue
        trials = [
            (_with_input_earlier(part, column, samples), samples)
            for samples in range(options.max_lead_samples + 1)
        ]
        best = _best_of(model, trials, column, options)
        if best is not None and best[0]:
            candidates.append((best[1], column, best[0]))
    if not candidates:
        return None
    cost, column, samples = min(candidates)
    if _is_explained_by_play(model, part, cost, options):
        return None
    return _late_input_fault(record, record.input_names[column], samples)


def unchecked_timing_note(model: Model, record: Record) -> str | None:
    """Return why no fit can show whether an input is stamped late.

    Args:
        model: model of the rig.
        record: one or several recordings.

    Returns:
        A sentence for people; None where fits are compared, and for an arm, whose drive no simulation times.
    """
    if model.metric is not Metric.WINDOWED_SIMULATION:
        return None
    measured = [name for name in record.input_names if name in MEASURED_INPUTS]
    if measured:
        name, reason = measured[0], "it is measured, and the filter and the noise of its sensor shift it, too"
    elif len(record.begins) > 1:
        name, reason = " or ".join(record.input_names), "only a single recording is compared"
    else:
        return None
    return f"Whether {name} is stamped a sample or two late was not checked by the model: {reason}."


def _late_input_fault(record: Record, name: str, samples: int) -> Fault:
    """The fault of an input that is stamped so many samples late."""
    shift = -samples * record.period
    count = f"{samples} sample{'s' if samples > 1 else ''}"
    statement = (
        f"The outputs respond to {name} {-shift:.3g} s ({count}) before it changes: "
        f"the model fits to the noise with {name} as much earlier, and not as it is stamped. Stamp both by "
        f"one clock, or import the table again with `[channels] {name} = {{ …, shift = {shift:.6g} }}`."
    )
    span = ((float(record.t[0]), float(record.t[-1])),)
    return Fault(FaultKind.LEAD, name, None, span, 1.0, statement)


def _comparable_part(model: Model, record: Record, options: TimingOptions) -> Record | None:
    """The samples whose fits are compared; None where a comparison would show nothing."""
    if model.metric is not Metric.WINDOWED_SIMULATION:
        return None
    if len(record) < options.min_samples or np.any(np.diff(record.t) <= 0.0):
        return None
    if unchecked_timing_note(model, record) is not None:
        return None
    part = _most_active_part(record, options)
    moves = np.ptp(part.inputs) > 0.0 and np.isfinite(np.hstack([part.inputs, part.outputs])).all()
    return part if moves else None


def _most_active_part(record: Record, options: TimingOptions) -> Record:
    """The samples among which the inputs change most: a recording may begin at rest."""
    n = options.max_samples
    if len(record) <= n:
        return record
    change = np.abs(np.diff(record.inputs, axis=0, prepend=record.inputs[:1]))
    moved = np.cumsum(np.sum(change / np.maximum(np.ptp(record.inputs, axis=0), 1e-300), axis=1))
    activity = moved[n - 1 :] - np.r_[0.0, moved[:-n]]
    first = int(np.argmax(activity >= options.min_relative_activity * activity.max()))
    return record.part(first, first + n)


def _input_deviance(record: Record, column: int, newest: int, options: TimingOptions) -> float:
    """Twice the negative log likelihood of an input given its causes, up to a constant.

    The causes are its own past and the outputs up to the one ``newest`` samples earlier. Zero for a piecewise
    constant input: a relay's jumps are too few to carry much information on the noise.
    """
    u, order = record.inputs[:, column], options.order
    if len(level_changes(u)):
        return 0.0
    rows = np.arange(order, len(u))[:, None]
    # the oldest output is the same whatever the newest, so that more outputs never predict less
    regressors = [
        u[rows - np.arange(1, order)],
        *(y[rows - np.arange(newest, order)] for y in record.outputs.T),
    ]
    a = np.hstack(
        [np.ones_like(rows), *((signal - signal.mean()) / (np.std(signal) or 1.0) for signal in regressors)]
    )
    residuals = u[rows[:, 0]] - a @ np.linalg.lstsq(a, u[rows[:, 0]], rcond=None)[0]
    return float(len(u) * np.log(np.mean(residuals**2) + (options.min_residual_share * np.std(u)) ** 2))


def _with_input_earlier(record: Record, column: int, samples: int) -> Record:
    """The record with one of its inputs so many samples earlier; its last value is repeated at the end."""
    if not samples:
        return record
    inputs = record.inputs.copy()
    # no later input is known for the last rows
    inputs[:, column] = np.r_[inputs[samples:, column], inputs[-1:, column].repeat(samples)]
    return replace(record, inputs=inputs)


def _best_of(
    model: Model, records: Sequence[tuple[Record, int]], column: int, options: TimingOptions
) -> tuple[int, float] | None:
    """The place of the record that the model explains far better than the others, and its cost.

    Each record comes with the samples by which the input ``column`` is earlier in it. The cost includes the
    deviance of that input relative to the first record. Brief fits propose a record and thorough ones confirm
    it: a brief fit may stay in a local minimum that is far worse than another's best.
    """
    # an output depends on one more sample of an input that is straight between samples
    newest = [earlier + (record.input_holds[column] is Hold.LINEAR) for record, earlier in records]
    original = records[0][0]
    deviances = np.array([_input_deviance(original, column, n, options) for n in newest])
    candidates = [record for record, _ in records]
    brief_fits = _fits(model, candidates, options, thorough=False)
    if _clearly_best(brief_fits, deviances, options) is None:
        return None
    fits = _fits(model, candidates, options, thorough=True)
    best = _clearly_best(fits, deviances, options)
    return None if best is None else (best, fits[best].solution.cost + float(deviances[best] - deviances[0]))


def _is_explained_by_play(model: Model, record: Record, cost: float, options: TimingOptions) -> bool:
    """Whether play explains a record as well as a late input of this cost does."""
    max_cost = cost + 2.0 * options.min_log_likelihood_difference
    for play in options.play_terms:
        fits = _fits(model, [record], options, thorough=True, more=(play,)) if play in model.terms else []
        if any(fit.solution.cost < max_cost for fit in fits):
            return True
    return False


def _fits(
    model: Model,
    records: Iterable[Record],
    options: TimingOptions,
    *,
    thorough: bool,
    more: Sequence[str] = (),
) -> list[Fitted]:
    """A fit to each record of the compared terms and ``more``; empty where a fit fails."""
    terms = [term for term in (*options.terms, *more) if term in model.terms]
    length = options.window_in_horizons * model.horizon
    fit = partial(fit_terms, new_terms=(), thorough=thorough)
    if not thorough:
        fit = partial(fit, iterations=options.iterations_of_brief_fit)
    try:
        return [fit(model, r, terms, length, noise_of(r)) for r in records]
    except (UsageError, np.linalg.LinAlgError):
        return []


def _clearly_best(fits: list[Fitted], deviances: FloatArray, options: TimingOptions) -> int | None:
    """The place of a fit that is far better than the first, or of the first if far better than all others."""
    if not fits:
        return None
    costs = np.array([fit.solution.cost for fit in fits]) + deviances
    best = int(np.argmin(costs))
    rival_cost = costs[0] if best else np.min(costs[1:])
    is_clear = rival_cost - costs[best] > 2.0 * options.min_log_likelihood_difference
    return best if is_clear and fits[best].noise < options.max_noise_ratio else None
