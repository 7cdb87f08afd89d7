"""Plans in Python: a generator yields steps, is given what was recorded, and decides what comes next."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from labhil.complaints import explain
from labhil.errors import EmergencyStopError, ExperimentFileError, LabhilError, RunError, RunStoppedError
from labhil.experiment.experiment import Experiment as ExperimentFile
from labhil.experiment.experiment import Step

if TYPE_CHECKING:
    from labhil.api.recording import Recording
    from labhil.experiment.result import Progress

Steps = Mapping[str, Any] | Sequence[Mapping[str, Any]]
PythonPlan = Generator[Steps, "Recording", Any]
ENDS_THE_PLAN = (RunStoppedError, EmergencyStopError)
"""What a plan is not asked about: a person has ended it."""


@dataclass(frozen=True, slots=True)
class PlanResult:
    """What a plan has made: its recordings in their order, and what it returned."""

    recordings: tuple[Path, ...]
    value: Any = None


def run_plan(
    base: ExperimentFile, plan: Callable[[], PythonPlan], out: Path, tell: Callable[[Progress], None]
) -> PlanResult:
    """Run what a plan yields, one recording for each, until it returns.

    See :meth:`labhil.Experiment.run_plan`.
    """
    from labhil.api.recording import read

    name = getattr(plan, "__name__", "plan")
    made: list[Path] = []
    steps = plan()
    try:
        asked = next(steps)
        while True:
            experiment = _with_steps(base, asked, f"{name}, step {len(made) + 1}")
            try:
                made.append(_record(experiment, out, tell, {"name": name, "number": str(len(made) + 1)}))
            except ENDS_THE_PLAN:
                raise
            except RunError as error:
                asked = steps.throw(error)  # the plan may go on by another way; else this ends it
            else:
                asked = steps.send(read(made[-1]))
    except StopIteration as end:
        return PlanResult(tuple(made), end.value)
    except LabhilError as error:
        if made:
            error.add_note(f"What was recorded before: {', '.join(map(str, made))}")
        raise
    finally:
        steps.close()


def _with_steps(base: ExperimentFile, asked: Steps, where: str) -> ExperimentFile:
    """The experiment with the steps that were yielded; they are checked against the limits when it is run."""
    given = [asked] if isinstance(asked, Mapping) else list(asked)
    only = next(iter(base.devices)) if len(base.devices) == 1 else None
    data = [{**({} if only is None else {"device": only}), **step} for step in given]
    try:
        steps = tuple(Step.model_validate(step) for step in data)
        fields = {name: getattr(base, name) for name in type(base).model_fields if name != "sweep"}
        return ExperimentFile.model_validate({**fields, "steps": steps})
    except ValidationError as error:
        raise ExperimentFileError(explain(error, Path(where), ExperimentFile)) from error


def _record(
    experiment: ExperimentFile, out: Path, tell: Callable[[Progress], None], about: Mapping[str, str]
) -> Path:
    from labhil.experiment.run import run_experiment

    result = run_experiment(experiment, out, tell, metadata={"plan": about})
    if result.error is not None:
        if result.path is not None:
            result.error.add_note(f"What was recorded until then: {result.path}")
        raise result.error
    if result.path is None:
        raise RunError(f"{experiment.experiment.name}: nothing was recorded: {result.reason}")
    return result.path
