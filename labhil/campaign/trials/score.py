"""``labhil trial score``: open the envelopes, check every hash, and judge trial by trial.

The rules are in ``judge.py``, the score card in ``card.py``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from pathlib import Path

from labhil.analysis.dataset import load_dataset
from labhil.campaign.trials.answer import Answer, TrueEffect
from labhil.campaign.trials.card import ScoreCard, make_score_card
from labhil.campaign.trials.folder import (
    DIAGNOSE,
    IndexEntry,
    Results,
    check_recordings,
    read_index,
    recording_path,
)
from labhil.campaign.trials.judge import MIN_DETECTABLE_GAIN, JudgedTrial, judge
from labhil.campaign.trials.oracle import Oracle
from labhil.campaign.trials.regime import overlap
from labhil.campaign.trials.seal import open_envelope, sha256_of
from labhil.campaign.trials.stated_answer import StatedAnswer, read_stated_answer
from labhil.errors import UsageError

Progress = Callable[[str], None]


def score_trials(
    folder: Path, answers: Path, progress: Progress, method: str = DIAGNOSE, jobs: int = 1
) -> ScoreCard:
    """Score a method's results in a folder; see :func:`judge_trials`."""
    index = read_index(folder)
    return make_score_card(judge_trials(folder, answers, progress, method, jobs), index.rig, index.fixed_seed)


def judge_trials(
    folder: Path, answers: Path, progress: Progress, method: str = DIAGNOSE, jobs: int = 1
) -> list[JudgedTrial]:
    """Open the envelopes and judge a method's results in a folder.

    Args:
        folder: a folder of ``labhil trial make`` with results of ``labhil trial run``.
        answers: the folder of the envelopes.
        progress: is called with a line of text after each trial.
        method: one of ``METHODS``.
        jobs: number of processes.

    Raises:
        UsageError: a file is missing or not the one that was hashed.
        UnknownNameError: there is no such method.
    """
    index, results = read_index(folder), Results(folder, method)
    _check_results(results, [entry.name for entry in index.trials])
    truths = [open_sealed_answer(entry, answers) for entry in index.trials]
    for entry in index.trials:
        check_recordings(folder, entry)
    judged: list[JudgedTrial] = []
    with ProcessPoolExecutor(jobs) as executor:
        for trial in executor.map(_judge, repeat(results), truths):
            judged.append(trial)
            progress(f"{len(judged)} of {len(truths)} trials scored")
    return judged


def _check_results(results: Results, names: list[str]) -> None:
    hashes = results.read_hashes()
    missing = [name for name in names if name not in hashes]
    if missing:
        how = "" if results.method == DIAGNOSE else f" --method {results.method}"
        raise UsageError(
            f"{results.hashes}: expected results of {len(names)} trials, found {len(names) - len(missing)}: "
            f"{', '.join(missing[:5])} to be diagnosed by `labhil trial run {results.folder}{how}`"
        )
    for name in names:
        path = results.path_of(name)
        actual = sha256_of(path)
        if actual != hashes[name]:
            raise UsageError(
                f"{path}: not the result that was hashed: expected SHA-256 {hashes[name]}, found {actual}"
            )


def open_sealed_answer(entry: IndexEntry, answers: Path) -> Answer:
    """Read the answer in a trial's envelope.

    Raises:
        UsageError: it is not the sealed answer.
    """
    path = answers / f"{entry.name}.json"
    answer = Answer.from_json(open_envelope(path, entry.seal))
    if answer.trial != entry.name or dict(answer.recordings) != dict(entry.recordings):
        raise UsageError(
            f"{path}: expected the answer to trial {entry.name} and its recordings, found another"
        )
    return answer


def _judge(results: Results, answer: Answer) -> JudgedTrial:
    stated = read_stated_answer(results.path_of(answer.trial))
    oracle = LazyOracle(results.folder, answer)
    return judge(answer, stated, oracle.loss, oracle.overlap(stated))


@dataclass
class LazyOracle:
    """Comparisons by the oracle of a trial, which is built when it is first used."""

    folder: Path
    answer: Answer

    def loss(self, effect: TrueEffect, rival: str) -> float:
        """Return how many nats a rival, refitted in the place of a true effect, loses on the test data.

        A name without a term, like ``unmodelled_force``, cannot be refitted: its loss is infinite.
        """
        oracle = self.oracle
        if rival not in oracle.model.terms:
            return float("inf")
        others = [name for name in self.full_terms if name != effect.key]
        without_term = oracle.refit(others)
        new = [] if rival in others else [rival]
        best = oracle.refit([*others, *new], new).best_of(without_term)
        return effect.oracle_gain - (best.likelihood - without_term.likelihood)

    def overlap(self, stated: StatedAnswer) -> float | None:
        """Return the agreement of reported and true regime; None unless one effect is detectable."""
        detectable = [effect for effect in self.answer.effects if effect.oracle_gain >= MIN_DETECTABLE_GAIN]
        if stated.verdict != "missing_physics" or len(detectable) != 1 or not detectable[0].catalogue:
            return None
        others = [name for name in self.full_terms if name != detectable[0].key]
        return overlap(self.oracle, detectable[0].key, others, stated)

    @property
    def full_terms(self) -> list[str]:
        """Terms of the true model that are in the catalogue."""
        return [*self.answer.baseline, *(effect.key for effect in self.answer.effects if effect.catalogue)]

    @cached_property
    def oracle(self) -> Oracle:
        """The oracle of the trial's recordings."""
        search, test = (recording_path(self.folder, self.answer.trial, role) for role in ("search", "test"))
        dataset = load_dataset(search, test_path=test)
        return Oracle.build(dataset.model, dataset.train, dataset.test, self.answer.noise, self.answer.truth)
