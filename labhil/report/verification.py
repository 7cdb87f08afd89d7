"""A verification: from files to the answer, as tables for a person and as JSON."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from labhil.diagnose.verify import ALPHA, Verification, verify
from labhil.errors import ModelFileError, RecordingError, UsageError
from labhil.identify.windows import FEWEST_SAMPLES
from labhil.physics.model import Record
from labhil.physics.rigs import model_for, record_of
from labhil.physics.terms import keyed
from labhil.recording.reader import read_recording
from labhil.report.kept_curve import under_kept_curve
from labhil.report.material import refuse_holes, rig_of
from labhil.report.results import Source, accepted_of, finite, score_json
from labhil.report.text import small
from labhil.report.verdicts import verdict_line


@dataclass(frozen=True, slots=True)
class VerificationResult:
    """A verification with its JSON; ``losses`` are what the recording lacks, a line each."""

    verification: Verification
    losses: tuple[str, ...]
    json: Any


def verify_study(
    path: Path,
    model_path: Path,
    rig_path: Path | None = None,
    *,
    alpha: float = ALPHA,
    device: str | None = None,
    run: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> VerificationResult:
    """Hold a recording, or what it holds of one ``device`` or ``run``, against a result's model.

    Raises UsageError (RecordingError, RigFileError, ModelFileError) with what is wrong and where.
    """
    if not 0.0 < alpha < 0.5:
        raise UsageError(f"--alpha: expected a probability above 0 and below 0.5, found {alpha:g}")
    began = time.perf_counter()
    accepted = accepted_of(model_path)
    recording = read_recording(path, run).of_device(device)
    rig = rig_of(recording, rig_path)
    if accepted.rig not in (None, rig.kind.name):
        raise ModelFileError(
            f"{model_path}: rig: expected a model of {rig.kind.name}, as the recording {path}, "
            f"found one of {accepted.rig}"
        )
    record = record_of(recording, rig.kind)
    refuse_holes(path, record)
    if len(record) < 2 * FEWEST_SAMPLES:
        raise RecordingError(
            f"{path}: too short to verify: {len(record)} samples, at least {2 * FEWEST_SAMPLES} are needed"
        )
    model = under_kept_curve(model_for(rig, record), model_path)
    found = verify(model, model.prepare(record), accepted, alpha=alpha, progress=progress)
    source = Source(str(path), recording.sha256, model.kind, len(record), _duration(record), "test")
    seconds = time.perf_counter() - began
    data = verification_json(found, source, model_path, seconds)
    return VerificationResult(found, tuple(recording.losses()), data)


def _duration(record: Record) -> float:
    return float(record.t[-1] - record.t[0])


def verification_json(found: Verification, source: Source, model_path: Path, seconds: float) -> Any:
    """The whole answer as plain JSON data (`labhil.verification/1`): no NaN, no infinity, null instead."""
    return finite(
        {
            "schema": "labhil.verification/1",
            "recordings": [asdict(source)],
            "model": str(model_path),
            "rig": source.rig,
            "terms": list(found.refit.terms),
            "verdict": "consistent" if found.consistent else "contradicted",
            "alpha": found.alpha,
            "p_value": found.p_value,
            "reasons": list(found.reasons),
            "notes": list(found.notes),
            "adequacy": found.adequacy.verdict.value,
            "residual_over_noise": dict(found.adequacy.residual_over_noise),
            "score": score_json(found.score),
            "channels": [asdict(channel) for channel in found.channels],
            "values_p": found.values_p,
            "parameters": [asdict(change) for change in found.changes],
            "worst_windows": [asdict(window) for window in found.worst],
            "window": found.window,
            "seconds": seconds,
        }
    )


def show_verification(found: Verification, console: Console) -> None:
    """Print the answer, what was tested, and where the simulation is worst."""
    verdict = "consistent with the model" if found.consistent else "The recording contradicts the model"
    begin = "The recording is " if found.consistent else ""
    console.print(
        Text(
            f"{begin}{verdict} (p {small(found.p_value)}, false alarms {found.alpha:g}).",
            style="bold green" if found.consistent else "bold red",
        )
    )
    console.print(Text(verdict_line(found.adequacy), style="" if found.adequacy.explained else "yellow"))
    for reason in found.reasons:
        console.print(Text("· " + reason))
    for note in found.notes:
        console.print(Text("· " + note, style="yellow"))
    console.print(channel_table(found))
    if found.changes:
        console.print(value_table(found))
    if found.score.horizon is not None:
        console.print(window_table(found))


def _table(title: str, left: tuple[str, ...], right: tuple[str, ...]) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for name in left:
        table.add_column(name, no_wrap=True)
    for name in right:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def channel_table(found: Verification) -> Table:
    """A row per output: error over floor with its limit, and what the refitted model leaves."""
    horizon = found.score.horizon
    how = "inverse dynamics" if horizon is None else f"simulated windows of {horizon:.3g} s"
    table = _table(
        f"With the values as they are, {how}",
        ("output",),
        ("RMSE", "noise floor", "ratio", "limit", "p", "p of residuals and input"),
    )
    for c in found.channels:
        table.add_row(
            keyed(c.channel, c.joint),
            f"{c.rmse:.4g} {c.unit}",
            f"{c.noise_floor:.4g} {c.unit}",
            f"{c.ratio:.3g}",
            f"{c.limit:.3g}",
            small(c.rmse_p).removeprefix("= "),
            small(c.structure_p).removeprefix("= "),
        )
    return table


def value_table(found: Verification) -> Table:
    """A row per parameter: accepted, refitted, and whether they differ."""
    table = _table(
        f"Values, refitted on windows of {found.window:.3g} s: all together p {small(found.values_p)}",
        ("parameter",),
        ("accepted", "refitted", "± of the difference", "z", "p (all looked at)"),
    )
    table.add_column("")
    table.add_column("unit")
    for change in found.changes:
        table.add_row(
            keyed(change.name, change.joint),
            f"{change.before:.5g}",
            f"{change.after:.5g}",
            f"{change.std_error:.2g}",
            f"{change.z:.1f}",
            small(change.p_value).removeprefix("= "),
            "changed" if change.changed else "",
            change.unit,
        )
    return table


def window_table(found: Verification) -> Table:
    """The windows that are simulated worst."""
    table = _table("Worst windows", (), ("from", "to", "RMSE / noise floor"))
    for window in found.worst:
        table.add_row(f"{window.begin:.4g} s", f"{window.end:.4g} s", f"{window.ratio:.3g}")
    return table
