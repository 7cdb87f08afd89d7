"""``labhil trial run``: diagnose every trial blind, and write and hash each result at once.

Diagnoses run in separate processes that get the trials' folder only. An audit hook, which Python code cannot
remove, refuses to open any envelope there (JSON, which no diagnosis has a reason to read).
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
    Results,
    check_recordings,
    read_index,
    recording_path,
    write_text_atomically,
)
from labhil.campaign.trials.seal import sha256_of
from labhil.cores import share_cores
from labhil.errors import UsageError
from labhil.physics.rigs import rig_model
from labhil.recording.metadata import read_rig_kinds
from labhil.rig import simulator_rig

SCHEMA = "labhil.diagnosis/1"
Progress = Callable[[str], None]


def run_trials(folder: Path, jobs: int, progress: Progress, method: str = DIAGNOSE) -> str:
    """Diagnose the trials that have no result yet.

    Args:
        folder: a folder of ``labhil trial make``.
        jobs: number of processes.
        progress: is called with a line of text after each trial.
        method: one of ``METHODS``, or a user's own simulator of the rig, as ``--simulator`` takes it.

    Returns:
        SHA-256 of the file of all hashes.

    Raises:
        UsageError: a recording is not the sealed one, or a result is not the one that was hashed.
        UnknownNameError: there is no such method.
    """
    if jobs < 1:
        raise UsageError(f"--jobs: expected at least 1, found {jobs}")
    results = Results(folder, method)
    index = read_index(folder)
    for entry in index.trials:
        check_recordings(folder, entry)
    (folder / results.name).mkdir(exist_ok=True)
    hashes = _existing_hashes(results)
    missing = [entry.name for entry in index.trials if entry.name not in hashes]
    if missing:
        _diagnose_all(results, missing, hashes, jobs, progress)
    return sha256_of(results.hashes)


def _existing_hashes(results: Results) -> dict[str, str]:
    """Read and check the hashes of existing results; a trial without a hash is diagnosed again."""
    hashes = results.read_hashes()
    for name, expected in hashes.items():
        path = results.path_of(name)
        if not path.exists() or sha256_of(path) != expected:
            raise UsageError(
                f"{path}: is not the result that {results.hashes.name} names: expected SHA-256 {expected}"
            )
    return hashes


def _diagnose_all(
    results: Results, names: list[str], hashes: dict[str, str], jobs: int, progress: Progress
) -> None:
    if results.method == STEPWISE:
        _stepwise()  # imported here: finding it reads JSON, which the processes cannot
    # spawned processes share no memory with this one
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_prepare, initargs=(jobs,)) as executor:
        futures = {
            executor.submit(diagnose_trial, results.folder, name, results.method): name for name in names
        }
        try:
            for count, future in enumerate(as_completed(futures), 1):
                name = futures[future]
                result = future.result()
                path = results.path_of(name)
                text = json.dumps(result, ensure_ascii=False, allow_nan=False, indent=1)
                write_text_atomically(path, text + "\n")
                hashes[name] = sha256_of(path)
                results.write_hashes(hashes)
                verdict = result["verdict"] or f"failed: {result['error']}"
                progress(f"{count} of {len(names)} trials diagnosed; {name}: {verdict}")
        except BaseException:
            executor.shutdown(cancel_futures=True)
            raise


def _stepwise() -> ModuleType:
    """Import the method of comparison, which is in the project's benchmarks."""
    return benchmark_module("trials.stepwise", f"--method {STEPWISE}")


def _prepare(jobs: int) -> None:
    """Prepare one of ``jobs`` processes."""
    share_cores(jobs)
    forbid_envelopes()


def forbid_envelopes() -> None:
    """Make this process refuse to open any JSON file from now on."""
    sys.addaudithook(_refuse_envelopes)


def _refuse_envelopes(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and isinstance(arguments[0], (str, bytes)):
        name = os.fsdecode(arguments[0])
        if name.lower().endswith(".json"):
            raise PermissionError(f"{name}: a diagnosis of sealed trials opens no envelopes")


def diagnose_trial(folder: Path, name: str, method: str = DIAGNOSE) -> dict[str, Any]:
    """Diagnose one trial; the result as JSON data. A failure has the verdict null and its error."""
    began = time.perf_counter()
    try:
        search, test = (recording_path(folder, name, role) for role in ("search", "test"))
        result = _answer(search, test, method)
    except Exception as error:  # noqa: BLE001 - any failure is counted, and the other trials are diagnosed
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


def _answer(search: Path, test: Path, method: str) -> dict[str, Any]:
    """Answer one trial by a method, as JSON data."""
    if method == STEPWISE:
        answer: dict[str, Any] = _stepwise().stepwise_study(load_dataset(search, test_path=test))
        return answer
    if method == DIAGNOSE:
        return diagnose_study(load_dataset(search, test_path=test)).json
    (kind,) = read_rig_kinds(search).values()
    dataset = load_dataset(search, simulator_rig(method), test_path=test)
    return diagnose_study(dataset, baseline=rig_model(kind or "").baseline).json
