"""The process of a run, which the screen can neither delay nor end by accident.

``python -m labhil.tui.run_process`` reads ``{"experiment": path, "out": folder}`` first, then ``{"do":
"pause" | "resume" | "stop" | "abort", "reason": …}``, or ``{"do": "mark", "text": …, "steady_ns": …}`` with
a time of the machine's steady clock. It writes its progress ten times a second, each refusal, and at the end
its result. When its standard input ends without a request before, the starter has crashed or was killed: the
run is aborted, with devices safe, the recording complete, and exit status 1.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from labhil.campaign.studies.process import read_further_lines, read_request, write_line
from labhil.errors import CommandRefusedError, LabhilError
from labhil.experiment.control import RunControl
from labhil.experiment.experiment import load_experiment
from labhil.experiment.result import Progress
from labhil.experiment.run import run_experiment
from labhil.host_clock import steady_ns

GONE = "the terminal UI that started the run is gone"


def dispatch(control: RunControl, line: dict[str, Any]) -> None:
    """Carry out the request of a line; write a refusal where the state of the run does not allow it.

    Args:
        control: Controls the run.
        line: The request.
    """
    reason = str(line.get("reason", "told to by the terminal UI"))
    try:
        match line.get("do"):
            case "pause":
                control.pause(reason)
            case "resume":
                control.resume()
            case "stop":
                control.stop(reason)
            case "abort":
                control.abort(reason)
            case "mark":
                control.mark(str(line["text"]), steady_ns() - int(line["steady_ns"]))
    except CommandRefusedError as error:
        write_line({"refused": str(error)})


def abort_run(control: RunControl) -> None:
    """Abort the run in whatever state it is, since nobody watches it any more."""
    if control.is_to_end():
        return  # an end was requested before
    try:
        control.abort(GONE)
    except CommandRefusedError:
        return  # it is ending already


def main() -> int:
    """Run the process; return its exit status."""
    request = read_request()
    control = RunControl()
    refusals = {""}

    def report(progress: Progress) -> None:
        write_line(
            {
                "state": progress.state.value,
                "elapsed": progress.elapsed,
                "duration": progress.duration,
                "message": progress.message,
            }
        )
        if control.refusal not in refusals:
            refusals.add(control.refusal)
            write_line({"refused": control.refusal})

    try:
        experiment = load_experiment(Path(request["experiment"]))
        read_further_lines(lambda line: dispatch(control, line), lambda: abort_run(control))
        result = run_experiment(experiment, Path(request["out"]), report, control)
    except LabhilError as error:
        write_line({"result": None, "error": str(error)})
        return error.exit_status
    write_line({"result": result.to_json(), "error": None if result.error is None else str(result.error)})
    return result.exit_status


if __name__ == "__main__":
    sys.exit(main())
