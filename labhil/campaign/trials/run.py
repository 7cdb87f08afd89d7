"""``labhil trial run``: diagnose every trial blind, keep each result at once, and hash it.

Diagnoses run in processes of their own that are given the trials' folder and nothing else; there, opening
any envelope (JSON, which no diagnosis has a reason to read) is refused by an audit hook that Python code
cannot take off again.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from types import ModuleType
from typing import Any

from labhil.analysis.dataset import load_dataset
from labhil.analysis.study import diagnose_study
from labhil.campaign.benchmarks import benchmark_module
from labhil.campaign.trials.folder import (
    DIAGNOSE,
    STEPWISE,
    Listed,
    Results,
    read_index,
    recording,
    replace_text,
)
from labhil.campaign.trials.seal import sha256_of
from labhil.errors import UsageError

SCHEMA = "labhil.diagnosis/1"
Progress = Callable[[str], None]


def run_trials(folder: Path, jobs: int, progress: Progress, method: str = DIAGNOSE) -> str:
    """Diagnose the trials that have no result yet, in ``jobs`` processes; the SHA-256 of all hashes.

    A result that is not the one that was hashed is refused. UsageError where recordings are not the
    sealed ones, UnknownNameError for a method that is none.
    """
    if jobs < 1:
        raise UsageError(f"--jobs: expected at least 1, found {jobs}")
    results = Results(folder, method)
    index = read_index(folder)
    for listed in index.trials:
        _check_recordings(folder, listed)
    (folder / results.name).mkdir(exist_ok=True)
    hashes = _kept_hashes(results)
    missing = [listed.name for listed in index.trials if listed.name not in hashes]
    if missing:
        _diagnose_all(results, missing, hashes, jobs, progress)
    return sha256_of(results.hashes)


def _kept_hashes(results: Results) -> dict[str, str]:
    """The hashes of existing results; a result without a hash is diagnosed again."""
    hashes = results.read_hashes()
    for name, expected in hashes.items():
        path = results.of(name)
        if not path.exists() or sha256_of(path) != expected:
            raise UsageError(
                f"{path}: is not the result that {results.hashes.name} names: expected SHA-256 {expected}"
            )
    return hashes


def _check_recordings(folder: Path, listed: Listed) -> None:
    for role, expected in listed.recordings.items():
        path = recording(folder, listed.name, role)
        actual = sha256_of(path)
        if actual != expected:
            raise UsageError(f"{path}: not the sealed recording: expected SHA-256 {expected}, found {actual}")


def _diagnose_all(
    results: Results, names: list[str], hashes: dict[str, str], jobs: int, progress: Progress
) -> None:
    if results.method == STEPWISE:
        _stepwise()  # looked for here: processes that read no JSON cannot ask where it is
    # spawned processes share no memory with this one, whatever it has read
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=keep_envelopes_shut) as executor:
        futures = {
            executor.submit(diagnose_trial, results.folder, name, results.method): name for name in names
        }
        try:
            for count, future in enumerate(as_completed(futures), 1):
                name = futures[future]
                result = future.result()
                path = results.of(name)
                text = json.dumps(result, ensure_ascii=False, allow_nan=False, indent=1)
                replace_text(path, text + "\n")
                hashes[name] = sha256_of(path)
                results.write_hashes(hashes)
                verdict = result["verdict"] or f"failed: {result['error']}"
                progress(f"{count} of {len(names)} trials diagnosed; {name}: {verdict}")
        except BaseException:
            executor.shutdown(cancel_futures=True)
            raise


def _stepwise() -> ModuleType:
    """The rival method, one of the project's benchmarks."""
    return benchmark_module("trials.stepwise", f"--method {STEPWISE}")


def keep_envelopes_shut() -> None:
    """Refuse from now on, in this process, to open any JSON file."""
    sys.addaudithook(_refuse_envelopes)


def _refuse_envelopes(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and isinstance(arguments[0], (str, bytes)):
        name = os.fsdecode(arguments[0])
        if name.lower().endswith(".json"):
            raise PermissionError(f"{name}: a diagnosis of sealed trials opens no envelopes")


def diagnose_trial(folder: Path, name: str, method: str = DIAGNOSE) -> dict[str, Any]:
    """The diagnosis of one trial as JSON data; one that fails has the verdict null and its error."""
    began = time.perf_counter()
    try:
        search, test = (recording(folder, name, role) for role in ("search", "test"))
        material = load_dataset(search, test_path=test)
        result: dict[str, Any] = (
            _stepwise().stepwise_study(material) if method == STEPWISE else diagnose_study(material).json
        )
    except Exception as error:  # noqa: BLE001 - whatever it is, the other trials go on and it is counted
        return {
            "schema": SCHEMA,
            "verdict": None,
            "error": f"{type(error).__name__}: {error}",
            "traceback": traceback.format_exc(),
            "missing": [],
            "rivals": [],
            "seconds": time.perf_counter() - began,
        }
    return result
