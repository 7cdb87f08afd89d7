"""Chapter 5 of the reference text, table by table: its values, ours, the truth, and what the data allow."""

from __future__ import annotations

from labhil_benchmarks.reference.command import reference_command
from labhil_benchmarks.reference.result import Reference
from labhil_benchmarks.reference.run import run_reference

__all__ = ["Reference", "reference_command", "run_reference"]
