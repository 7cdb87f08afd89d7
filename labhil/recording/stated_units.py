"""Comparison of the units that a table states with those of its signals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labhil.errors import TableError
from labhil.recording.sheet import MappedSignal, Sheet
from labhil.recording.units import INTERNAL_UNITS, ROTARY_EQUIVALENTS, Unit, parse_unit, unit_in_name


def check_units(sheet: Sheet, signals: Sequence[MappedSignal]) -> tuple[str, ...]:
    """Compare the units that a table states with those of its signals without a scale in the rig file.

    Args:
        sheet: the table.
        signals: its signals.

    Returns:
        A line for each unit of another quantity.

    Raises:
        TableError: A unit differs by a known factor; it shows a ``[channels]`` table with the factors.
    """
    mismatched: dict[str, tuple[str, Unit]] = {}
    implausible = []
    for mapped in signals:
        stated = _stated_unit(sheet, mapped.columns[0])
        if (
            stated is None
            or mapped.signal.unit not in INTERNAL_UNITS
            or _has_scale(sheet, mapped.signal.name)
        ):
            continue
        where, text, unit = stated
        if unit.quantity in (mapped.signal.unit, _rotary_equivalent(sheet, mapped.signal.unit)):
            if (unit.scale, unit.offset) != (1.0, 0.0):
                mismatched[mapped.signal.name] = f"{mapped.signal.name} in {text} ({where})", unit
        else:
            implausible.append(
                f"{where} states {text} for {mapped.signal.name}, which is in {mapped.signal.unit}: numbers "
                f"count as {mapped.signal.unit} until [channels] gives a scale"
            )
    if mismatched:
        raise TableError(_proposed_channels(sheet, signals, mismatched))
    return tuple(implausible)


def _stated_unit(sheet: Sheet, column: int) -> tuple[str, str, Unit] | None:
    """Place, text and meaning of the unit that a column states."""
    units = sheet.columns.units
    if column < len(units) and (unit := parse_unit(units[column])) is not None:
        return "the line of units below the header", units[column].strip().strip("[]()\"' "), unit
    names = sheet.columns.names
    in_name = unit_in_name(names[column]) if names is not None else None
    return None if in_name is None else (f"the name of column {sheet.column(column)}", *in_name)


def _has_scale(sheet: Sheet, name: str) -> bool:
    channel = sheet.rig.channels.get(name)
    return channel is not None and not channel.model_fields_set.isdisjoint({"scale", "offset"})


def _rotary_equivalent(sheet: Sheet, unit: str) -> str | None:
    return ROTARY_EQUIVALENTS.get(unit) if sheet.rig.kind.name == "axis" else None


def _proposed_channels(
    sheet: Sheet, signals: Sequence[MappedSignal], mismatched: dict[str, tuple[str, Unit]]
) -> str:
    expected = [
        f"{mapped.signal.name} in {mapped.signal.unit}"
        for mapped in signals
        if mapped.signal.name in mismatched
    ]
    texts = [text for text, _ in mismatched.values()]
    units = {name: unit for name, (_, unit) in mismatched.items()}
    return "\n".join(
        [
            f"{sheet.path}: expected {', '.join(expected)}, found {', '.join(texts)}; write into "
            f"{sheet.rig.path} (scale = 1.0 for what is in our unit all the same):",
            "[channels]",
            *(format_channel(sheet, mapped, units.get(mapped.signal.name)) for mapped in signals),
        ]
    )


def format_channel(sheet: Sheet, mapped: MappedSignal, unit: Unit | None = None) -> str:
    """Format a line of ``[channels]`` for a signal, with the scale and offset of a unit."""
    sources = [sheet.source(column) for column in mapped.columns]
    parts = [f"column = {sources[0]}" if len(sources) == 1 else f"columns = [{', '.join(sources)}]"]
    scale = mapped.scale.tolist() if unit is None else [unit.scale] * len(sources)
    offset = mapped.offset.tolist() if unit is None else [unit.offset] * len(sources)
    for name, values, default in (("scale", scale, 1.0), ("offset", offset, 0.0)):
        if any(value != default for value in values):
            same = bool(np.ptp(values) == 0)
            parts.append(f"{name} = {values[0]!r}" if same else f"{name} = {values!r}")
    return f"{mapped.signal.name} = {{ {', '.join(parts)} }}"
