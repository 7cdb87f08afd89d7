"""A comparison of models over the same recordings: from files to the answer and its JSON."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labhil.analysis.compared_models import Candidate, Stretch, candidates_of
from labhil.analysis.comparison_words import next_steps, statement
from labhil.analysis.dataset import Taken, measured_of, naming, read_all, refuse_holes, rig_of
from labhil.analysis.paired import block_squares, paired_p_value
from labhil.analysis.results import SavedModel, Source, finite
from labhil.analysis.schema import ComparisonPart, checked
from labhil.analysis.shared_parameters import ALPHA, shared_parameters
from labhil.analysis.simulate import model_on
from labhil.errors import OptionError, RecordingError, UsageError
from labhil.identify.adequacy import adequacy_of
from labhil.identify.score import ChannelScore, Score, score, scored_horizon
from labhil.identify.windows import noise_of
from labhil.physics.model import Metric, Record
from labhil.recording.recording import Recording
from labhil.rig import RigFile
from labhil.signals import FloatArray

Span = tuple[float, float]
HAIR = 1e-9
"""Of a stretch's ends, s."""


@dataclass(frozen=True, slots=True)
class ComparedRecording:
    """One recording with the score of each model on the same windows of it, in the order of the models."""

    source: Source
    record: Record
    scores: tuple[Score, ...]


@dataclass(frozen=True, slots=True)
class ComparisonResult:
    """A comparison with its JSON and its samples; ``losses`` are what the recordings lack, a line each."""

    names: tuple[str, ...]
    recordings: tuple[ComparedRecording, ...]
    losses: tuple[str, ...]
    json: Any

    @property
    def part(self) -> ComparisonPart:
        """What the JSON says, as it is printed."""
        return checked(ComparisonPart, self.json, "the comparison")


