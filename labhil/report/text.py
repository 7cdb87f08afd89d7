"""Fits and diagnoses as tables in a terminal.

The screen has its own form in ``labhil/tui/result_text.py``, pages are in ``html/``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from labhil.analysis.schema import (
    ChannelErrors,
    DiagnosisPart,
    FitPart,
    Improvement,
    Number,
    Parameter,
    Score,
    Source,
)
from labhil.analysis.verdicts import NOT_TESTED, VERDICTS, disagreement
from labhil.diagnose.fault import FaultKind
from labhil.physics.terms import keyed, listed
from labhil.report.exclusions import group_undecided, joints_table, limits_by_joint
from labhil.report.faults import fault_lines
from labhil.report.formatting import (
    NOTHING,
    format_number,
    format_p_relation,
    format_quantity,
    is_refuted,
    square_unit,
)
from labhil.report.parameter_columns import COLUMNS
from labhil.report.tables import titled_table

EXCLUDED_HEADING = "Not there, or smaller than this (99 %)"


def fit_text(fit: FitPart) -> RenderableType:
    """Return a fit as text and tables: verdict, faults, parameters, scores, residuals, next steps."""
    return Group(*_fit_parts(fit))


def _fit_parts(fit: FitPart) -> Iterator[RenderableType]:
    explained = fit.verdict in (None, "explained")
    if fit.statement is not None:
        yield Text(fit.statement, style="bold" if explained else "bold yellow")
    for line in (*fault_lines(fit.faults), *fit.doubts, *recording_numbers(fit.recordings), *fit.notes):
        yield Text(line)
    title = f"Parameters: errors robust to correlation, {_interval_method(fit)}"
    yield parameter_table(fit.parameters, title, stars=explained and not fit.sampling)
    for note in _fit_notes(fit):
        yield Text("· " + note, style="yellow")
    yield score_table([("train", fit.train)] + ([("test", fit.test)] if fit.test else []))
    if len(fit.by_window) > 1:
        yield window_table(fit)
    yield Text(_fit_summary(fit))
    yield from next_steps_lines(fit.next_steps)


def _fit_summary(fit: FitPart) -> str:
    """Tests of the residuals, and how the fit was made."""
    ending = "." if fit.converged else "; stopped before it had settled."
    tests = fit.residuals
    return (
        f"Residuals: {_test_phrase('white', 'not white', tests.ljung_box_p)} (Ljung-Box); with the input "
        f"{_test_phrase('uncorrelated', 'correlated', tests.input_crosscorrelation_p)}.\n"
        f"{_criterion(fit)}, {fit.evaluations} simulations; RMSE there {_remaining_rmse(fit)}{ending}"
    )


def _test_phrase(held: str, refuted: str, probability: float | None) -> str:
    """Say what a test of the residuals has found: what was assumed, or the opposite where it is refuted."""
    if probability is None:
        return f"not tested whether {held}"
    return f"{refuted if is_refuted(probability) else held}, p {format_p_relation(probability)}"


def recording_numbers(sources: Sequence[Source]) -> list[str]:
    """Return a line per recording with its number and file; nothing for a single recording."""
    return [
        f"@{source.recording}  {source.path}, {format_number(source.duration, '.4g')} s"
        + (" (test)" if source.role == "test" else "")
        for source in sources
        if source.recording is not None
    ]


def _criterion(fit: FitPart) -> str:
    if fit.criterion == "inverse_dynamics":
        return "Fitted by inverse dynamics"
    return f"Fitted on windows of {format_number(fit.window, '.3g')} s"


def _remaining_rmse(fit: FitPart) -> str:
    return ", ".join(f"{format_number(channel.rmse, '.4g')} {channel.unit}" for channel in fit.left)


def _interval_method(fit: FitPart) -> str:
    together = ", all together" if fit.intervals.simultaneous else ""
    return f"99 % intervals by {fit.intervals.method}{together}"


def parameter_table(estimates: Sequence[Parameter], title: str, *, stars: bool = True) -> Table:
    """Make a table with a row per parameter.

    Args:
        estimates: The parameters.
        title: Title of the table.
        stars: Whether ``*`` marks the parameters that differ from zero at 1 %.
    """
    columns = [column.terminal for column in COLUMNS if column.terminal is not None]
    table = titled_table(title, ("parameter",), [name for name, _ in columns])
    table.add_column("")
    table.add_column("unit")
    for row in estimates:
        table.add_row(row.key, *(Text(cell(row)) for _, cell in columns), _mark(row, stars), row.unit)
    return table


def format_share(share: Number, unit: str = " %") -> str:
    """Format a fraction in per cent with two decimals; None is a dash."""
    return NOTHING if share is None else f"{100 * share:.2f}{unit}"


def _mark(row: Parameter, stars: bool) -> str:
    if row.held:
        return "held"
    if not row.identifiable:
        return "not identifiable"
    if row.at_bound:
        return "at bound"
    return "*" if row.significant and stars else ""


def score_table(scores: Sequence[tuple[str, Score]]) -> Table:
    """Make a table of errors with a row per data set and channel, then those of each recording.

    Args:
        scores: Pairs of a name of the data and its score, all by the same metric.
    """
    horizon = scores[0][1].horizon
    title = "Inverse dynamics" if horizon is None else f"Simulated windows of {horizon:.3g} s"
    shows_forces = any(row.relative_error is not None for _, score in scores for row in score.per_channel)
    headings = ["RMSE", "noise floor", "max. error", "MSE", "R²", *(["RMSE/RMS"] if shows_forces else [])]
    table = titled_table(title, ("data", "channel"), headings, wrap=True)
    for label, channels, metric in _each_recording(scores):
        for channel in channels:
            unit = channel.unit
            table.add_row(
                label,
                _channel_name(channel, metric),
                f"{format_number(channel.rmse, '.4g')} {unit}",
                f"{format_number(channel.noise_floor, '.4g')} {unit}",
                f"{format_number(channel.max_abs_error, '.4g')} {unit}",
                f"{format_number(channel.mse, '.4g')} {square_unit(unit)}",
                format_share(channel.r2),
                *((_relative_error(channel),) if shows_forces else ()),
            )
    return table


def _channel_name(channel: ChannelErrors, metric: str) -> str:
    """A channel's name, with its metric where that is not the one of the score."""
    name = keyed(channel.channel, channel.joint)
    return name if channel.metric in (None, metric) else f"{name} ({channel.metric.replace('_', ' ')})"


