"""The model of a result beside the measurement, with terms switched off, in a process of its own.

``python -m labhil.campaign.studies.overlay`` is told the path of a result in one line. It answers with the
terms of its model and the curves of all of them, then with the curves for each further line
``{"without": [TERM, …]}``; of lines that come faster than it can simulate it answers the newest.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from queue import Empty, Queue
from typing import TYPE_CHECKING, Any

import numpy as np

from labhil.campaign.studies.process import on_further_lines, say, told_first
from labhil.errors import LabhilError, ModelFileError
from labhil.signals import FloatArray

if TYPE_CHECKING:
    from labhil.api.diagnosis import Diagnosis
    from labhil.api.fit import Fit

MODULE = "labhil.campaign.studies.overlay"
MOST_POINTS = 4_000
"""Of a channel; more than any terminal has columns."""


def recording_of(result: Path, stated: str) -> Path:
    """Return the recording that a result names: where it says, or beside the result.

    Raises ModelFileError where it is in neither place.
    """
    found = [path for path in (Path(stated), result.parent / Path(stated).name) if path.is_file()]
    if not found:
        raise ModelFileError(f"{result}: expected its recording {stated}, found none there nor beside it")
    return found[0]


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


def main() -> int:
    """Run the process; returns its exit status."""
    path = Path(str(told_first()["result"]))
    wanted: Queue[tuple[str, ...]] = Queue()
    on_further_lines(lambda line: wanted.put(tuple(map(str, line.get("without", ())))), lambda: os._exit(0))
    try:
        from labhil.analysis.results import terms_of
        from labhil.api.diagnosis import Diagnosis
        from labhil.api.fit import Fit
        from labhil.api.saved import load

        result = load(path)
        if not isinstance(result, (Fit, Diagnosis)):
            found = type(result).__name__.lower()
            raise ModelFileError(f"{path}: expected a fit or a diagnosis, found a {found}")
        tests = [source for source in result.recordings if source.role == "test"]
        recording = recording_of(path, (tests or list(result.recordings))[0].path)
        say({"terms": list(terms_of(result.saved)), **simulated_without(result, recording, ())})
        while True:
            without = wanted.get()
            try:
                while True:
                    without = wanted.get_nowait()
            except Empty:
                say(simulated_without(result, recording, without))
    except LabhilError as error:
        say({"failed": str(error)})
        return error.exit_status


if __name__ == "__main__":
    sys.exit(main())