def compare_study(
    results: Sequence[Path | SavedModel],
    recordings: Sequence[Taken] = (),
    rig_file: Path | RigFile | None = None,
    *,
    horizon: float | None = None,
    device: str | None = None,
    run: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> ComparisonResult:
    """Simulate the models of results on the same recordings, and say which explains them best.

    Without ``recordings`` they are compared on what the first result was judged on. Raises UsageError
    (RecordingError, RigFileError, ModelFileError) with what is wrong and where.
    """
    if horizon is not None and not 0.0 < horizon < float("inf"):
        raise OptionError("horizon", f": expected more than 0 s, found {horizon:g}")
    began = time.perf_counter()
    candidates = candidates_of(results)
    taken, spans, notes = _what_on(candidates, recordings)
    read = [each.of_device(device) for each in _read(taken, run, candidates[0], given=bool(recordings))]
    found = []
    for recording, span in zip(read, spans, strict=True):
        progress(f"simulating {len(candidates)} models on {recording.path.name}")
        found.append(_compared(recording, span, candidates, rig_file, horizon))
    notes += _seen(candidates, found)
    data = _json(candidates, found, notes)
    data["seconds"] = time.perf_counter() - began
    losses = tuple(line for recording in read for line in recording.losses())
    return ComparisonResult(tuple(each.name for each in candidates), tuple(found), losses, finite(data))


def _what_on(
    candidates: Sequence[Candidate], recordings: Sequence[Taken]
) -> tuple[list[Taken], list[Span | None], list[str]]:
    """The recordings to compare on, which span of each, and what has to be said of the choice."""
    if recordings:
        return list(recordings), [None] * len(recordings), []
    first, *others = candidates
    stretches = first.stretches
    notes = []
    if any(_places(other) != _places(first) for other in others):
        paths = ", ".join(stretch.source.path for stretch in stretches)
        notes.append(
            f"The results were judged on different recordings; all are compared on that of {first.name}, "
            f"{paths}. --recording names another."
        )
    if any(stretch.supposed for stretch in stretches):
        notes.append(
            f"{first.name} does not say what was held out of its recording: its last 30 % are taken, the "
            "default."
        )
    return [Path(each.source.path) for each in stretches], [_span(each) for each in stretches], notes


def _places(candidate: Candidate) -> list[tuple[str, float, float]]:
    return [(s.source.sha256, round(s.begin, 6), round(s.end, 6)) for s in candidate.stretches]


def _span(stretch: Stretch) -> Span:
    """The stretch with a hair at both ends, since its times were calculated."""
    return stretch.begin - HAIR, stretch.end + HAIR


def _read(taken: list[Taken], run: int | None, first: Candidate, *, given: bool) -> list[Recording]:
    missing = [each for each in taken if isinstance(each, Path) and not each.is_file()]
    if missing and not given:
        raise RecordingError(
            f"{missing[0]}: expected the recording that {first.name} was judged on, found no such file; "
            "--recording names where it is now, or another"
        )
    read = read_all(taken, run)
    if not read:
        raise UsageError(f"{first.name}: expected a recording that it was judged on, found none named")
    return read


def _compared(
    recording: Recording,
    span: Span | None,
    candidates: Sequence[Candidate],
    rig_file: Path | RigFile | None,
    horizon: float | None,
) -> ComparedRecording:
    """Every model on the same windows of one recording."""
    rig = rig_of(recording, rig_file)
    if rig.kind.name != candidates[0].rig:
        raise RecordingError(
            f"{recording.path}: expected a recording of {candidates[0].rig}, as {candidates[0].saved}, "
            f"found one of {rig.kind.name}"
        )
    with naming([recording]):
        records, measured = measured_of([recording], rig, span)
        refuse_holes(recording.path, records[0])
        ready = [model_on(measured, rig, each.saved) for each in candidates]
        stated = horizon or rig.metric.horizon
        # one length for all: the longest that a model asks for
        length = stated or max(scored_horizon(model, theta, record) for model, record, theta in ready)
        scores = [score(model, theta, record, noise_of(record), length) for model, record, theta in ready]
    source = Source(
        path=str(recording.path),
        sha256=recording.sha256,
        rig=rig.kind.name,
        samples=len(measured),
        duration=float(measured.t[-1] - measured.t[0]),
        role="test",
        start=float(measured.t[0]),
    )
    return ComparedRecording(source, ready[0][1], tuple(scores))


def _seen(candidates: Sequence[Candidate], found: Sequence[ComparedRecording]) -> list[str]:
    """A warning of models that have learnt from what they are compared on."""
    names = [each.name for each in candidates if _was_fitted(each, found)]
    if not names:
        return []
    return [
        f"Fitted to these data: {', '.join(names)}. The error of such a model is smaller here than on data "
        "that it has not seen."
    ]


def _was_fitted(candidate: Candidate, found: Sequence[ComparedRecording]) -> bool:
    sources = [each.source for each in found]
    return any(candidate.was_fitted_to(s.sha256, (s.start, s.start + s.duration)) for s in sources)


def _json(
    candidates: Sequence[Candidate], found: Sequence[ComparedRecording], notes: Sequence[str]
) -> dict[str, Any]:
    """The whole answer as plain data (`labhil.comparison/1`)."""
    errors = [[each.scores[i].errors for each in found] for i in range(len(candidates))]
    squares = np.array([np.mean(np.vstack(own) ** 2, axis=0) for own in errors])
    levels = _levels(squares, found)
    sizes = np.sqrt(np.mean(squares / levels**2, axis=1))
    best = int(np.argmin(np.where(np.isfinite(sizes), sizes, np.inf)))
    windows = [each.scores[best].window for each in found]
    blocks = [block_squares(own, windows, levels) for own in errors]
    looks = len(candidates) - 1
    chances = [
        1.0 if i == best else min(1.0, looks * paired_p_value(blocks[best], blocks[i]))
        for i in range(len(candidates))
    ]
    rows = [
        {
            "name": each.name,
            "path": each.saved.name,
            "made_by": each.made_by,
            "terms": list(each.terms),
            "n_parameters": sum(not row.held for row in each.parameters),
            "adequacy": adequacy_of([one.scores[i] for one in found]).verdict.value,
            "rmse_over_noise": float(sizes[i]),
            "per_channel": [
                {**asdict(row), "rmse_over_noise": row.rmse / row.noise_floor}
                for row in pooled([one.scores[i] for one in found])
            ],
            "times_best": float(sizes[i] / sizes[best]),
            "p_value": chances[i],
            "worse_than_best": i != best and chances[i] < ALPHA,
            "fitted_to_it": _was_fitted(each, found),
        }
        for i, each in enumerate(candidates)
    ]
    equals = [row for row in rows if not row["worse_than_best"]]
    metric = found[0].scores[0].metric
    data = {
        "schema": "labhil.comparison/1",
        "recordings": [asdict(each.source) for each in found],
        "rig": candidates[0].rig,
        "metric": metric.value,
        "horizon": found[0].scores[0].horizon if metric is not Metric.INVERSE_DYNAMICS else None,
        "verdict": "one_best" if len(equals) == 1 else "alike",
        "statement": "",
        "best": candidates[best].name,
        "preferred": min(equals, key=_simplicity)["name"],
        "alpha": ALPHA,
        "models": rows,
        "parameters": shared_parameters(candidates),
        "next_steps": [],
        "notes": list(notes),
    }
    part = checked(ComparisonPart, finite(data), "the comparison")
    return data | {"statement": statement(part), "next_steps": next_steps(part)}


def _simplicity(row: Mapping[str, Any]) -> tuple[int, bool, float]:
    """What comes first among models that explain the data alike."""
    return row["n_parameters"], row["fitted_to_it"], row["rmse_over_noise"]


def _levels(squares: FloatArray, found: Sequence[ComparedRecording]) -> FloatArray:
    """The noise level of each output, (c,): its floor under the model that simulates it best."""
    rows = [pooled([one.scores[i] for one in found]) for i in range(len(squares))]
    floors = np.array([[channel.noise_floor for channel in row] for row in rows])
    finite_squares = np.where(np.isfinite(squares), squares, np.inf)
    return np.asarray(floors[np.argmin(finite_squares, axis=0), np.arange(floors.shape[1])])


def pooled(scores: Sequence[Score]) -> tuple[ChannelScore, ...]:
    """The figures of a model's outputs over several recordings, every sample with the same weight."""
    if len(scores) == 1:
        return scores[0].channels
    counts = [len(each.rows) for each in scores]
    return tuple(_pooled(rows, counts) for rows in zip(*(each.channels for each in scores), strict=True))


def _pooled(rows: Sequence[ChannelScore], counts: Sequence[int]) -> ChannelScore:
    mse = float(np.average([row.mse for row in rows], weights=counts))
    spread = float(np.average([row.mse / (1.0 - row.r2) for row in rows], weights=counts))
    floor = float(np.sqrt(np.average([row.noise_floor**2 for row in rows], weights=counts)))
    return replace(
        rows[0],
        mse=mse,
        rmse=float(np.sqrt(mse)),
        max_abs_error=max(row.max_abs_error for row in rows),
        r2=1.0 - mse / spread,
        noise_floor=floor,
        relative_error=None,
    )