def _relative_error(channel: ChannelErrors) -> str:
    """The error over the RMS of the measurement; empty where it has no meaning."""
    return "" if channel.relative_error is None else f"{100 * channel.relative_error:.2f} %"


def _each_recording(
    scores: Sequence[tuple[str, Score]],
) -> Iterator[tuple[str, Sequence[ChannelErrors], str]]:
    for label, score in scores:
        yield label, score.per_channel, score.metric
        for errors in score.per_recording:
            yield f"{label} @{errors.recording}", errors.per_channel, score.metric


def window_table(fit: FitPart) -> Table:
    """Make a table of the estimates against the length of the fitted windows."""
    lengths = [f"{row.window:.3g} s" for row in fit.by_window]
    table = titled_table("How the estimates move with the fitted window", ("parameter",), lengths, wrap=True)
    for name in fit.by_window[0].values:
        cells = [
            f"{format_number(row.values[name], '.4g')} ± {format_number(row.std_errors[name], '.1g')}"
            for row in fit.by_window
        ]
        table.add_row(name, *cells)
    table.add_row("residual / noise", *[format_number(row.residual, ".2f") for row in fit.by_window])
    return table


def _fit_notes(fit: FitPart) -> list[str]:
    notes = [
        f"{keyed(row.name, None, row.recording)} is at its bound, so its interval is one-sided at best."
        for row in fit.parameters
        if row.at_bound and row.identifiable
    ]
    if fit.identifiability.rank < fit.identifiability.of:
        known = ", ".join(fit.identifiability.combinations) or "none"
        notes.append(
            f"The data determine {fit.identifiability.rank} of {fit.identifiability.of} parameters; "
            f"of the others only these combinations: {known}."
        )
    channels = tuple(f.statement.split()[0] for f in fit.faults if f.kind == FaultKind.UNDERSAMPLED)
    notes += [note for note in fit.sampling if not note.startswith(channels)]
    if fit.verdict not in (None, "explained"):
        notes.append(_assumption(fit))
    elif fit.by_window and fit.window is not None and fit.window < fit.by_window[-1].window:
        notes.append(
            f"Longer windows than {fit.window:.3g} s do not fit to the noise: the plant itself is disturbed, "
            "or physics is missing."
        )
    return notes


def _assumption(fit: FitPart) -> str:
    """What the intervals mean where the model does not explain its data."""
    if fit.compared:
        lengths = ", ".join(f"{length:.3g}" for length in sorted((*fit.compared, fit.window or 0.0)))
        assumption = f"Intervals are widened by how far the estimates move over windows of {lengths} s"
    else:
        assumption = "Intervals are those of one fit, so they do not show the bias by the misfit"
    return (
        f"{assumption}; they assume that the remaining misfit is independent of these parameters. No "
        "parameter is starred, because the model leaves more than noise."
    )


