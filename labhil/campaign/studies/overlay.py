"""Simulations of the models of results over a measurement, in a separate process.

``python -m labhil.campaign.studies.overlay`` reads the path of a result in one line, ``{"result": PATH}``.
It answers with the terms of its model and its curves, then with the curves for each further line
``{"without": [TERM, …]}``; of lines that come faster than it can simulate it answers the newest.

To ``{"results": [PATH, …]}`` it answers with the curves of each model over the test recording of the first,
and ends.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from queue import Empty, Queue
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from labhil.analysis.find_recording import find_recording
from labhil.campaign.studies.process import read_further_lines, read_request, write_line
from labhil.errors import LabhilError, ModelFileError
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.api.diagnosis import Diagnosis
    from labhil.api.fit import Fit

MODULE = "labhil.campaign.studies.overlay"
MAX_POINTS = 4_000
"""Points of a channel; more than any terminal has columns."""


def recording_of(result: Path, stated: str) -> Path:
    """Return the path of a recording that a result names: as stated, or beside the result.

    Raises:
        ModelFileError: it is in neither place.
    """
    path = find_recording(result, Path(stated))
    if path is None:
        raise ModelFileError(f"{result}: expected its recording {stated}, found none there nor beside it")
    return path


def simulate_without(result: Fit | Diagnosis, recording: Path, without: tuple[str, ...]) -> dict[str, Any]:
    """Simulate a result's model without some terms; curves and RMSE of each output as plain JSON data."""
    simulation = result.simulate(recording, without=without)
    step = max(1, -(-len(simulation.t) // MAX_POINTS))
    window_begins = np.r_[True, np.diff(simulation.window[::step]) != 0]  # windows are not joined by a line
    return {
        "without": list(without),
        "channels": [
            {
                "without": list(without),
                "name": name,
                "unit": simulation.units[name],
                "rmse": simulation.errors[name].rmse,
                "t": _json_values(simulation.t[::step]),
                "measured": _json_values(simulation.measured[name][::step]),
                "simulated": _json_values(
                    np.where(window_begins, np.nan, simulation.simulated[name][::step])
                ),
            }
            for name in simulation.measured
        ],
    }


def _json_values(values: FloatArray) -> list[float | None]:
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values.tolist()]


def simulate_models(paths: Sequence[Path]) -> dict[str, Any]:
    """Simulate each result's model over the recording of the first; the curves of each output.

    A model is left out of an output that it does not have, or that is not measured there.
    """
    results = [_load(path) for path in paths]
    recording = _test_recording(paths[0], results[0])
    channels: dict[str, dict[str, Any]] = {}
    for number, result in enumerate(results):
        for channel in simulate_without(result, recording, ())["channels"]:
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
    """Path of the recording that a result was tested on, or else fitted to."""
    tests = [source for source in result.recordings if source.role == "test"]
    return recording_of(path, (tests or list(result.recordings))[0].path)


def main() -> int:
    """Run the process; returns its exit status."""
    request = read_request()
    requests: Queue[tuple[str, ...]] = Queue()
    read_further_lines(
        lambda line: requests.put(tuple(map(str, line.get("without", ())))), lambda: os._exit(0)
    )
    try:
        if "results" in request:
            write_line(simulate_models([Path(str(path)) for path in request["results"]]))
            return 0
        _answer_requests(Path(str(request["result"])), requests)
    except LabhilError as error:
        write_line({"failed": str(error)})
        return error.exit_status


def _answer_requests(path: Path, requests: Queue[tuple[str, ...]]) -> NoReturn:
    """Answer with the curves of all terms, then with those of each request, until the process ends."""
    from labhil.analysis.saved_model import terms_of

    result = _load(path)
    recording = _test_recording(path, result)
    write_line({"terms": list(terms_of(result.saved)), **simulate_without(result, recording, ())})
    while True:
        without = requests.get()
        try:
            while True:
                without = requests.get_nowait()
        except Empty:
            write_line(simulate_without(result, recording, without))


if __name__ == "__main__":
    sys.exit(main())
