"""Plans in Python: a generator yields steps, receives their recording, and decides on the next steps."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from labhil.errors import EmergencyStopError, ExperimentFileError, LabhilError, RunError, RunStoppedError
from labhil.experiment.experiment import Experiment as ExperimentFile
from labhil.experiment.experiment import Step
from labhil.validation_errors import format_validation_error

if TYPE_CHECKING:
    from labhil.api.recording import Recording
    from labhil.experiment.result import Progress

Steps = Mapping[str, Any] | Sequence[Mapping[str, Any]]
PythonPlan = Generator[Steps, "Recording", Any]
ENDING_ERRORS = (RunStoppedError, EmergencyStopError)
"""Errors that end a plan without being thrown into it: a person has ended the run."""


@dataclass(frozen=True, slots=True)
class PlanResult:
    """The recordings of a plan in their order, and its return value."""

    recordings: tuple[Path, ...]
    value: Any = None


def run_plan(
    base: ExperimentFile, plan: Callable[[], PythonPlan], out: Path, report: Callable[[Progress], None]
) -> PlanResult:
    """Run the steps that a plan yields until it returns; see :meth:`labhil.Experiment.run_plan`."""
    from labhil.api.recording import read

    name = getattr(plan, "__name__", "plan")
    paths: list[Path] = []
    generator = plan()
    try:
        steps = next(generator)
        while True:
            experiment = _with_steps(base, steps, f"{name}, step {len(paths) + 1}")
            try:
                paths.append(_record(experiment, out, report, {"name": name, "number": str(len(paths) + 1)}))
            except ENDING_ERRORS:
                raise
            except RunError as error:
                steps = generator.throw(error)  # the plan may handle it; otherwise this ends the plan
            else:
                steps = generator.send(read(paths[-1]))
    except StopIteration as stop:
        return PlanResult(tuple(paths), stop.value)
    except LabhilError as error:
        if paths:
            error.add_note(f"What was recorded before: {', '.join(map(str, paths))}")
        raise
    finally:
        generator.close()


def _with_steps(base: ExperimentFile, yielded: Steps, where: str) -> ExperimentFile:
    """Return the experiment with the yielded steps, which are checked against the limits when it is run."""
    steps_data = [yielded] if isinstance(yielded, Mapping) else list(yielded)
    device = next(iter(base.devices)) if len(base.devices) == 1 else None
    complete_steps = [{**({} if device is None else {"device": device}), **step} for step in steps_data]
    try:
        steps = tuple(Step.model_validate(step) for step in complete_steps)
        fields = {name: getattr(base, name) for name in type(base).model_fields if name != "sweep"}
        return ExperimentFile.model_validate({**fields, "steps": steps})
    except ValidationError as error:
        raise ExperimentFileError(format_validation_error(error, Path(where), ExperimentFile)) from error


def _record(
    experiment: ExperimentFile, out: Path, report: Callable[[Progress], None], about: Mapping[str, str]
) -> Path:
    from labhil.experiment.run import run_experiment

    result = run_experiment(experiment, out, report, metadata={"plan": about})
    if result.error is not None:
        if result.path is not None:
            result.error.add_note(f"What was recorded until then: {result.path}")
        raise result.error
    if result.path is None:
        raise RunError(f"{experiment.experiment.name}: nothing was recorded: {result.reason}")
    return result.path