def diagnosis_text(diagnosis: DiagnosisPart) -> RenderableType:
    """Return a diagnosis as text and tables: verdict, findings, scores, final model, exclusions."""
    lines = (*diagnosis.doubts, *recording_numbers(diagnosis.recordings), *diagnosis.notes)
    return Group(
        Text(VERDICTS[diagnosis.verdict], style="bold"),
        *(Text(line) for line in lines),
        *_findings(diagnosis),
        *([] if diagnosis.improvement is None else _improvement(diagnosis.improvement)),
        parameter_table(diagnosis.judged_rows, "Final model"),
        *[Text(line) for line in [disagreement(diagnosis.scale_factor)] if line],
        *_exclusions(diagnosis),
        *next_steps_lines(diagnosis.next_steps),
    )


def next_steps_lines(steps: Sequence[str]) -> Iterator[RenderableType]:
    """Yield what to do next, a line each, under a heading; nothing for no steps."""
    if steps:
        yield Text("What to do next", style="bold")
        yield from (Text(f"· {step}") for step in steps)


def _findings(diagnosis: DiagnosisPart) -> Iterator[RenderableType]:
    """Faults, location, missing terms with their rivals, changed parameters."""
    terms = ", ".join(listed(diagnosis.baseline.terms)) or "no terms"
    suffices = (
        f"p {format_p_relation(diagnosis.p_value)} that it suffices"
        if diagnosis.asks_baseline
        else NOT_TESTED
    )
    yield Text(f"Baseline: {terms}; {suffices}.")
    for size in diagnosis.collapsed:
        yield Text(f"! {size.statement}", style="yellow")
    for fault in diagnosis.faults:
        yield Text(f"! {fault.statement}", style="yellow")
    if diagnosis.location is not None:
        yield Text(diagnosis.location.statement)
    for item in diagnosis.missing:
        name = keyed(item.term, item.joint)
        yield Text(f"• {name} ({_chance(item.probability)}): {item.statement}", style="green")
        yield Text(
            f"  {item.equation};  ΔBIC {format_number(item.evidence.delta_bic, '.0f')}, "
            f"held-out gain {format_number(item.evidence.heldout_loglik_gain, '.1f')} nats "
            f"(p {format_p_relation(item.evidence.p_value)})"
        )
    for rival in diagnosis.rivals:
        yield Text(
            f"  or {keyed(rival.term, rival.joint)} instead of {rival.instead_of} "
            f"({_chance(rival.probability)}); to tell them apart: {rival.experiment}"
        )
    if diagnosis.remainder is not None:
        yield Text(diagnosis.remainder.statement)
    for change in diagnosis.changed:
        yield Text(
            f"• {keyed(change.name, change.joint, change.recording)} changed from "
            f"{format_number(change.before, '.4g')} to {format_number(change.after, '.4g')} {change.unit} "
            f"(p {format_p_relation(change.p_value)})"
        )


def _chance(probability: Number) -> str:
    return NOTHING if probability is None else f"{100 * probability:.0f} %"


def _improvement(improvement: Improvement) -> Iterator[RenderableType]:
    """Scores before and after."""
    data = "the test recording" if improvement.data == "test" else "held-out data"
    yield score_table([("before", improvement.before), ("after", improvement.after)])
    where = f"the parts of {data} that" if improvement.parts else f"{data}, which"
    yield Text(
        f"On {where} the search never saw: RMSE {_change(improvement.rmse_before, improvement.rmse_after)}, "
        f"noise floor {format_number(improvement.noise_floor, '.4g')}; "
        f"R² {format_share(improvement.r2_before, '')} → {format_share(improvement.r2_after)}."
    )
    if improvement.shorter_windows is not None:
        shorter = improvement.shorter_windows
        yield Text(
            f"On windows of {format_number(shorter.horizon, '.3g')} s, as the search uses them: RMSE "
            f"{_change(shorter.rmse_before, shorter.rmse_after)}. Longer windows say little here: an "
            "unrecorded disturbance (or accumulated error) exceeds the difference between the models."
        )


def _change(before: Number, after: Number) -> str:
    return f"{format_number(before, '.4g')} → {format_number(after, '.4g')}"


def _exclusions(diagnosis: DiagnosisPart) -> Iterator[RenderableType]:
    """Terms that are absent or too small to detect, and undecided terms by reason."""
    without_joint = [e for e in diagnosis.excluded if e.joint is None]
    if without_joint:
        limits = [
            f"{keyed(e.term, None, e.recording)} {format_quantity(e.largest_hidden, e.unit, 2)}"
            for e in without_joint
        ]
        yield Text(f"{EXCLUDED_HEADING}: {', '.join(limits)}", style="dim")
    rows = limits_by_joint(diagnosis.excluded)
    if rows:
        yield Text(f"{EXCLUDED_HEADING}, by joint", style="dim")
        yield joints_table(rows, "dim")
    by_reason: dict[str, list[str]] = {}
    for term in group_undecided(diagnosis.undecided):
        by_reason.setdefault(term.reason, []).append(term.name)
    for reason, names in by_reason.items():
        yield Text(f"Undecided: {', '.join(names)}: {reason}.", style="dim")
