"""``labhil trial make``: draw trials, write their recordings, put their answers into envelopes elsewhere."""

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
from labhil.campaign.trials.compose import Composed, answer_of, compose
from labhil.campaign.trials.disturbed import kind_of
from labhil.campaign.trials.draw import draw_sort, refuse_unknown_sort
from labhil.campaign.trials.folder import INDEX, RIG, Index, Listed, read_index, recording
from labhil.campaign.trials.seal import sha256_of, write_envelope
from labhil.campaign.trials.secret import Bench, Walk
from labhil.errors import UsageError
from labhil.recording.rig_attachments import RIG_ATTACHMENT
from labhil.recording.writer import RecordingWriter
from labhil.signals import Batch, Stream

SEED_BITS = 128
SHORTEST = 2.0
"""s, of a recording."""
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Order:
    """Trials to be made: a kind of rig, how many trials of which sort, and where they go.

    ``seed`` None draws from the system's randomness; with ``resume`` trials of the same order that are there
    stay. The ``first`` has that number: of a seed whose earlier trials somebody has looked at. Recordings
    are as long as the bench has them, or so many ``seconds``. ``disturbed`` names what disturbs all of them.
    """

    kind: str
    trials: int
    sort: str
    out: Path
    answers: Path
    seed: int | None = None
    resume: bool = False
    first: int = 1
    seconds: float | None = None
    disturbed: str | None = None

    @property
    def names(self) -> dict[str, int]:
        """The trials' names, with the number that each is drawn by."""
        numbers = range(self.first, self.first + self.trials)
        width = max(3, len(str(numbers[-1])))
        return {f"{number:0{width}d}": number - 1 for number in numbers}


def answers_beside(folder: Path) -> Path:
    """The folder of the answers by default."""
    return folder.with_name(f"{folder.name}-answers")


def make_trials(order: Order, jobs: int, progress: Progress) -> Index:
    """Make trials in ``jobs`` processes; each is written as soon as it is there.

    UsageError for a kind or sort that there is not, and where trials or answers are in the way.
    """
    bench = _check_order(order, jobs)
    order.out.mkdir(parents=True, exist_ok=True)
    order.answers.mkdir(parents=True, exist_ok=True)
    (order.out / RIG).write_text(bench.rig, encoding="utf-8")
    names = order.names
    done = _existing_trials(order, names)
    with ProcessPoolExecutor(jobs) as executor:
        futures = [
            executor.submit(make_trial, order, name, _entropy(order.seed, i))
            for name, i in names.items()
            if name not in done
        ]
        try:
            for future in as_completed(futures):
                listed = future.result()
                done[listed.name] = listed
                _index(order, names, done).write(order.out)
                progress(f"{order.kind}: {len(done)} of {order.trials} trials made")
        except BaseException:
            executor.shutdown(cancel_futures=True)
            raise
    return _index(order, names, done)


def _index(order: Order, names: Collection[str], done: Mapping[str, Listed]) -> Index:
    """The trials that are there, in the order of their names."""
    return Index(order.kind, order.seed is not None, tuple(done[name] for name in names if name in done))


def _existing_trials(order: Order, names: Collection[str]) -> dict[str, Listed]:
    """Trials that exist already; those that an interruption left incomplete are deleted."""
    if not (order.resume and (order.out / INDEX).exists()):
        return {}
    index = read_index(order.out)
    done = {listed.name: listed for listed in index.trials}
    if (index.rig, index.fixed_seed) != (order.kind, order.seed is not None) or not set(done) <= set(names):
        source = "a fixed seed" if order.seed is not None else "randomness"
        raise UsageError(
            f"{order.out}: expected at most {order.trials} trials of {order.kind}, the first of them "
            f"{order.first}, drawn from {source}, found {len(done)} of {index.rig}"
        )
    for name in names:
        if name not in done:
            shutil.rmtree(order.out / name, ignore_errors=True)
    return done


def make_trial(order: Order, name: str, entropy: tuple[int, ...]) -> Listed:
    """Draw and write one trial; only its seal is returned."""
    random = np.random.default_rng(entropy)
    sort = draw_sort(order.sort, random)
    trial = compose(order.kind, sort, random, order.seconds, kind_of(order.disturbed))
    paths = [_write(trial, walk, order.out, name, i) for i, walk in enumerate(trial.walks)]
    hashes = {path.stem: sha256_of(path) for path in paths}
    answer = answer_of(trial, name, hashes).to_json()
    nonce = random.bytes(32) if order.seed is not None else None
    return Listed(name, write_envelope(answer, order.answers / f"{name}.json", nonce), hashes)


def _check_order(order: Order, jobs: int) -> Bench:
    if order.trials < 1:
        raise UsageError(f"--trials: expected at least 1, found {order.trials}")
    if order.first < 1:
        raise UsageError(f"--first: expected at least 1, found {order.first}")
    if jobs < 1:
        raise UsageError(f"--jobs: expected at least 1, found {jobs}")
    if order.seconds is not None and not order.seconds >= SHORTEST:
        raise UsageError(f"--seconds: expected at least {SHORTEST:g}, found {order.seconds:g}")
    refuse_unknown_sort(order.sort)
    if kind_of(order.disturbed) is not None and order.kind == "ur5":
        raise UsageError("--disturbed: expected a rig that one input drives, found ur5")
    if order.answers.resolve().is_relative_to(order.out.resolve()):
        raise UsageError(
            f"--answers {order.answers}: expected a folder outside {order.out}, which a diagnosis may read"
        )
    for folder in () if order.resume else (order.out, order.answers):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise UsageError(f"{folder}: expected a new or an empty folder, found {_content_of(folder)}")
    return bench_of(order.kind)


def _content_of(folder: Path) -> str:
    if not folder.is_dir():
        return "a file"
    return "trials" if (folder / INDEX).exists() else "other files in it"


def _entropy(seed: int | None, trial: int) -> tuple[int, ...]:
    """What a trial is drawn from: 128 bits of the system's randomness, or the seed and its number."""
    return (secrets.randbits(SEED_BITS),) if seed is None else (seed, trial)


def _write(trial: Composed, walk: Walk, out: Path, name: str, which: int) -> Path:
    """One recording with the rig file, and nothing of the secret."""
    setup = trial.secret.setup
    path = recording(out, name, ("search", "test")[which])
    path.parent.mkdir(exist_ok=True)
    t_ns = np.rint(walk.t * 1e9).astype(np.int64)
    values = np.column_stack([walk.signals[signal.name] for signal in setup.signals])
    # nothing is lost by a kill that could not be made again, and a clock would decide on the file's chunks
    with RecordingWriter(path, flush_interval=math.inf) as writer:
        writer.attach(RIG_ATTACHMENT, "application/toml", setup.rig.encode())
        stream = Stream("state", setup.signals, 1.0 / setup.period)
        channel = writer.add_stream(setup.kind, stream, {})
        writer.write(channel, Batch(np.arange(len(t_ns), dtype=np.int64), t_ns, t_ns, values))
    return path
