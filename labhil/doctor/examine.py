"""All checks in their order; a check that raises is a finding, too."""

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
    """Run all checks and yield their findings; recordings would go to ``folder``."""
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
        except Exception as error:  # noqa: BLE001 - an unusual machine may break any check
            yield broken(name, f"could not be checked: {error!r}", "please report this as a bug")


def format_finding(finding: Finding) -> str:
    """Format a finding for a person."""
    advice = f"\n      → {finding.advice}" if finding.advice else ""
    return f"{MARKS[finding.state]}  {finding.subject}: {finding.found}{advice}"


def to_json(findings: list[Finding]) -> dict[str, Any]:
    """Return all findings as JSON data."""
    return {
        "schema": "labhil.doctor/1",
        "fine": not any(finding.state is State.BROKEN for finding in findings),
        "findings": [finding.to_json() for finding in findings],
    }
