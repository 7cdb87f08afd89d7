"""Fits and diagnoses as tables that a person reads in a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from labhil.analysis.verdicts import VERDICTS, verdict_line
from labhil.diagnose.answer import Diagnosis
from labhil.identify.fit import Fit
from labhil.identify.score import ChannelScore, Figures, Score
from labhil.identify.statistics import Estimate
from labhil.physics.model import Metric
from labhil.physics.terms import keyed, listed
from labhil.report.absent import joints_table, of_joints, silences
from labhil.report.html.quantity import NOTHING, quantity, squared

NOT_THERE = "Not there, or smaller than this (99 %)"


def show_fit(fit: Fit, console: Console, numbered: Sequence[str] = ()) -> None:
    """Print a fit; ``numbered`` are lines about what it was made from, as several recordings' numbers."""
    explained = fit.adequacy.explained
    console.print(Text(verdict_line(fit.adequacy), style="bold" if explained else "bold yellow"))
    _show_numbered(numbered, console)
    title = f"Parameters: errors robust to correlation, {_kind(fit)}"
    console.print(parameter_table(fit.estimates, title, stars=explained and not fit.sampling))
    for note in _fit_notes(fit):
        console.print(Text("· " + note, style="yellow"))
    console.print(score_table([("train", fit.train)] + ([("test", fit.test)] if fit.test else [])))
    if len(fit.by_window) > 1:
        console.print(window_table(fit))
    console.print(
        f"Residuals: white with p = {fit.ljung_box_p:.2g} (Ljung-Box); uncorrelated with the input with "
        f"p = {fit.input_crosscorrelation_p:.2g}.\n"
        f"{_fitted_on(fit)}, {fit.evaluations} simulations; RMSE there {_left(fit)}"
        + ("." if fit.converged else "; stopped before it had settled.")
    )


def _show_numbered(numbered: Sequence[str], console: Console) -> None:
    for line in numbered:
        console.print(Text(line))


def _fitted_on(fit: Fit) -> str:
    if fit.criterion is Metric.INVERSE_DYNAMICS:
        return "Fitted by inverse dynamics"
    return f"Fitted on windows of {fit.window:.3g} s"


def _left(fit: Fit) -> str:
    return ", ".join(f"{channel.rmse:.4g} {channel.unit}" for channel in fit.left)


def _kind(fit: Fit) -> str:
    together = ", all together" if fit.simultaneous else ""
    return f"99 % intervals by {fit.intervals.value}{together}"


