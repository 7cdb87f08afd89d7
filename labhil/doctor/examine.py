"""All checks in their order; one that fails in itself is a finding too."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from labhil.doctor.finding import Check, Finding, State, broken
from labhil.doctor.machine import (
    check_clock,
    check_cores,
    check_disk,
    check_real_time,
    check_serial,
    check_timer,
)
from labhil.doctor.packages import check_packages, check_python
from labhil.doctor.probes import check_probes

MARKS = {State.FINE: "ok  ", State.NOTE: "note", State.BROKEN: "FAIL"}


def examine(folder: Path) -> Iterator[Finding]:
    """Look at everything, one finding after another; recordings would go to ``folder``."""
    checks: dict[str, Check] = {
        "python": check_python,
        "packages": check_packages,
        "probes": check_probes,
        "cores": check_cores,
        "clock": check_clock,
        "timer": check_timer,
        "disk": partial(check_disk, folder),
        "serial ports": check_serial,
        "real time": check_real_time,
    }
    for name, check in checks.items():
        try:
            yield from check()
        except Exception as error:  # noqa: BLE001 - a machine that is odd enough breaks any check
            yield broken(name, f"could not be looked at: {error!r}", "say so in a bug report")


def line(finding: Finding) -> str:
    """A finding as a person reads it."""
    advice = f"\n      → {finding.advice}" if finding.advice else ""
    return f"{MARKS[finding.state]}  {finding.subject}: {finding.found}{advice}"


def to_json(findings: list[Finding]) -> dict[str, Any]:
    """All findings as plain JSON data."""
    return {
        "schema": "labhil.doctor/1",
        "fine": not any(finding.state is State.BROKEN for finding in findings),
        "findings": [finding.to_json() for finding in findings],
    }
