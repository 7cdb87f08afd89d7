"""What an import can see of its table at once: faults of the data, and how its inputs run between samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from labhil.diagnose.hold import evident_hold
from labhil.diagnose.intake import faults_of
from labhil.errors import UsageError
from labhil.identify.fitted import Fitted, fit_terms
from labhil.identify.windows import noise_of, with_least_noise
from labhil.physics.model import Metric, Model, Record
from labhil.physics.rigs import model_for, record_of_samples, rig_model
from labhil.recording.tables import ImportedTable
from labhil.signals import Hold

MOST_SAMPLES = 1000
"""That two fits compare: what half a sample does to a simulation is far above the noise in fewer."""

IN_HORIZONS = 0.1875
"""Length of their windows: short ones lead to the neighbourhood of the estimates from any start."""

FEWEST_SAMPLES = 200
"""From which they are compared."""

TO_THE_NOISE = 1.2
"""RMSE over noise up to which a model is right enough to time an input: what it lacks looks like delay."""

FAR_BETTER = 20.0
"""Difference of log likelihoods: odds of 1 to 5e8, for what then counts as known."""

DRY = "coulomb_friction"
"""What nearly every rig has beyond its baseline, and what delays its answers."""

WORDS = {Hold.ZERO: "held", Hold.LINEAR: "straight"}


def checked(
    table: ImportedTable, progress: Callable[[str], None] = lambda text: None
) -> tuple[ImportedTable, list[str]]:
    """Guess the holds that the rig file does not state, and look for faults.

    Returns the table with these holds, and what to print, a line each.
    """
    record = record_of_samples(table.stream, table.t, table.values, table.rig.kind)
    if record is None or len(record) < 2:
        return table, []
    table, record, lines = _with_holds(table, record, progress)
    faults = faults_of(with_least_noise(record))
    return table, [*lines, *(f"! {fault.statement}" for fault in faults)]


def _with_holds(
    table: ImportedTable, record: Record, progress: Callable[[str], None]
) -> tuple[ImportedTable, Record, list[str]]:
    """The table and its record with the hold of each input, and a line about each."""
    if len(record.input_names) != 1:
        # positions and rates of joints are measured; inverse dynamics takes them at their samples
        return table, record, []
    name, default = record.input_names[0], record.input_holds[0]
    channel = table.rig.channels.get(name)
    if channel is not None and channel.hold is not None:
        return table, record, [f"{name}: {WORDS[default]} between samples, as [channels] states"]
    hold, why = evident_hold(record.inputs[:, 0]), "it jumps between levels"
    if hold is None:
        hold, why = _better_hold(table, record, progress)
    key = f'[channels] {name} = {{ …, hold = "{"linear" if hold is Hold.ZERO else "zero"}" }} says otherwise'
    signals = tuple(replace(s, hold=hold) if s.name == name else s for s in table.stream.signals)
    changed = replace(table, stream=replace(table.stream, signals=signals))
    return (
        changed,
        replace(record, input_holds=(hold,)),
        [f"{name}: {WORDS[hold]} between samples, {why}; {key}"],
    )


def _better_hold(table: ImportedTable, record: Record, progress: Callable[[str], None]) -> tuple[Hold, str]:
    """The hold by which the rig's model predicts better, and why; the rig kind's own where none is sure."""
    default = record.input_holds[0]
    usual = default, f"as is usual for a {table.rig.kind.name}"
    part = with_least_noise(record).part(0, MOST_SAMPLES)
    if len(part) < FEWEST_SAMPLES or not np.isfinite(np.hstack([part.inputs, part.outputs])).all():
        return usual
    progress(f"comparing {record.input_names[0]} held and straight between samples")
    try:
        held, straight = (_fitted(table, replace(part, input_holds=(hold,))) for hold in WORDS)
    except (UsageError, np.linalg.LinAlgError):
        return usual
    better = held if held.solution.cost < straight.solution.cost else straight
    gain = abs(held.solution.cost - straight.solution.cost)
    if gain < 2.0 * FAR_BETTER or better.noise > TO_THE_NOISE:
        return usual
    return (Hold.ZERO if better is held else Hold.LINEAR), "since a model predicts better so"


def _fitted(table: ImportedTable, record: Record) -> Fitted:
    """The rig's baseline with dry friction, on windows of its search."""
    model: Model = model_for(table.rig, record)
    if model.metric is not Metric.WINDOWED_SIMULATION:
        raise UsageError("expected a rig that is judged by simulated windows")
    terms = [t for t in dict.fromkeys((*rig_model(model.kind).baseline, DRY)) if t in model.terms]
    length = IN_HORIZONS * model.horizon
    return fit_terms(model, record, terms, length, noise_of(record), new_terms=(), thorough=False)
