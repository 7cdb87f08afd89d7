"""What each part of the search by evidence buys. A command, no test:

    python benchmarks/measuring/measure_ablation.py --rigs ball_beam dc_motor --trials 12 --seed 31 -o FILE

Draws trials with concealed effects and as many without, and searches each as it is and with one part taken
out. Only the search is run: no intervals, no wider search, no scores. A trial is right where all that an
oracle gains ten nats by is named, and nothing that is not there; where an effect of no list is concealed, a
curve has to be found. It is listed where this holds with rivals in the place of the terms that they stand
beside.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from labhil.analysis.dataset import load_dataset
from labhil.campaign.trials.answer import Answer
from labhil.campaign.trials.folder import recording_path
from labhil.campaign.trials.judge import MIN_REQUIRED_GAIN
from labhil.campaign.trials.make import TrialSetOptions, make_trials
from labhil.diagnose.begin import fit_baseline, prepare_data
from labhil.diagnose.search_result import SearchResult
from labhil.diagnose.structures import disturbance, responses, search, stages
from labhil.diagnose.structures import enumerate as beam
from labhil.diagnose.structures.claims import Stage
from labhil.identify.problem import Problem
from labhil.physics.model import terms_named
from measured import tell

Part = tuple[object, str, Any]

AS_IT_IS = "as it is"


def _undisturbed(candidates: int, sizes: tuple[float, ...] = ()) -> disturbance.Disturbance:
    return disturbance.Disturbance(np.zeros(1), np.ones(1))


def _noise_as_left(data: Any, fitted: Any) -> tuple[Any, Any]:
    return data, np.zeros(len(data.sigma))


def _likeliest_fits(stage: Stage) -> list[Any]:
    """Fits of the baseline and of the three most probable structures, whichever contain another one."""
    refitted = stage.state.refitted
    by_evidence = sorted(refitted, key=lambda s: -refitted[s].log_evidence)
    return [refitted[s].fitted for s in dict.fromkeys([frozenset[str](), *by_evidence[:3]])]


VARIANTS: dict[str, tuple[search.SearchOptions, tuple[Part, ...]]] = {
    AS_IT_IS: (search.SearchOptions(), ()),
    "no disturbance in the likelihood": (
        search.SearchOptions(),
        ((responses.Disturbance, "grid", staticmethod(_undisturbed)),),
    ),
    "noise as differences of samples, white": (
        search.SearchOptions(),
        ((stages, "_with_estimated_noise", _noise_as_left),),
    ),
    "rounding as independent noise": (
        search.SearchOptions(),
        ((Problem, "effective_fraction", property(lambda problem: np.ones(len(problem.owner)))),),
    ),
    "only where a disturbance is possible": (
        search.SearchOptions(),
        (
            (search, "EVIDENCES", (beam.with_disturbance,)),
            (beam, "EVIDENCES", (beam.with_disturbance,)),
        ),
    ),
    "no look at smaller sets": (search.SearchOptions(max_terms_for_subsets=0), ()),
    "no relevance at the end": (search.SearchOptions(min_relevance=0.0), ()),
    "every step gone on from": (search.SearchOptions(min_step_relevance=-np.inf), ()),
    "any number of terms compared at once": (search.SearchOptions(max_added_terms=99), ()),
    "shapes not begun anew": (
        search.SearchOptions(),
        ((search.StructureSearch, "_refit_shapes", lambda self, state, structure: None),),
    ),
    "rivals not compared beside small terms": (
        search.SearchOptions(),
        ((search.StructureSearch, "_refit_exchanges", lambda self, state: None),),
    ),
    "larger sets of the best one carried on": (
        search.SearchOptions(),
        ((Stage, "leading_fits", _likeliest_fits),),
    ),
    "held-out data not asked": (
        search.SearchOptions(),
        (
            (stages, "validate_claims", lambda stage, result: result),
            (stages, "predicts_better", lambda before, after: True),
        ),
    ),
    "short windows only": (search.SearchOptions(window_horizons=(0.375,)), ()),
    "no curves": (
        search.SearchOptions(),
        ((stages, "_with_force_curve", lambda data, result, *rest: result),),
    ),
}
"""Each with its options, and what stands in the place of what: of an object, an attribute, by another."""


@dataclass
class Count:
    """Of the trials of one rig under one variant."""

    right: int = 0
    listed: int = 0
    trials: int = 0
    alarms: int = 0
    nulls: int = 0
    seconds: float = 0.0


@contextmanager
def without(parts: tuple[Part, ...]) -> Iterator[None]:
    """Replace these parts for the context."""
    with ExitStack() as stack:
        for owner, name, replacement in parts:
            stack.callback(partial(setattr, owner, name, owner.__dict__[name]))
            setattr(owner, name, replacement)
        yield


def run_search(
    folder: Path, name: str, baseline: tuple[str, ...], options: search.SearchOptions
) -> SearchResult:
    """What the search finds in one trial."""
    dataset = load_dataset(
        recording_path(folder, name, "search"), test_path=recording_path(folder, name, "test")
    )
    data = prepare_data(dataset.model, dataset.train, dataset.test)
    base = fit_baseline(data, [term.key for term in terms_named(dataset.model, baseline)])
    return stages.search_structures(data, base, lambda text: None, options)


def is_right(result: SearchResult, answer: Answer) -> bool:
    """Whether all sure effects are named and nothing else is."""
    return _matches({step.terms[0] for step in result.missing}, result, answer)


def is_listed(result: SearchResult, answer: Answer) -> bool:
    """Whether the terms named are right, or would be with one of its rivals in the place of each."""
    concealed = _listed_effects(answer)
    terms = {step.terms[0] for step in result.missing}
    for rival in result.rivals:
        if rival.term in concealed and rival.instead_of in terms - concealed:
            terms = (terms - {rival.instead_of}) | {rival.term}
    return _matches(terms, result, answer)


def _listed_effects(answer: Answer) -> set[str]:
    """Keys of the concealed effects that the catalogue has."""
    return {effect.key for effect in answer.effects if effect.catalogue}


def _matches(terms: set[str], result: SearchResult, answer: Answer) -> bool:
    required = {e.key for e in answer.effects if e.catalogue and e.oracle_gain >= MIN_REQUIRED_GAIN}
    hidden = any(not e.catalogue and e.oracle_gain >= MIN_REQUIRED_GAIN for e in answer.effects)
    return required <= terms <= _listed_effects(answer) and (result.curve is not None) == hidden


def read_answer(path: Path) -> Answer:
    """The truth that an answer's file holds."""
    return Answer.from_json(json.loads(path.read_text(encoding="utf-8"))["answer"])


