"""Comparison of models on the same recordings: from files to the answer and its JSON.

The models are read in ``compared_models.py``, the paired test is in ``paired.py``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labhil.analysis.compared_models import Candidate, RecordingSpan, read_candidates
from labhil.analysis.comparison_statements import next_steps, statement
from labhil.analysis.dataset import RecordingLike, naming, read_all
from labhil.analysis.find_recording import find_recording
from labhil.analysis.measured import measured_of, refuse_holes
from labhil.analysis.paired import block_squares, paired_p_value
from labhil.analysis.results import Source, finite
from labhil.analysis.rig_choice import rig_of
from labhil.analysis.rig_option import given_name
from labhil.analysis.saved_model import SavedModel
from labhil.analysis.schema import ComparisonPart, validate
from labhil.analysis.schema import Source as StatedSource
from labhil.analysis.shared_parameters import ALPHA, shared_parameters
from labhil.analysis.simulate import model_on
from labhil.errors import OptionError, RecordingError, UsageError
from labhil.identify.adequacy import adequacy_of
from labhil.identify.score import ChannelScore, Score, score, scored_horizon
from labhil.identify.windows import noise_of
from labhil.physics.model import Metric
from labhil.physics.record import Record
from labhil.recording.recording import Recording
from labhil.rig import RigFile
from labhil.signals import FloatArray

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ComparedRecording:
    """A recording with the score of each model on the same windows of it, in the order of the models."""

    source: Source
    record: Record
    scores: tuple[Score, ...]


@dataclass(frozen=True, slots=True)
class ComparisonResult:
    """A comparison with its samples and its JSON; ``losses`` are lines on data that recordings lack."""

    names: tuple[str, ...]
    recordings: tuple[ComparedRecording, ...]
    losses: tuple[str, ...]
    json: Any

    @property
    def part(self) -> ComparisonPart:
        """The JSON as typed data."""
        return validate(ComparisonPart, self.json, "the comparison")


def compare_study(
    results: Sequence[Path | SavedModel],
    recordings: Sequence[RecordingLike] = (),
    rig_file: Path | RigFile | None = None,
    *,
    horizon: float | None = None,
    device: str | None = None,
    run: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> ComparisonResult:
    """Simulate the models of results on the same recordings, and decide which explains them best.

    Args:
        results: two results or more.
        recordings: the recordings; by default the test data of the first result.
        rig_file: the rig file; by default the one in the recordings.
        horizon: length of the simulated windows, s.
        device: one of several devices in a recording.
        run: one of several runs in a file.
        progress: is called with a line of text at each stage.

    Raises:
        UsageError: options or files do not fit together (also as RecordingError, RigFileError or
            ModelFileError).
    """
    if horizon is not None and not 0.0 < horizon < float("inf"):
        raise OptionError("horizon", f": expected more than 0 s, found {horizon:g}")
    start_time = time.perf_counter()
    candidates = read_candidates(results)
    selected, spans, notes = _choose_recordings(candidates, recordings)
    loaded = [
        recording.of_device(device)
        for recording in _read_recordings(selected, run, candidates[0], explicit=bool(recordings))
    ]
    compared = []
    for recording, span in zip(loaded, spans, strict=True):
        progress(f"simulating {len(candidates)} models on {recording.path.name}")
        compared.append(_compare_on(recording, span, candidates, rig_file, horizon))
    notes += _fitted_notes(candidates, compared)
    data = _comparison_json(candidates, compared, notes)
    data["seconds"] = time.perf_counter() - start_time
    losses = tuple(line for recording in loaded for line in recording.warnings())
    return ComparisonResult(
        tuple(candidate.name for candidate in candidates), tuple(compared), losses, finite(data)
    )


def _choose_recordings(
    candidates: Sequence[Candidate], recordings: Sequence[RecordingLike]
) -> tuple[list[RecordingLike], list[Span | None], list[str]]:
    """Return the recordings to compare on, the span of each, and notes on the choice."""
    if recordings:
        return list(recordings), [None] * len(recordings), []
    first, *others = candidates
    spans = first.validation_spans
    notes = []
    if any(_span_keys(other) != _span_keys(first) for other in others):
        paths = ", ".join(recording_span.source.path for recording_span in spans)
        notes.append(
            f"The results were judged on different recordings; all are compared on that of {first.name}, "
            f"{paths}. --recording names another."
        )
    if any(recording_span.assumed for recording_span in spans):
        notes.append(
            f"{first.name} does not say what was held out of its recording: its last 30 % are taken, the "
            "default."
        )
    return (
        [_path_now(first, recording_span.source) for recording_span in spans],
        [_span(recording_span) for recording_span in spans],
        notes,
    )


def _path_now(candidate: Candidate, source: StatedSource) -> Path:
    """The path of a recording of a result, or the stated one where there is none."""
    stated = Path(source.path)
    return find_recording(Path(str(candidate.saved)), stated, source.sha256) or stated


def _span_keys(candidate: Candidate) -> list[tuple[str, float, float]]:
    return [(s.source.sha256, round(s.begin, 6), round(s.end, 6)) for s in candidate.validation_spans]


def _span(recording_span: RecordingSpan, slack: float = 1e-9) -> Span:
    """Begin and end of a span, whose times were calculated, with a slack for rounding."""
    return recording_span.begin - slack, recording_span.end + slack


def _read_recordings(
    selected: list[RecordingLike], run: int | None, first: Candidate, *, explicit: bool
) -> list[Recording]:
    missing = [path for path in selected if isinstance(path, Path) and not path.is_file()]
    if missing and not explicit:
        raise RecordingError(
            f"{missing[0]}: expected the recording that {first.name} was judged on, found none there nor "
            f"beside {first.saved}; --recording names where it is now, or another"
        )
    recordings = read_all(selected, run)
    if not recordings:
        raise UsageError(f"{first.name}: expected a recording that it was judged on, found none named")
    return recordings


def _compare_on(
    recording: Recording,
    span: Span | None,
    candidates: Sequence[Candidate],
    rig_file: Path | RigFile | None,
    horizon: float | None,
) -> ComparedRecording:
    """Simulate every model on the same windows of a recording."""
    rig = rig_of(recording, rig_file)
    if rig.kind.name != candidates[0].rig:
        raise RecordingError(
            f"{recording.path}: expected a recording of {candidates[0].rig}, as {candidates[0].saved}, "
            f"found one of {rig.kind.name}"
        )
    with naming([recording]):
        records, measured = measured_of([recording], rig, span)
        refuse_holes(recording.path, records[0])
        models = [model_on(measured, rig, candidate.saved) for candidate in candidates]
        stated_horizon = horizon or rig.metric.horizon
        # one length for all: the longest scored horizon of a model
        length = stated_horizon or max(
            scored_horizon(model, theta, record) for model, record, theta in models
        )
        scores = [score(model, theta, record, noise_of(record), length) for model, record, theta in models]
    source = Source(
        path=str(recording.path),
        sha256=recording.sha256,
        rig=rig.kind.name,
        samples=len(measured),
        duration=float(measured.t[-1] - measured.t[0]),
        role="test",
        start=float(measured.t[0]),
        rig_file=given_name(rig_file),
    )
    return ComparedRecording(source, models[0][1], tuple(scores))


def _fitted_notes(candidates: Sequence[Candidate], compared: Sequence[ComparedRecording]) -> list[str]:
    """A note on models that were fitted to the data of the comparison."""
    names = [candidate.name for candidate in candidates if _was_fitted(candidate, compared)]
    if not names:
        return []
    return [
        f"Fitted to these data: {', '.join(names)}. The error of such a model is smaller here than on data "
        "that it has not seen."
    ]


def _was_fitted(candidate: Candidate, compared: Sequence[ComparedRecording]) -> bool:
    sources = [recording.source for recording in compared]
    return any(candidate.was_fitted_to(s.sha256, (s.start, s.start + s.duration)) for s in sources)


def _comparison_json(
    candidates: Sequence[Candidate], compared: Sequence[ComparedRecording], notes: Sequence[str]
) -> dict[str, Any]:
    """Return the answer as plain data (`labhil.comparison/1`)."""
    errors = [[recording.scores[i].errors for recording in compared] for i in range(len(candidates))]
    mean_squares = np.array([np.mean(np.vstack(model_errors) ** 2, axis=0) for model_errors in errors])
    noise_levels = _noise_levels(mean_squares, compared)
    rmse_over_noise = np.sqrt(np.mean(mean_squares / noise_levels**2, axis=1))
    best = int(np.argmin(np.where(np.isfinite(rmse_over_noise), rmse_over_noise, np.inf)))
    windows = [recording.scores[best].window for recording in compared]
    blocks = [block_squares(model_errors, windows, noise_levels) for model_errors in errors]
    tests = len(candidates) - 1
    p_values = [
        1.0 if i == best else min(1.0, tests * paired_p_value(blocks[best], blocks[i]))
        for i in range(len(candidates))
    ]
    rows = [
        {
            "name": candidate.name,
            "path": candidate.saved.name,
            "made_by": candidate.made_by,
            "terms": list(candidate.terms),
            "n_parameters": sum(not row.held for row in candidate.parameters),
            "adequacy": adequacy_of([recording.scores[i] for recording in compared]).verdict.value,
            "rmse_over_noise": float(rmse_over_noise[i]),
            "per_channel": [
                {**asdict(row), "rmse_over_noise": row.rmse / row.noise_floor}
                for row in pool_scores([recording.scores[i] for recording in compared])
            ],
            "times_best": float(rmse_over_noise[i] / rmse_over_noise[best]),
            "p_value": p_values[i],
            "worse_than_best": i != best and p_values[i] < ALPHA,
            "fitted_to_it": _was_fitted(candidate, compared),
        }
        for i, candidate in enumerate(candidates)
    ]
    equally_good = [row for row in rows if not row["worse_than_best"]]
    metric = compared[0].scores[0].metric
    data = {
        "schema": "labhil.comparison/1",
        "recordings": [asdict(recording.source) for recording in compared],
        "rig": candidates[0].rig,
        "metric": metric.value,
        "horizon": compared[0].scores[0].horizon if metric is not Metric.INVERSE_DYNAMICS else None,
        "verdict": "one_best" if len(equally_good) == 1 else "alike",
        "statement": "",
        "best": candidates[best].name,
        "preferred": min(equally_good, key=_simplicity)["name"],
        "alpha": ALPHA,
        "models": rows,
        "parameters": shared_parameters(candidates),
        "next_steps": [],
        "notes": list(notes),
    }
    part = validate(ComparisonPart, finite(data), "the comparison")
    return data | {"statement": statement(part), "next_steps": next_steps(part)}


def _simplicity(row: Mapping[str, Any]) -> tuple[int, bool, float]:
    """Sort key of models that explain the data alike, the preferred one first."""
    return row["n_parameters"], row["fitted_to_it"], row["rmse_over_noise"]


def _noise_levels(mean_squares: FloatArray, compared: Sequence[ComparedRecording]) -> FloatArray:
    """Noise level of each output, (c,): its noise floor under the model that simulates it best."""
    rows = [pool_scores([recording.scores[i] for recording in compared]) for i in range(len(mean_squares))]
    floors = np.array([[channel.noise_floor for channel in row] for row in rows])
    finite_squares = np.where(np.isfinite(mean_squares), mean_squares, np.inf)
    return np.asarray(floors[np.argmin(finite_squares, axis=0), np.arange(floors.shape[1])])


def pool_scores(scores: Sequence[Score]) -> tuple[ChannelScore, ...]:
    """Pool the errors of a model's outputs over several recordings, every sample with the same weight."""
    if len(scores) == 1:
        return scores[0].channels
    counts = [len(recording_score.rows) for recording_score in scores]
    return tuple(
        _pool_channel(rows, counts)
        for rows in zip(*(recording_score.channels for recording_score in scores), strict=True)
    )


def _pool_channel(rows: Sequence[ChannelScore], counts: Sequence[int]) -> ChannelScore:
    mse = float(np.average([row.mse for row in rows], weights=counts))
    variance = float(np.average([row.mse / (1.0 - row.r2) for row in rows], weights=counts))
    floor = float(np.sqrt(np.average([row.noise_floor**2 for row in rows], weights=counts)))
    return replace(
        rows[0],
        mse=mse,
        rmse=float(np.sqrt(mse)),
        max_abs_error=max(row.max_abs_error for row in rows),
        r2=1.0 - mse / variance,
        noise_floor=floor,
        relative_error=None,
    )
