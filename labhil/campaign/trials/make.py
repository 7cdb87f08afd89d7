"""``labhil trial make``: draw trials, write their recordings, and seal their answers in another folder."""

from __future__ import annotations

import math
import secrets
import shutil
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labhil.campaign.trials.bench import bench_of
from labhil.campaign.trials.compose import ComposedTrial, compose_trial, make_answer
from labhil.campaign.trials.disturbance import parse_disturbance
from labhil.campaign.trials.folder import INDEX, RIG, Index, IndexEntry, read_index, recording_path
from labhil.campaign.trials.seal import sha256_of, write_envelope
from labhil.campaign.trials.secret import Bench, SimulatedRun
from labhil.campaign.trials.trial_types import check_trial_type, draw_trial_type
from labhil.errors import UsageError
from labhil.recording.rig_attachments import RIG_ATTACHMENT
from labhil.recording.writer import RecordingWriter
from labhil.signals import Batch, Stream

SEED_BITS = 128
MIN_DURATION = 2.0
"""Shortest duration of a recording, s."""
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class TrialSetOptions:
    """Options of a set of trials.

    Attributes:
        kind: the kind of rig.
        trials: number of trials.
        trial_type: one of ``TRIAL_TYPES``.
        out: folder of the recordings.
        answers: folder of the envelopes.
        seed: seed of the draw; None for the system's randomness.
        resume: whether existing trials of the same options stay.
        first: number of the first trial, for a seed whose earlier trials somebody has looked at.
        seconds: duration of each recording, s; None for that of the bench.
        disturbed: name of the disturbance of all trials.
    """

    kind: str
    trials: int
    trial_type: str
    out: Path
    answers: Path
    seed: int | None = None
    resume: bool = False
    first: int = 1
    seconds: float | None = None
    disturbed: str | None = None

    @property
    def names(self) -> dict[str, int]:
        """The trials' names, with the number by which each is drawn."""
        numbers = range(self.first, self.first + self.trials)
        width = max(3, len(str(numbers[-1])))
        return {f"{number:0{width}d}": number - 1 for number in numbers}


def answers_beside(folder: Path) -> Path:
    """Return the default folder of the answers."""
    return folder.with_name(f"{folder.name}-answers")


def make_trials(options: TrialSetOptions, jobs: int, progress: Progress) -> Index:
    """Make the trials of a set.

    Args:
        options: the set.
        jobs: number of processes.
        progress: is called with a line of text after each trial.

    Raises:
        UsageError: an option is wrong, or other trials or answers exist there.
    """
    bench = _check_options(options, jobs)
    options.out.mkdir(parents=True, exist_ok=True)
    options.answers.mkdir(parents=True, exist_ok=True)
    (options.out / RIG).write_text(bench.rig, encoding="utf-8")
    names = options.names
    done = _existing_trials(options, names)
    with ProcessPoolExecutor(jobs) as executor:
        futures = [
            executor.submit(make_trial, options, name, _entropy(options.seed, i))
            for name, i in names.items()
            if name not in done
        ]
        try:
            for future in as_completed(futures):
                entry = future.result()
                done[entry.name] = entry
                _index(options, names, done).write(options.out)
                progress(f"{options.kind}: {len(done)} of {options.trials} trials made")
        except BaseException:
            executor.shutdown(cancel_futures=True)
            raise
    return _index(options, names, done)


def _index(options: TrialSetOptions, names: Collection[str], done: Mapping[str, IndexEntry]) -> Index:
    """Index of the finished trials, in the order of their names."""
    return Index(options.kind, options.seed is not None, tuple(done[name] for name in names if name in done))


