"""What an import checks in its table: faults of the data, and how its inputs run between samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from labhil.diagnose.hold import detect_hold
from labhil.diagnose.timing import detect_all_faults, estimate_hold
from labhil.identify.windows import FEWEST_SAMPLES, with_least_noise
from labhil.physics.model import Record
from labhil.physics.rigs import model_for, record_of_samples, unusable_values
from labhil.recording.tables import ImportedTable
from labhil.signals import Hold

WORDS = {Hold.ZERO: "held", Hold.LINEAR: "straight"}


def check_table(
    table: ImportedTable, progress: Callable[[str], None] = lambda text: None
) -> tuple[ImportedTable, list[str]]:
    """Guess the holds that the rig file does not state, and look for faults.

    Returns the table with these holds, and what to print, a line each.
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
    """The table and its record with the hold of each input, and a line about each."""
    if any(joint is not None for joint in record.output_joints):
        # positions and rates of joints are measured; inverse dynamics takes them at their samples
        return table, record, []
    holds, lines = {}, []
    for place, name in enumerate(record.input_names):
        holds[name], line = _choose_hold(table, record, place, progress)
        lines.append(line)
    signals = tuple(replace(s, hold=holds.get(s.name, s.hold)) for s in table.stream.signals)
    changed = replace(table, stream=replace(table.stream, signals=signals))
    return changed, record.with_holds(holds), lines


def _choose_hold(
    table: ImportedTable, record: Record, place: int, progress: Callable[[str], None]
) -> tuple[Hold, str]:
    """How the input ``place`` runs between samples, and a line about it."""
    name, default = record.input_names[place], record.input_holds[place]
    channel = table.rig.channels.get(name)
    if channel is not None and channel.hold is not None:
        return default, f"{name}: {WORDS[default]} between samples, as [channels] states"
    hold, why = detect_hold(record.inputs[:, place]), "it jumps between levels"
    if hold is None and len(record.input_names) == 1:
        progress(f"comparing {name} held and straight between samples")
        hold, why = estimate_hold(model_for(table.rig, record), record), "since a model predicts better so"
    if hold is None:
        hold, why = default, f"as is usual for {table.rig.kind.name}"
    key = f'[channels] {name} = {{ …, hold = "{"linear" if hold is Hold.ZERO else "zero"}" }} says otherwise'
    return hold, f"{name}: {WORDS[hold]} between samples, {why}; {key}"
