"""Run a benchmark: trial after trial on all cores, each result kept as soon as it is there."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

from labhil.campaign.benchmark.cases import CASES
from labhil.campaign.benchmark.summary import Summary, summarise
from labhil.campaign.benchmark.trial import Row, Trial, run_trial
from labhil.errors import UnknownNameError, UsageError
from labhil.report.results import finite

Progress = Callable[[str], None]


def run_benchmark(
    names: Sequence[str], recordings: int, out: Path, progress: Progress, *, first_seed: int = 0
) -> list[Summary]:
    """Run the cases ``names`` on so many recordings with white and as many with coloured noise.

    Trials that stand in ``out`` already are not run again, so that an interrupted benchmark goes on.
    """
    for name in names:
        if name not in CASES:
            raise UnknownNameError("benchmark case", name, CASES)
    if recordings < 2:
        raise UsageError(f"--recordings: expected at least 2, found {recordings}")
    out.mkdir(parents=True, exist_ok=True)
    summaries = []
    for name in names:
        done = _trials(name, range(first_seed, first_seed + recordings), out / f"{name}.jsonl", progress)
        for coloured in (False, True):
            chosen = [trial for trial in done if trial.coloured is coloured]
            summaries.append(summarise(CASES[name], chosen))
    text = json.dumps([finite(s.to_json()) for s in summaries], ensure_ascii=False, indent=1)
    (out / "summary.json").write_text(text + "\n", encoding="utf-8")
    return summaries


def _trials(name: str, seeds: range, path: Path, progress: Progress) -> list[Trial]:
    """All trials of a case, those that are missing run and appended to ``path``."""
    done = {(t.seed, t.coloured): t for t in _read(path)}
    wanted = [(seed, coloured) for seed in seeds for coloured in (False, True)]
    missing = [pair for pair in wanted if pair not in done]
    if missing:
        with path.open("a", encoding="utf-8") as file, ProcessPoolExecutor(os.cpu_count()) as executor:
            futures = [executor.submit(_one, name, seed, coloured) for seed, coloured in missing]
            try:
                for count, future in enumerate(as_completed(futures), 1):
                    trial = future.result()
                    file.write(json.dumps(finite(asdict(trial)), ensure_ascii=False) + "\n")
                    file.flush()
                    done[trial.seed, trial.coloured] = trial
                    progress(f"{name}: {count} of {len(missing)} recordings")
            except KeyboardInterrupt:
                executor.shutdown(cancel_futures=True)
                raise
    return [done[pair] for pair in wanted]


def _one(name: str, seed: int, coloured: bool) -> Trial:
    return run_trial(CASES[name], seed, coloured)


def _read(path: Path) -> list[Trial]:
    if not path.exists():
        return []
    return [_trial(json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines() if line]


def _trial(data: dict[str, Any]) -> Trial:
    rows = tuple(Row(**_numbers(row, float("inf"))) for row in data["rows"])
    return Trial(**{**_numbers(data, float("nan")), "rows": rows})


def _numbers(data: dict[str, Any], absent: float) -> dict[str, Any]:
    """JSON has no infinities: null is what was not finite."""
    return {key: absent if value is None else value for key, value in data.items()}