def parameter_table(estimates: Sequence[Estimate], title: str, *, stars: bool = True) -> Table:
    """One row per parameter; ``*`` marks those that differ from zero at 1 %, where ``stars`` may be given."""
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    table.add_column("parameter", no_wrap=True)
    for name in ("value", "± std. error", "99 % interval", "z", "p"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("")
    table.add_column("unit")
    for row in estimates:
        table.add_row(
            row.key,
            f"{row.value:.5g}",
            _or_dash(row.std_error, ".2g"),
            NOTHING if math.isnan(row.ci99[0]) else Text(f"[{row.ci99[0]:.4g}, {row.ci99[1]:.4g}]"),
            _or_dash(row.z, ".1f"),
            NOTHING if math.isnan(row.p_value) else small(row.p_value).removeprefix("= "),
            _mark(row, stars),
            row.unit,
        )
    return table


def _or_dash(value: float, form: str) -> str:
    return NOTHING if math.isnan(value) else f"{value:{form}}"


def percent(share: float, unit: str = " %") -> str:
    """``99.99 %``; a dash where there is none."""
    return f"{100 * share:.2f}{unit}" if math.isfinite(share) else "–"


def small(p_value: float) -> str:
    """A p value as people write it: ``= 0.03``, ``<1e-99``."""
    return "<1e-99" if p_value < 1e-99 else f"= {p_value:.2g}"


def _mark(row: Estimate, stars: bool) -> str:
    if math.isnan(row.std_error):
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
    forces = any(row.relative_error is not None for _, score in scores for row in score.rows_told)
    if forces:
        table.add_column("RMSE/RMS", justify="right")
    for label, figures, metric in _each_recording(scores):
        for channel in figures.rows_told:
            table.add_row(
                label,
                _told(channel, metric),
                f"{channel.rmse:.4g} {channel.unit}",
                f"{channel.noise_floor:.4g} {channel.unit}",
                f"{channel.max_abs_error:.4g} {channel.unit}",
                f"{channel.mse:.4g} {squared(channel.unit)}",
                percent(channel.r2),
                *((_share(channel),) if forces else ()),
            )
    return table


def _told(channel: ChannelScore, metric: Metric) -> str:
    """A channel's name, with the metric where it is not the headline's."""
    name = keyed(channel.channel, channel.joint)
    return name if channel.metric is metric else f"{name} ({channel.metric.value.replace('_', ' ')})"


def _share(channel: ChannelScore) -> str:
    """The error over what was measured, where zero means something."""
    return "" if channel.relative_error is None else f"{100 * channel.relative_error:.2f} %"


def _each_recording(scores: Sequence[tuple[str, Score]]) -> Iterator[tuple[str, Figures, Metric]]:
    for label, score in scores:
        yield label, score, score.metric
        for own in score.recordings:
            yield f"{label} @{own.recording}", own, score.metric


def window_table(fit: Fit) -> Table:
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
        cells = [f"{rung.values[name]:.4g} ± {rung.std_errors[name]:.1g}" for rung in fit.by_window]
        table.add_row(name, *cells)
    table.add_row("residual / noise", *[f"{rung.residual:.2f}" for rung in fit.by_window])
    return table


def _fit_notes(fit: Fit) -> list[str]:
    notes = [
        f"{keyed(row.name, None, row.recording)} is at its bound, so its interval is one-sided at best."
        for row in fit.estimates
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
    notes += fit.sampling
    if not fit.adequacy.explained:
        notes.append(_assumption(fit))
    elif fit.by_window and fit.window < fit.by_window[-1].window:
        notes.append(
            f"Longer windows than {fit.window:.3g} s do not fit to the noise: the plant itself is disturbed, "
            "or physics is missing. `labhil diagnose` tells."
        )
    return notes


def _assumption(fit: Fit) -> str:
    """What the intervals of a model that does not explain its data stand for."""
    if fit.compared:
        lengths = ", ".join(f"{length:.3g}" for length in sorted((*fit.compared, fit.window)))
        wide = f"Intervals are widened by how far the estimates move over windows of {lengths} s"
    else:
        wide = "Intervals are made of one fit only, so what the misfit biases does not show in them"
    return (
        f"{wide}; they assume that the rest of the misfit is independent of these parameters. Nothing is "
        "starred: the model leaves more than noise. `labhil diagnose` looks for what is missing."
    )


def show_diagnosis(diagnosis: Diagnosis, console: Console, numbered: Sequence[str] = ()) -> None:
    """Print a diagnosis; ``numbered`` are lines about what it was made from, as of a fit."""
    _show_numbered(numbered, console)
    console.print(diagnosis_text(diagnosis))


def _on_shorter(before: Score, after: Score) -> str:
    return (
        f"On windows of {after.horizon:.3g} s, as the search uses them: "
        f"RMSE {before.rmse:.4g} → {after.rmse:.4g}. Longer ones say little here: something that is not "
        "recorded drives the plant (or errors add up), and outgrows what the models differ in."
    )


def diagnosis_text(diagnosis: Diagnosis) -> RenderableType:
    """A diagnosis as an engineer would report it."""
    return Group(*_found(diagnosis), *_improvement(diagnosis), *_not_found(diagnosis))


def _found(diagnosis: Diagnosis) -> Iterator[RenderableType]:
    """Verdict, faults, place, missing terms with their rivals, changed values."""
    yield Text(VERDICTS[diagnosis.verdict], style="bold")
    terms = ", ".join(listed(diagnosis.baseline_terms))
    yield Text(f"Baseline: {terms}; p {small(diagnosis.p_value)} that it suffices.")
    for size in diagnosis.collapsed:
        yield Text(f"! {size.statement}", style="yellow")
    for fault in diagnosis.faults:
        yield Text(f"! {fault.statement}", style="yellow")
    if diagnosis.location is not None:
        yield Text(diagnosis.location.statement)
    for item in diagnosis.missing:
        name = keyed(item.term, item.joint)
        yield Text(f"• {name} ({100 * item.probability:.0f} %): {item.statement}", style="green")
        yield Text(
            f"  {item.equation};  ΔBIC {item.evidence.delta_bic:.0f}, "
            f"held-out gain {item.evidence.heldout_loglik_gain:.1f} nats "
            f"(p = {item.evidence.p_value:.2g})"
        )
    for rival in diagnosis.rivals:
        yield Text(
            f"  or {keyed(rival.term, rival.joint)} instead of {rival.instead_of} "
            f"({100 * rival.probability:.0f} %); to tell: {rival.experiment}"
        )
    for change in diagnosis.changed:
        yield Text(
            f"• {keyed(change.name, change.joint, change.recording)} changed from {change.before:.4g} "
            f"to {change.after:.4g} {change.unit} (p = {change.p_value:.2g})"
        )


def _improvement(diagnosis: Diagnosis) -> Iterator[RenderableType]:
    """Scores before and after, and the model that is left."""
    before, after = diagnosis.before, diagnosis.after
    name = "the test recording" if diagnosis.data == "test" else "held-out data"
    yield score_table([("before", before), ("after", after)])
    where = f"the parts of {name} that" if diagnosis.wider else f"{name}, which"
    yield Text(
        f"On {where} the search never saw: RMSE {before.rmse:.4g} → {after.rmse:.4g}, "
        f"noise floor {after.noise_floor:.4g}; R² {percent(before.r2, '')} → {percent(after.r2)}."
    )
    if diagnosis.shorter is not None:
        yield Text(_on_shorter(*diagnosis.shorter))
    yield parameter_table(diagnosis.final, "The model that is left")


def _not_found(diagnosis: Diagnosis) -> Iterator[RenderableType]:
    """What is not there or too small to tell, and what cannot be decided, by reason."""
    whole = [e for e in diagnosis.excluded if e.joint is None]
    if whole:
        limits = [
            f"{keyed(e.term, None, e.recording)} {quantity(e.largest_hidden, e.unit, 2)}" for e in whole
        ]
        yield Text(f"{NOT_THERE}: {', '.join(limits)}", style="dim")
    rows = of_joints(diagnosis.excluded)
    if rows:
        yield Text(f"{NOT_THERE}, by joint", style="dim")
        yield joints_table(rows, "dim")
    by_reason: dict[str, list[str]] = {}
    for silence in silences(diagnosis.undecided):
        by_reason.setdefault(silence.reason, []).append(silence.name)
    for reason, names in by_reason.items():
        yield Text(f"Undecided: {', '.join(names)}: {reason}.", style="dim")
