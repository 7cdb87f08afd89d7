"""What a command on a bad file may do, and what is a fault."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from labhil.terminal import printable
from labhil_benchmarks.bad_files.kinds import Case
from labhil_benchmarks.bad_files.reader import Outcome, Reader

SECONDS = 20.0
BYTES = 1_000_000_000
OUTSIDE = "outside"
MINE = b"mine"


@dataclass
class Tally:
    """What came of the cases of a kind."""

    cases: int = 0
    read: int = 0
    refused: int = 0
    worst_seconds: float = 0.0
    worst_megabytes: float = 0.0
    faults: list[str] = field(default_factory=list)

    def add(self, case: Case, outcome: Outcome, faults: list[str]) -> None:
        """Count a case; ``faults`` says what was wrong with what came of it."""
        self.cases += 1
        self.read += outcome.status in (0, 1)
        self.refused += outcome.status == 2
        self.worst_seconds = max(self.worst_seconds, round(outcome.seconds, 2))
        self.worst_megabytes = max(self.worst_megabytes, round(outcome.memory / 1e6, 1))
        self.faults += [f"{case.number}: labhil {' '.join(case.command)}: {fault}" for fault in faults]


def tried(case: Case, reader: Reader, place: Path) -> tuple[Outcome, list[str]]:
    """Run a case in a folder made anew, and say what is a fault in what came of it."""
    shutil.rmtree(place, ignore_errors=True)
    work = place / "work"
    work.mkdir(parents=True)
    (place / OUTSIDE).write_bytes(MINE)
    for name, content in case.files.items():
        path = work / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    out = _output(case)
    if out is not None and case.number % 3 == 0 and not out.endswith(".rosbag2"):
        (work / out).write_bytes(MINE)
    before = _contents(place)
    outcome = reader.run(case.command, work)
    return outcome, [*_said(case, outcome), *_left(before, _contents(place), outcome, case)]


def _output(case: Case) -> str | None:
    """What the command is to write."""
    flags = [k for k, part in enumerate(case.command) if part in ("-o", "--json")]
    return case.command[flags[0] + 1] if flags else None


def _said(case: Case, outcome: Outcome) -> list[str]:
    found = []
    if outcome.traceback or "Traceback (most recent" in outcome.err:
        lines = (outcome.traceback or outcome.err).strip().splitlines()
        where = [line.strip() for line in lines if line.lstrip().startswith("File ")][-1:]
        found.append(f"traceback: {lines[-1][:200]} {''.join(where)}")
    elif outcome.status < 0:
        found.append(f"ended by signal {-outcome.status}")
    elif outcome.status not in ((0, 1, 2) if case.gate else (0, 2)):
        found.append(f"exit status {outcome.status}: {outcome.err[-200:]}")
    elif outcome.status == 2 and not any(name in outcome.err for name in (*case.files, case.bad, "out.")):
        found.append(f"the message does not name a file: {outcome.err[-200:]!r}")
    if outcome.seconds > SECONDS:
        found.append(f"took {outcome.seconds:.1f} s")
    if outcome.memory > BYTES:
        found.append(f"took {outcome.memory / 1e6:.0f} MB")
    if any(printable(text) != text for text in (outcome.out, outcome.err)):
        found.append("printed characters that steer a terminal")
    return found


def _contents(place: Path) -> Mapping[str, bytes]:
    found = {}
    for folder, _, names in os.walk(place):
        for name in names:
            path = Path(folder) / name
            found[str(path.relative_to(place))] = path.read_bytes()
    return found


def _left(before: Mapping[str, bytes], after: Mapping[str, bytes], outcome: Outcome, case: Case) -> list[str]:
    """What was overwritten, taken away, or left where nothing was asked for."""
    out = _output(case)
    asked = "" if out is None else f"work/{out}"
    may_write = outcome.status in (0, 1)
    found = []
    for name, content in before.items():
        if after.get(name) != content and not (name == asked and may_write):
            found.append(f"changed {name}")
    for name in after:
        wanted = may_write and bool(asked) and (name == asked or name.startswith(f"{asked}/"))
        if name not in before and not wanted:
            found.append(f"left {name!r}")
    if b"<script>alert" in after.get("work/out.html", b""):
        found.append("a page with a script of others")
    if asked in after and case.command[0] == "recover" and before.get(asked, after[asked]) != after[asked]:
        found.append("recover has overwritten a file")
    return found
