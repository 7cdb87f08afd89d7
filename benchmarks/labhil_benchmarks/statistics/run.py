"""Run a benchmark: trial after trial on all cores, each result kept as soon as it is there."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from labhil.analysis.results import finite
from labhil.atomic_file import atomic_file
from labhil.errors import UnknownNameError, UsageError
from labhil_benchmarks.statistics.cases import CASES
from labhil_benchmarks.statistics.kept import Job, Progress, each_once, numbers
from labhil_benchmarks.statistics.starts import Arrival, Arrivals, arrive
from labhil_benchmarks.statistics.summary import Summary, summarise
from labhil_benchmarks.statistics.trial import Case, Row, Trial, run_trial


def run_benchmark(
    names: Sequence[str], recordings: int, out: Path, progress: Progress, *, first_seed: int = 0
) -> list[Summary]:
    """Run the cases ``names`` on so many recordings with white and as many with coloured noise.

    Trials that stand in ``out`` already are not run again, so that an interrupted benchmark goes on.
    """
    cases = _cases(names, "--recordings", recordings, out)
    summaries: list[Summary] = []
    for case in cases:
        seeds = range(first_seed, first_seed + recordings)
        wanted = [(case.name, seed, coloured) for seed in seeds for coloured in (False, True)]
        done = each_once(wanted, _run_one, out / f"{case.name}.jsonl", _trial, _job_of, progress)
        kinds = ([trial for trial in done if trial.coloured is coloured] for coloured in (False, True))
        summaries.extend(summarise(case, trials) for trials in kinds)
    _write([s.to_json() for s in summaries], out / "summary.json")
    return summaries


def run_starts(names: Sequence[str], starts: int, out: Path, progress: Progress) -> list[Arrivals]:
    """Fit one recording of each case from so many random starts within the bounds, kept likewise."""
    arrivals = []
    for case in _cases(names, "--starts", starts, out):
        # number 0 begins at the truth: where it ends is the optimum, unless a start ends lower
        wanted = [(case.name, number) for number in range(starts + 1)]
        path = out / f"{case.name}.starts.jsonl"
        done = each_once(wanted, _from_start, path, lambda d: Arrival(**numbers(d)), _start_of, progress)
        arrivals.append(Arrivals(case.name, tuple(done)))
    _write([arrived.to_json() for arrived in arrivals], out / "starts.json")
    return arrivals


def _cases(names: Sequence[str], option: str, count: int, out: Path) -> list[Case]:
    for name in names:
        if name not in CASES:
            raise UnknownNameError("benchmark case", name, CASES)
    if count < 2:
        raise UsageError(f"{option}: expected at least 2, found {count}")
    out.mkdir(parents=True, exist_ok=True)
    return [CASES[name] for name in names]


def _write(data: list[dict[str, Any]], path: Path) -> None:
    text = json.dumps([finite(each) for each in data], ensure_ascii=False, indent=1)
    with atomic_file(path, "the result") as draft:
        draft.write_text(text + "\n", encoding="utf-8")


def _run_one(name: str, seed: int, coloured: bool) -> Trial:
    return run_trial(CASES[name], seed, coloured)


def _from_start(name: str, number: int) -> Arrival:
    return arrive(CASES[name], number)


def _job_of(trial: Trial) -> Job:
    return trial.case, trial.seed, trial.coloured


def _start_of(arrival: Arrival) -> Job:
    return arrival.case, arrival.number


def _trial(data: dict[str, Any]) -> Trial:
    rows = tuple(Row(**numbers(row, float("inf"))) for row in data["rows"])
    return Trial(**{**numbers(data), "rows": rows})
