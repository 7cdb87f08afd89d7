"""Which way the channels of a rig should answer a step, and whether their sizes are plausible."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from labhil.device_check.samples import Samples
from labhil.device_check.small_step import Answer
from labhil.doctor.finding import Finding, broken
from labhil.errors import UnknownNameError
from labhil.extras import require_analysis
from labhil.physics.model import Metric, Model, index_of, start_values, starts_of, terms_named
from labhil.physics.record import Record, Windows
from labhil.physics.rigs import model_for, record_of_samples, rig_model
from labhil.rig import RigFile
from labhil.signals import FloatArray

MIN_SAMPLES = 16
"""Least number of samples whose sizes are judged, as in ``identify.plausibility``."""


def simulated_answer(answer: Answer, rig: RigFile) -> dict[str, FloatArray]:
    """Simulate a step by the model of the rig, from typical sizes where the rig file states none.

    Args:
        answer: The measured answer to the step, with the inputs that were in effect.
        rig: The rig file.

    Returns:
        What the step changes in each output of the model, by column, each (n,), as long as ``answer.after``;
        nothing for a rig without a model, or one of inverse dynamics: there friction decides on the sign of a
        small change.

    Raises:
        MissingExtraError: The packages of the analysis are not installed.
    """
    require_analysis("the direction that a model expects")
    whole = Samples.joined([answer.before, answer.after])
    record = record_of_samples(whole.stream, whole.t, whole.values, rig.kind)
    if record is None:
        return {}
    is_complete = len(record.output_names) == sum(signal.width for signal in rig.kind.outputs)
    try:
        # sizes that are estimated from the record might take its sign, too; typical ones do not
        model = model_for(rig, None if is_complete else record)
    except UnknownNameError:
        return {}
    if model.metric is Metric.INVERSE_DYNAMICS:
        return {}
    windows = Windows.of([(0, len(record))])
    theta, states = _typical_sizes(model, record, rig), model.initial_states(record, windows)
    rest = np.median(record.inputs[: len(answer.before)], axis=0)
    still = replace(record, inputs=np.tile(rest, (len(record), 1)))
    caused = model.simulate(theta, record, windows, states) - model.simulate(theta, still, windows, states)
    return dict(zip(record.output_names, caused[len(answer.before) :].T, strict=True))


def _typical_sizes(model: Model, record: Record, rig: RigFile) -> FloatArray:
    """Parameters with the friction of the baseline at its first start, so that motions decay."""
    theta = start_values(model.parameters)
    places = index_of(model.parameters)
    starts = starts_of(model, terms_named(model, rig_model(rig.kind.name).baseline), record)
    for name, value in starts[min(1, len(starts) - 1)].items():
        theta[places[name]] = value
    return theta


def implausible_sizes(samples: Samples, rig: RigFile) -> Iterator[Finding]:
    """Find channels that are larger than such a rig can be: they come in another unit than stated."""
    record = record_of_samples(samples.stream, samples.t, samples.values, rig.kind)
    if record is None or len(record) < MIN_SAMPLES or not np.isfinite(record.outputs).all():
        return
    known = {name: value for name in rig.kind.known if (value := rig.known_number(name)) is not None}
    try:
        facts = rig_model(rig.kind.name).facts_of(record, known)
    except UnknownNameError:
        return
    for fact in facts:
        if not fact.dynamic and not fact.holds():
            yield broken(
                ", ".join(fact.powers),
                f"{fact.what} is {fact.value:.4g} {fact.unit}, expected {fact.low:.4g} to {fact.high:.4g}: "
                f"{fact.because}",
                "see in which unit the driver or the firmware scales it, and what [known] states",
            )
