"""Bad files of every kind, a few of each; ``measure_bad_files.py`` makes ten thousand."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any
from unittest.mock import patch

import pytest

from labhil_benchmarks.bad_files import kinds, samples
from labhil_benchmarks.bad_files.harm import harmful_cases
from labhil_benchmarks.bad_files.kinds import SHARES, Case, make_cases
from labhil_benchmarks.bad_files.reader import Outcome, Reader
from labhil_benchmarks.bad_files.verdict import Tally, try_case

SPOILERS = (
    "spoil_bytes",
    "spoil_database",
    "spoil_encoding",
    "spoil_mat",
    "spoil_mcap",
    "spoil_tree",
    "spoil_zip",
)
MADE: dict[str, Any] = {
    "random_csv": lambda draw: samples.comma_text().encode(),
    "random_toml": lambda draw, whole: whole.encode(),
    "random_json": lambda draw, whole: json.dumps(whole).encode(),
    **dict.fromkeys(SPOILERS, lambda data, draw: data.encode() if isinstance(data, str) else data),
}
WHOLE = Case("whole", 1, {"a.toml": b""}, ("info", "a.mcap"), "a.mcap")


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[Reader]:
    (tmp_path / "reader").mkdir()
    with Reader(tmp_path / "reader") as one:
        yield one


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_every_command_reads_the_files_before_they_are_spoilt(reader: Reader, tmp_path: Path) -> None:
    """Otherwise the cases would only show that something else is refused."""
    with patch.multiple(kinds, **MADE):
        # of every third an output exists before, which is a fault of another kind
        cases = [make(Random(1), number) for make, _ in SHARES for number in (1, 2, 4, 5)]
    found = {}
    for case in cases:
        outcome, faults = try_case(case, reader, tmp_path / "case")
        if faults or outcome.status:
            found[case.kind, case.number, case.command] = outcome.err, faults
    assert found == {}


@pytest.mark.extended
@pytest.mark.timeout(300)
def test_bad_files_are_read_or_refused(reader: Reader, tmp_path: Path) -> None:
    tally = Tally()
    harmful = harmful_cases()[::17]
    for make in [*make_cases(80, seed=2), *harmful]:
        case = make()
        tally.add(case, *try_case(case, reader, tmp_path / "case"))
    assert tally.faults == []
    assert min(tally.read, tally.refused) > 20


@pytest.mark.parametrize(
    ("outcome", "fault"),
    [
        (Outcome(1, 0.1, 0, "", "", "Traceback\nKeyError: 'a'"), "traceback: KeyError: 'a'"),
        (Outcome(-11, 0.1, 0, "", ""), "ended by signal 11"),
        (Outcome(1, 0.1, 0, "", "no"), "exit status 1: no"),
        (Outcome(2, 0.1, 0, "", "no"), "the message does not name a file: 'no'"),
        (Outcome(0, 21.0, 0, "", ""), "took 21.0 s"),
        (Outcome(0, 0.1, 2 * 10**9, "", ""), "took 2000 MB"),
        (Outcome(0, 0.1, 0, "a\x1b[31m", ""), "printed characters that steer a terminal"),
    ],
)
def test_a_fault_is_seen(tmp_path: Path, outcome: Outcome, fault: str) -> None:
    class Finished:
        def run(self, command: tuple[str, ...], folder: Path) -> Outcome:
            return outcome

    _, faults = try_case(WHOLE, Finished(), tmp_path / "case")  # type: ignore[arg-type]
    assert [one.strip() for one in faults] == [fault]


def test_a_file_that_was_changed_or_left_is_seen(tmp_path: Path) -> None:
    class Careless:
        def run(self, command: tuple[str, ...], folder: Path) -> Outcome:
            (folder / "a.toml").write_bytes(b"x")
            (folder.parent / "outside").unlink()
            (folder / "new").write_bytes(b"x")
            return Outcome(0, 0.1, 0, "", "")

    _, faults = try_case(WHOLE, Careless(), tmp_path / "case")  # type: ignore[arg-type]
    assert sorted(faults) == ["changed outside", "changed work/a.toml", "left 'work/new'"]
