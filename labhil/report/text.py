"""Fits and diagnoses as tables that a person reads in a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.console import Console, Group, RenderableType
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
from labhil.report.html.quantity import NOTHING, quantity, squared
from labhil.report.parameter_columns import COLUMNS, number_text, p_text

NOT_THERE = "Not there, or smaller than this (99 %)"


def show_fit(fit: FitPart, console: Console) -> None:
    """Print a fit."""
    console.print(fit_text(fit))


def fit_text(fit: FitPart) -> RenderableType:
    """A fit as an engineer would report it."""
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


def _fit_summary(fit: FitPart) -> str:
    """How white the residuals are, and how the fit was made."""
    settled = "." if fit.converged else "; stopped before it had settled."
    return (
        f"Residuals: white with p {p_text(fit.residuals.ljung_box_p)} (Ljung-Box); uncorrelated "
        f"with the input with p {p_text(fit.residuals.input_crosscorrelation_p)}.\n"
        f"{_criterion(fit)}, {fit.evaluations} simulations; RMSE there {_remaining_rmse(fit)}{settled}"
    )


def recording_numbers(sources: Sequence[Source]) -> list[str]:
    """The number of each of several recordings with its file, a line each; nothing for one."""
    return [
        f"@{source.recording}  {source.path}, {number_text(source.duration, '.4g')} s"
        + (" (test)" if source.role == "test" else "")
        for source in sources
        if source.recording is not None
    ]


def _criterion(fit: FitPart) -> str:
    if fit.criterion == "inverse_dynamics":
        return "Fitted by inverse dynamics"
    return f"Fitted on windows of {number_text(fit.window, '.3g')} s"


def _remaining_rmse(fit: FitPart) -> str:
    return ", ".join(f"{number_text(channel.rmse, '.4g')} {channel.unit}" for channel in fit.left)


def _interval_method(fit: FitPart) -> str:
    together = ", all together" if fit.intervals.simultaneous else ""
    return f"99 % intervals by {fit.intervals.method}{together}"


def parameter_table(estimates: Sequence[Parameter], title: str, *, stars: bool = True) -> Table:
    """One row per parameter; ``*`` marks those that differ from zero at 1 %, where ``stars`` may be given."""
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    columns = [column.terminal for column in COLUMNS if column.terminal is not None]
    table.add_column("parameter", no_wrap=True)
    for name, _ in columns:
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("")
    table.add_column("unit")
    for row in estimates:
        table.add_row(row.key, *(Text(cell(row)) for _, cell in columns), _mark(row, stars), row.unit)
    return table


def percent(share: Number, unit: str = " %") -> str:
    """``99.99 %``; a dash where there is none."""
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
    """Errors of windowed simulation, one row per data set and channel, then those of each recording."""
    horizon = scores[0][1].horizon
    table = Table(
        title="Inverse dynamics" if horizon is None else f"Simulated windows of {horizon:.3g} s",
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
    )
    for name in ("data", "channel", "RMSE", "noise floor", "max. error", "MSE", "R²"):
        table.add_column(name, justify="left" if name in ("data", "channel") else "right")
    forces = any(row.relative_error is not None for _, score in scores for row in score.per_channel)
    if forces:
        table.add_column("RMSE/RMS", justify="right")
    for label, channels, metric in _each_recording(scores):
        for channel in channels:
            unit = channel.unit
            table.add_row(
                label,
                _channel_name(channel, metric),
                f"{number_text(channel.rmse, '.4g')} {unit}",
                f"{number_text(channel.noise_floor, '.4g')} {unit}",
                f"{number_text(channel.max_abs_error, '.4g')} {unit}",
                f"{number_text(channel.mse, '.4g')} {squared(unit)}",
                percent(channel.r2),
                *((_share(channel),) if forces else ()),
            )
    return table


def _channel_name(channel: ChannelErrors, metric: str) -> str:
    """A channel's name, with the metric where it is not the headline's."""
    name = keyed(channel.channel, channel.joint)
    return name if channel.metric in (None, metric) else f"{name} ({channel.metric.replace('_', ' ')})"


def _share(channel: ChannelErrors) -> str:
    """The error over the measurement, where zero means something."""
    return "" if channel.relative_error is None else f"{100 * channel.relative_error:.2f} %"


def _each_recording(
    scores: Sequence[tuple[str, Score]],
) -> Iterator[tuple[str, Sequence[ChannelErrors], str]]:
    for label, score in scores:
        yield label, score.per_channel, score.metric
        for errors in score.per_recording:
            yield f"{label} @{errors.recording}", errors.per_channel, score.metric


def window_table(fit: FitPart) -> Table:
    """How estimates move with the length of the fitted windows."""
    table = Table(
        title="How the estimates move with the fitted window",
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
    )
    table.add_column("parameter")
    for rung in fit.by_window:
        table.add_column(f"{rung.window:.3g} s", justify="right")
    for name in fit.by_window[0].values:
        cells = [
            f"{number_text(rung.values[name], '.4g')} ± {number_text(rung.std_errors[name], '.1g')}"
            for rung in fit.by_window
        ]
        table.add_row(name, *cells)
    table.add_row("residual / noise", *[number_text(rung.residual, ".2f") for rung in fit.by_window])
    return table


def _fit_notes(fit: FitPart) -> list[str]:
    notes = [
        f"{keyed(row.name, None, row.recording)} is at its bound, so its interval is one-sided at best."
        for row in fit.parameters
        if row.at_bound and row.identifiable
    ]
    if fit.identifiability.rank < fit.identifiability.of:
        known = ", ".join(fit.identifiability.combinations) or "nothing"
        notes.append(
            f"The data know {fit.identifiability.rank} of {fit.identifiability.of} parameters; "
            f"what they know of the rest: {known}."
        )
        if fit.identifiability.would_help:
            notes.append(f"It would help to know or to record: {', '.join(fit.identifiability.would_help)}.")
    channels = tuple(f.statement.split()[0] for f in fit.faults if f.kind == FaultKind.UNDERSAMPLED)
    notes += [note for note in fit.sampling if not note.startswith(channels)]
    if fit.verdict not in (None, "explained"):
        notes.append(_assumption(fit))
    elif fit.by_window and fit.window is not None and fit.window < fit.by_window[-1].window:
        notes.append(
            f"Longer windows than {fit.window:.3g} s do not fit to the noise: the plant itself is disturbed, "
            "or physics is missing. `labhil diagnose` tells."
        )
    return notes


def _assumption(fit: FitPart) -> str:
    """What the intervals of a model that does not explain its data stand for."""
    if fit.compared:
        lengths = ", ".join(f"{length:.3g}" for length in sorted((*fit.compared, fit.window or 0.0)))
        assumption = f"Intervals are widened by how far the estimates move over windows of {lengths} s"
    else:
        assumption = "Intervals are made of one fit only, so what the misfit biases does not show in them"
    return (
        f"{assumption}; they assume that the rest of the misfit is independent of these parameters. Nothing "
        "is starred: the model leaves more than noise. `labhil diagnose` looks for what is missing."
    )


def show_diagnosis(diagnosis: DiagnosisPart, console: Console) -> None:
    """Print a diagnosis."""
    console.print(diagnosis_text(diagnosis))


def diagnosis_text(diagnosis: DiagnosisPart) -> RenderableType:
    """A diagnosis as an engineer would report it."""
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
    """What to do next, a line each, under its heading; nothing where there is none."""
    if steps:
        yield Text("What to do next", style="bold")
        yield from (Text(f"· {step}") for step in steps)


def _findings(diagnosis: DiagnosisPart) -> Iterator[RenderableType]:
    """Faults, place, missing terms with their rivals, changed values."""
    terms = ", ".join(listed(diagnosis.baseline.terms)) or "no terms"
    suffices = f"p {p_text(diagnosis.p_value)} that it suffices" if diagnosis.asks_baseline else NOT_TESTED
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
            f"  {item.equation};  ΔBIC {number_text(item.evidence.delta_bic, '.0f')}, "
            f"held-out gain {number_text(item.evidence.heldout_loglik_gain, '.1f')} nats "
            f"(p {p_text(item.evidence.p_value)})"
        )
    for rival in diagnosis.rivals:
        yield Text(
            f"  or {keyed(rival.term, rival.joint)} instead of {rival.instead_of} "
            f"({_chance(rival.probability)}); to tell: {rival.experiment}"
        )
    if diagnosis.remainder is not None:
        yield Text(diagnosis.remainder.statement)
    for change in diagnosis.changed:
        yield Text(
            f"• {keyed(change.name, change.joint, change.recording)} changed from "
            f"{number_text(change.before, '.4g')} to {number_text(change.after, '.4g')} {change.unit} "
            f"(p {p_text(change.p_value)})"
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
        f"noise floor {number_text(improvement.noise_floor, '.4g')}; "
        f"R² {percent(improvement.r2_before, '')} → {percent(improvement.r2_after)}."
    )
    if improvement.shorter_windows is not None:
        shorter = improvement.shorter_windows
        yield Text(
            f"On windows of {number_text(shorter.horizon, '.3g')} s, as the search uses them: RMSE "
            f"{_change(shorter.rmse_before, shorter.rmse_after)}. Longer ones say little here: something "
            "that is not recorded drives the plant (or errors add up), and outgrows what the models differ "
            "in."
        )


def _change(before: Number, after: Number) -> str:
    return f"{number_text(before, '.4g')} → {number_text(after, '.4g')}"


def _exclusions(diagnosis: DiagnosisPart) -> Iterator[RenderableType]:
    """What is absent or too small to detect, and what cannot be decided, by reason."""
    without_joint = [e for e in diagnosis.excluded if e.joint is None]
    if without_joint:
        limits = [
            f"{keyed(e.term, None, e.recording)} {quantity(e.largest_hidden, e.unit, 2)}"
            for e in without_joint
        ]
        yield Text(f"{NOT_THERE}: {', '.join(limits)}", style="dim")
    rows = limits_by_joint(diagnosis.excluded)
    if rows:
        yield Text(f"{NOT_THERE}, by joint", style="dim")
        yield joints_table(rows, "dim")
    by_reason: dict[str, list[str]] = {}
    for term in group_undecided(diagnosis.undecided):
        by_reason.setdefault(term.reason, []).append(term.name)
    for reason, names in by_reason.items():
        yield Text(f"Undecided: {', '.join(names)}: {reason}.", style="dim")
