"""Models of results beside the measurement, in a process of its own.

``python -m labhil.campaign.studies.overlay`` reads the path of a result in one line, ``{"result": PATH}``.
It answers with the terms of its model and the curves of all of them, then with the curves for each further
line ``{"without": [TERM, …]}``; of lines that come faster than it can simulate it answers the newest.

To ``{"results": [PATH, …]}`` it answers with the curves of each one's model over the recording that the
first was judged on, and ends.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from queue import Empty, Queue
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from labhil.campaign.studies.process import on_further_lines, read_request, say
from labhil.errors import LabhilError, ModelFileError
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.api.diagnosis import Diagnosis
    from labhil.api.fit import Fit

MODULE = "labhil.campaign.studies.overlay"
MOST_POINTS = 4_000
"""Of a channel; more than any terminal has columns."""


def recording_of(result: Path, stated: str) -> Path:
    """Return the recording that a result names: at the stated path, or beside the result.

    Raises ModelFileError where it is in neither place.
    """
    paths = [path for path in (Path(stated), result.parent / Path(stated).name) if path.is_file()]
    if not paths:
        raise ModelFileError(f"{result}: expected its recording {stated}, found none there nor beside it")
    return paths[0]


def simulated_without(result: Fit | Diagnosis, recording: Path, without: tuple[str, ...]) -> dict[str, Any]:
    """Return the curves of each output and their RMSE, as plain JSON data."""
    run = result.simulate(recording, without=without)
    step = max(1, -(-len(run.t) // MOST_POINTS))
    begins = np.r_[True, np.diff(run.window[::step]) != 0]  # windows are not joined by a line
    return {
        "without": list(without),
        "channels": [
            {
                "without": list(without),
                "name": name,
                "unit": run.units[name],
                "rmse": run.errors[name].rmse,
                "t": _plain(run.t[::step]),
                "measured": _plain(run.measured[name][::step]),
                "simulated": _plain(np.where(begins, np.nan, run.simulated[name][::step])),
            }
            for name in run.measured
        ],
    }


def _plain(values: FloatArray) -> list[float | None]:
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values.tolist()]


def simulated_models(paths: Sequence[Path]) -> dict[str, Any]:
    """Return the curves of each output under each result's model, over the first one's recording.

    A model that has no such output, or none that is measured there, leaves it out.
    """
    results = [_load(path) for path in paths]
    recording = _test_recording(paths[0], results[0])
    channels: dict[str, dict[str, Any]] = {}
    for number, result in enumerate(results):
        for channel in simulated_without(result, recording, ())["channels"]:
            curves = channels.setdefault(
                channel["name"],
                {"name": channel["name"], "unit": channel["unit"], "t": channel["t"],
                 "measured": channel["measured"], "models": []},
            )  # fmt: skip
            curves["models"].append({"number": number, **{k: channel[k] for k in ("t", "simulated", "rmse")}})
    names = [path.name for path in paths]
    return {"recording": recording.name, "models": names, "channels": list(channels.values())}


def _load(path: Path) -> Fit | Diagnosis:
    from labhil.api.diagnosis import Diagnosis
    from labhil.api.fit import Fit
    from labhil.api.saved import load

    result = load(path)
    if not isinstance(result, (Fit, Diagnosis)):
        kind = type(result).__name__.lower()
        raise ModelFileError(f"{path}: expected a fit or a diagnosis, found a {kind}")
    return result


def _test_recording(path: Path, result: Fit | Diagnosis) -> Path:
    """The recording that a result was tested on, or the one that it was fitted to."""
    tests = [source for source in result.recordings if source.role == "test"]
    return recording_of(path, (tests or list(result.recordings))[0].path)


def main() -> int:
    """Run the process; returns its exit status."""
    request = read_request()
    wanted: Queue[tuple[str, ...]] = Queue()
    on_further_lines(lambda line: wanted.put(tuple(map(str, line.get("without", ())))), lambda: os._exit(0))
    try:
        if "results" in request:
            say(simulated_models([Path(str(path)) for path in request["results"]]))
            return 0
        _answer_each(Path(str(request["result"])), wanted)
    except LabhilError as error:
        say({"failed": str(error)})
        return error.exit_status


def _answer_each(path: Path, wanted: Queue[tuple[str, ...]]) -> NoReturn:
    """Say the curves under all terms, then those without the terms of each line, until the process ends."""
    from labhil.analysis.saved_model import terms_of

    result = _load(path)
    recording = _test_recording(path, result)
    say({"terms": list(terms_of(result.saved)), **simulated_without(result, recording, ())})
    while True:
        without = wanted.get()
        try:
            while True:
                without = wanted.get_nowait()
        except Empty:
            say(simulated_without(result, recording, without))


if __name__ == "__main__":
    sys.exit(main())
