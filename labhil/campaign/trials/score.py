"""``labhil trial score``: open the envelopes, check every hash, and judge trial by trial."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from pathlib import Path

from labhil.analysis.dataset import load_dataset
from labhil.campaign.trials.answer import Answer, TrueEffect
from labhil.campaign.trials.card import Card, count
from labhil.campaign.trials.folder import DIAGNOSE, Listed, Results, read_index, recording
from labhil.campaign.trials.judge import NULL_GAIN, Judged, judge
from labhil.campaign.trials.oracle import Oracle
from labhil.campaign.trials.regime import overlap
from labhil.campaign.trials.seal import open_envelope, sha256_of
from labhil.campaign.trials.stated_answer import StatedAnswer, read_stated_answer
from labhil.errors import UsageError

Progress = Callable[[str], None]


def score_trials(
    folder: Path, answers: Path, progress: Progress, method: str = DIAGNOSE, jobs: int = 1
) -> Card:
    """Score a method's results in a folder; see :func:`judge_trials`."""
    index = read_index(folder)
    return count(judge_trials(folder, answers, progress, method, jobs), index.rig, index.fixed_seed)


def judge_trials(
    folder: Path, answers: Path, progress: Progress, method: str = DIAGNOSE, jobs: int = 1
) -> list[Judged]:
    """Open the envelopes and judge a method's results in a folder, in ``jobs`` processes.

    UsageError where anything is not what was hashed, or is missing, UnknownNameError for a method that is
    none.
    """
    index, results = read_index(folder), Results(folder, method)
    _check_results(results, [listed.name for listed in index.trials])
    truths = [open_answer(listed, answers) for listed in index.trials]
    for listed in index.trials:
        _check_recordings(folder, listed)
    judged: list[Judged] = []
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
        path = results.of(name)
        actual = sha256_of(path)
        if actual != hashes[name]:
            raise UsageError(
                f"{path}: not the result that was hashed: expected SHA-256 {hashes[name]}, found {actual}"
            )


def _check_recordings(folder: Path, listed: Listed) -> None:
    for role, expected in listed.recordings.items():
        path = recording(folder, listed.name, role)
        actual = sha256_of(path)
        if actual != expected:
            raise UsageError(f"{path}: not the sealed recording: expected SHA-256 {expected}, found {actual}")


def open_answer(listed: Listed, answers: Path) -> Answer:
    """The answer in a trial's envelope; UsageError where it is not the sealed one."""
    path = answers / f"{listed.name}.json"
    answer = Answer.from_json(open_envelope(path, listed.seal))
    if answer.trial != listed.name or dict(answer.recordings) != dict(listed.recordings):
        raise UsageError(
            f"{path}: expected the answer to trial {listed.name} and its recordings, found another"
        )
    return answer


def _judge(results: Results, answer: Answer) -> Judged:
    stated = read_stated_answer(results.of(answer.trial))
    oracle = Bystander(results.folder, answer)
    return judge(answer, stated, oracle.loss, oracle.overlap(stated))


@dataclass
class Bystander:
    """The oracle for what only the given answer calls for; built when it is first used."""

    folder: Path
    answer: Answer

    def loss(self, effect: TrueEffect, rival: str) -> float:
        """Nats that a rival in the place of a true effect, refitted, loses to it on the test data.

        What has no term, like ``unmodelled_force``, cannot be refitted and loses everything.
        """
        oracle = self.oracle
        if rival not in oracle.model.terms:
            return float("inf")
        others = [name for name in self.full if name != effect.key]
        without = oracle.refit(others)
        new = [] if rival in others else [rival]
        best = oracle.refit([*others, *new], new).or_better(without)
        return effect.oracle_gain - (best.likelihood - without.likelihood)

    def overlap(self, stated: StatedAnswer) -> float | None:
        """Agreement of reported regimes with the true one; None unless one effect makes the difference."""
        real = [effect for effect in self.answer.effects if effect.oracle_gain >= NULL_GAIN]
        if stated.verdict != "missing_physics" or len(real) != 1 or not real[0].catalogue:
            return None
        others = [name for name in self.full if name != real[0].key]
        return overlap(self.oracle, real[0].key, others, stated)

    @property
    def full(self) -> list[str]:
        """Terms of the true model, as far as there are any."""
        return [*self.answer.baseline, *(effect.key for effect in self.answer.effects if effect.catalogue)]

    @cached_property
    def oracle(self) -> Oracle:
        """An oracle of the trial's recordings with the true noise and values."""
        search, test = (recording(self.folder, self.answer.trial, role) for role in ("search", "test"))
        material = load_dataset(search, test_path=test)
        return Oracle.of(material.model, material.train, material.test, self.answer.noise, self.answer.truth)
