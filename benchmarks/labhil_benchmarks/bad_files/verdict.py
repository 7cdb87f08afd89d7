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
        """Count a case with the ``faults`` of its outcome."""
        self.cases += 1
        self.read += outcome.status in (0, 1)
        self.refused += outcome.status == 2
        self.worst_seconds = max(self.worst_seconds, round(outcome.seconds, 2))
        self.worst_megabytes = max(self.worst_megabytes, round(outcome.memory / 1e6, 1))
        self.faults += [f"{case.number}: labhil {' '.join(case.command)}: {fault}" for fault in faults]


def try_case(case: Case, reader: Reader, place: Path) -> tuple[Outcome, list[str]]:
    """Run a case in a new folder; return its outcome and the faults in it."""
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
    return outcome, [
        *_faults_of_outcome(case, outcome),
        *_faults_of_files(before, _contents(place), outcome, case),
    ]


def _output(case: Case) -> str | None:
    """What the command is to write."""
    flags = [k for k, part in enumerate(case.command) if part in ("-o", "--json")]
    return case.command[flags[0] + 1] if flags else None


def _faults_of_outcome(case: Case, outcome: Outcome) -> list[str]:
    faults = []
    if outcome.traceback or "Traceback (most recent" in outcome.err:
        lines = (outcome.traceback or outcome.err).strip().splitlines()
        where = [line.strip() for line in lines if line.lstrip().startswith("File ")][-1:]
        faults.append(f"traceback: {lines[-1][:200]} {''.join(where)}")
    elif outcome.status < 0:
        faults.append(f"ended by signal {-outcome.status}")
    elif outcome.status not in ((0, 1, 2) if case.gate else (0, 2)):
        faults.append(f"exit status {outcome.status}: {outcome.err[-200:]}")
    elif outcome.status == 2 and not any(name in outcome.err for name in (*case.files, case.bad, "out.")):
        faults.append(f"the message does not name a file: {outcome.err[-200:]!r}")
    if outcome.seconds > SECONDS:
        faults.append(f"took {outcome.seconds:.1f} s")
    if outcome.memory > BYTES:
        faults.append(f"took {outcome.memory / 1e6:.0f} MB")
    if any(printable(text) != text for text in (outcome.out, outcome.err)):
        faults.append("printed characters that steer a terminal")
    return faults


def _contents(place: Path) -> Mapping[str, bytes]:
    contents = {}
    for folder, _, names in os.walk(place):
        for name in names:
            path = Path(folder) / name
            contents[str(path.relative_to(place))] = path.read_bytes()
    return contents


def _faults_of_files(
    before: Mapping[str, bytes], after: Mapping[str, bytes], outcome: Outcome, case: Case
) -> list[str]:
    """Files that were overwritten, deleted, or left beside the requested output."""
    out = _output(case)
    target = "" if out is None else f"work/{out}"
    may_write = outcome.status in (0, 1)
    faults = []
    for name, content in before.items():
        if after.get(name) != content and not (name == target and may_write):
            faults.append(f"changed {name}")
    for name in after:
        wanted = may_write and bool(target) and (name == target or name.startswith(f"{target}/"))
        if name not in before and not wanted:
            faults.append(f"left {name!r}")
    if b"<script>alert" in after.get("work/out.html", b""):
        faults.append("a page with a script of others")
    if (
        target in after
        and case.command[0] == "recover"
        and before.get(target, after[target]) != after[target]
    ):
        faults.append("recover has overwritten a file")
    return faults