def measure_rig(rig: str, trials: int, seed: int, say: Callable[[str], None]) -> dict[str, Any]:
    """Every variant's counts for one rig."""
    with tempfile.TemporaryDirectory() as kept:
        sets = []
        for sort in ("some", "0"):
            out, answers = Path(kept) / sort, Path(kept) / f"{sort}-answers"
            make_trials(TrialSetOptions(rig, trials, sort, out, answers, seed), 1, lambda text: None)
            sets += [(out, path.stem, read_answer(path)) for path in sorted(answers.glob("*.json"))]
        counts = {}
        for variant, (options, parts) in VARIANTS.items():
            count = Count()
            for folder, name, answer in sets:
                began = time.process_time()
                with without(parts):
                    result = run_search(folder, name, answer.baseline, options)
                count.seconds += time.process_time() - began
                if answer.effects:
                    count.trials += 1
                    count.right += is_right(result, answer)
                    count.listed += is_listed(result, answer)
                else:
                    count.nulls += 1
                    count.alarms += bool(result.missing or result.curve)
            say(f"{rig}: {variant}: {count}")
            counts[variant] = {**vars(count), "seconds": round(count.seconds, 1)}
        return counts


def main() -> None:
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", nargs="+", default=["ball_beam", "dc_motor"])
    parser.add_argument("--trials", type=int, default=12, help="with effects, and as many without")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("-o", "--out", type=Path)
    given = parser.parse_args()
    rigs = {rig: measure_rig(rig, given.trials, given.seed, print) for rig in given.rigs}
    tell({"seed": given.seed, "trials": given.trials, "rigs": rigs}, given.out)


if __name__ == "__main__":
    main()
