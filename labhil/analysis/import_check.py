"""Checks of an imported table: faults of the data, and the hold of its inputs between samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from labhil.diagnose.hold import detect_hold
from labhil.diagnose.timing import detect_all_faults, estimate_hold
from labhil.identify.windows import FEWEST_SAMPLES, with_least_noise
from labhil.physics.record import Record
from labhil.physics.rigs import model_for, record_of_samples, unusable_values
from labhil.recording.tables import ImportedTable
from labhil.signals import Hold

HOLD_NAMES = {Hold.ZERO: "held", Hold.LINEAR: "straight"}


def check_table(
    table: ImportedTable, progress: Callable[[str], None] = lambda text: None
) -> tuple[ImportedTable, list[str]]:
    """Estimate the holds that the rig file does not state, and look for faults.

    Args:
        table: The table.
        progress: Called with a line of text before a long stage.

    Returns:
        The table with these holds, and lines of text about holds and faults.
    """
    record = record_of_samples(table.stream, table.t, table.values, table.rig.kind)
    if record is None or len(record) < FEWEST_SAMPLES:
        return table, []
    unusable = unusable_values(record)
    if unusable:
        return table, [f"! {unusable}; no model can calculate with them"]
    table, record, lines = _with_holds(table, record, progress)
    record = with_least_noise(record)
    model = model_for(table.rig, record)
    return table, [*lines, *(f"! {fault.statement}" for fault in detect_all_faults(model, record))]


def _with_holds(
    table: ImportedTable, record: Record, progress: Callable[[str], None]
) -> tuple[ImportedTable, Record, list[str]]:
    """Return table and record with the hold of each input, and a line about each."""
    if record.has_joints:
        # inverse dynamics uses measured positions and rates of joints only at their samples
        return table, record, []
    holds, lines = {}, []
    for index, name in enumerate(record.input_names):
        holds[name], line = _choose_hold(table, record, index, progress)
        lines.append(line)
    signals = tuple(replace(s, hold=holds.get(s.name, s.hold)) for s in table.stream.signals)
    changed_table = replace(table, stream=replace(table.stream, signals=signals))
    return changed_table, record.with_holds(holds), lines


def _choose_hold(
    table: ImportedTable, record: Record, index: int, progress: Callable[[str], None]
) -> tuple[Hold, str]:
    """Choose the hold of an input, and return it with a line about it."""
    name, default = record.input_names[index], record.input_holds[index]
    channel = table.rig.channels.get(name)
    if channel is not None and channel.hold is not None:
        return default, f"{name}: {HOLD_NAMES[default]} between samples, as [channels] states"
    hold, reason = detect_hold(record.inputs[:, index]), "it jumps between levels"
    if hold is None and len(record.input_names) == 1:
        progress(f"comparing {name} held and straight between samples")
        hold, reason = estimate_hold(model_for(table.rig, record), record), "since a model predicts better so"
    if hold is None:
        hold, reason = default, f"as is usual for {table.rig.kind.name}"
    key = f'[channels] {name} = {{ …, hold = "{"linear" if hold is Hold.ZERO else "zero"}" }} says otherwise'
    return hold, f"{name}: {HOLD_NAMES[hold]} between samples, {reason}; {key}"
