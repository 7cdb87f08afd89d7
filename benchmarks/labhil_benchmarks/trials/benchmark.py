"""``labhil trial benchmark``: as many nulls as trials with effects, made, diagnosed and scored in one go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from labhil.campaign.trials.card import ScoreCard, make_score_card
from labhil.campaign.trials.folder import DIAGNOSE
from labhil.campaign.trials.judge import JudgedTrial
from labhil.campaign.trials.make import TrialSetOptions, answers_beside, make_trials
from labhil.campaign.trials.run import run_trials
from labhil.campaign.trials.score import judge_trials

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Plan:
    """A benchmark of one rig: so many nulls and so many trials with effects, in folders below ``out``.

    ``seed`` None draws from the system's randomness, and the ``first`` has that number; ``method`` answers.
    ``effects`` is the sort of those that are no nulls, ``disturbed`` what disturbs all.
    """

    kind: str
    trials: int
    out: Path
    seed: int | None = None
    method: str = DIAGNOSE
    jobs: int = 1
    first: int = 1
    effects: str = "some"
    disturbed: str | None = None

    @property
    def sets(self) -> dict[str, str]:
        """Folders, and the sort of trials in each."""
        return {"nulls": "0", "effects": self.effects}


def run_trial_benchmark(plan: Plan, progress: Progress) -> ScoreCard:
    """Go on with a benchmark where it stands: recordings and answers are kept as soon as they are there.

    Raises what making, running and scoring raise.
    """
    judged: list[JudgedTrial] = []
    for number, (name, sort) in enumerate(plan.sets.items()):
        folder = plan.out / name
        seed = None if plan.seed is None else 2 * plan.seed + number
        options = TrialSetOptions(
            plan.kind,
            plan.trials,
            sort,
            folder,
            answers_beside(folder),
            seed,
            resume=True,
            first=plan.first,
            disturbed=plan.disturbed,
        )
        say = partial(_tell, progress, name)
        make_trials(options, plan.jobs, say)
        run_trials(folder, plan.jobs, say, plan.method)
        trials = judge_trials(folder, options.answers, say, plan.method, plan.jobs)
        judged += [replace(trial, trial=f"{name}/{trial.trial}") for trial in trials]
    return make_score_card(judged, plan.kind, plan.seed is not None)


def _tell(progress: Progress, name: str, text: str) -> None:
    progress(f"{name}: {text}")
