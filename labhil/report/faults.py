"""Faults of the data, as lines before the table of a fit."""

from __future__ import annotations

from collections.abc import Sequence

from labhil.analysis.schema import Fault
from labhil.diagnose.fault import FaultKind

HARMLESS = (FaultKind.GAP, FaultKind.NO_EXCITATION)
"""What takes nothing from the numbers of a fit but data."""


def fault_lines(faults: Sequence[Fault]) -> list[str]:
    """Return a line for each fault, and a warning where the values of a fit suffer from them."""
    if not faults:
        return []
    lines = [f"! {fault.statement}" for fault in faults]
    if any(fault.kind not in HARMLESS and not fault.mended for fault in faults):
        lines.append(
            "! The values below are fitted to these data as they are: do not rely on their intervals."
        )
    return lines