def _existing_trials(options: TrialSetOptions, names: Collection[str]) -> dict[str, IndexEntry]:
    """Return finished trials, and delete incomplete ones."""
    if not (options.resume and (options.out / INDEX).exists()):
        return {}
    index = read_index(options.out)
    done = {entry.name: entry for entry in index.trials}
    if (index.rig, index.fixed_seed) != (options.kind, options.seed is not None) or not set(done) <= set(
        names
    ):
        source = "a fixed seed" if options.seed is not None else "randomness"
        raise UsageError(
            f"{options.out}: expected at most {options.trials} trials of {options.kind}, the first of them "
            f"{options.first}, drawn from {source}, found {len(done)} of {index.rig}"
        )
    for name in names:
        if name not in done:
            shutil.rmtree(options.out / name, ignore_errors=True)
    return done


def make_trial(options: TrialSetOptions, name: str, entropy: tuple[int, ...]) -> IndexEntry:
    """Draw and write one trial; only its index entry, with the seal, is returned."""
    rng = np.random.default_rng(entropy)
    trial_type = draw_trial_type(options.trial_type, rng)
    trial = compose_trial(
        options.kind, trial_type, rng, options.seconds, parse_disturbance(options.disturbed)
    )
    paths = [_write_recording(trial, run, options.out, name, i) for i, run in enumerate(trial.runs)]
    hashes = {path.stem: sha256_of(path) for path in paths}
    answer = make_answer(trial, name, hashes).to_json()
    nonce = rng.bytes(32) if options.seed is not None else None
    return IndexEntry(name, write_envelope(answer, options.answers / f"{name}.json", nonce), hashes)


def _check_options(options: TrialSetOptions, jobs: int) -> Bench:
    if options.trials < 1:
        raise UsageError(f"--trials: expected at least 1, found {options.trials}")
    if options.first < 1:
        raise UsageError(f"--first: expected at least 1, found {options.first}")
    if jobs < 1:
        raise UsageError(f"--jobs: expected at least 1, found {jobs}")
    if options.seconds is not None and not options.seconds >= MIN_DURATION:
        raise UsageError(f"--seconds: expected at least {MIN_DURATION:g}, found {options.seconds:g}")
    check_trial_type(options.trial_type)
    if parse_disturbance(options.disturbed) is not None and options.kind == "ur5":
        raise UsageError("--disturbed: expected a rig that one input drives, found ur5")
    if options.answers.resolve().is_relative_to(options.out.resolve()):
        raise UsageError(
            f"--answers {options.answers}: expected a folder outside {options.out}, which a diagnosis "
            "may read"
        )
    for folder in () if options.resume else (options.out, options.answers):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise UsageError(f"{folder}: expected a new or an empty folder, found {_content_of(folder)}")
    return bench_of(options.kind)


def _content_of(folder: Path) -> str:
    if not folder.is_dir():
        return "a file"
    return "trials" if (folder / INDEX).exists() else "other files in it"


def _entropy(seed: int | None, trial: int) -> tuple[int, ...]:
    """Entropy of a trial: 128 bits of the system's randomness, or the seed and the trial's number."""
    return (secrets.randbits(SEED_BITS),) if seed is None else (seed, trial)


def _write_recording(
    trial: ComposedTrial, run: SimulatedRun, out: Path, name: str, recording_index: int
) -> Path:
    """Write a recording with the rig file, without any of the secret."""
    setup = trial.secret.setup
    path = recording_path(out, name, ("search", "test")[recording_index])
    path.parent.mkdir(exist_ok=True)
    t_ns = np.rint(run.t * 1e9).astype(np.int64)
    values = np.column_stack([run.signals[signal.name] for signal in setup.signals])
    # without a flush interval, the clock has no effect on the file's chunks
    with RecordingWriter(path, flush_interval=math.inf) as writer:
        writer.attach(RIG_ATTACHMENT, "application/toml", setup.rig.encode())
        stream = Stream("state", setup.signals, 1.0 / setup.period)
        channel = writer.add_stream(setup.kind, stream, {})
        writer.write(channel, Batch(np.arange(len(t_ns), dtype=np.int64), t_ns, t_ns, values))
    return path
