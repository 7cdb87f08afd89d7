"""The page of a comparison: the verdict, the models over the measurement, their shared parameters."""

from __future__ import annotations

from collections.abc import Sequence

from labhil.analysis.schema import ComparedChannel, ComparedModel, ComparisonPart, SharedParameter
from labhil.report.comparison import comparison_basis
from labhil.report.formatting import (
    NOTHING,
    format_interval,
    format_p_value,
    format_percent,
    format_powers,
    format_quantity,
)
from labhil.report.html.element import Content, Markup, join, tag
from labhil.report.html.model import name_code, names, next_steps_section, recordings_table, warning
from labhil.report.html.page import Page, PageSection, drop_empty, section
from labhil.report.html.table import facts, numbers, table, text, tiles

AGREE = {True: "agree", False: "disagree", None: "not known"}


def comparison_page(comparison: ComparisonPart, foot: str, pictures: Sequence[Markup] = ()) -> Page:
    """Make the page of a comparison.

    Args:
        comparison: The result.
        foot: Last line of the page: where it comes from.
        pictures: Models over the measurement; none where there are no samples to draw.
    """
    best = comparison.best_model
    n_best = sum(not model.worse_than_best for model in comparison.models)
    headline = (
        f"{comparison.best} explains the data best."
        if comparison.verdict == "one_best"
        else f"{n_best} of {len(comparison.models)} models explain the data alike."
    )
    return Page(
        kind=f"Comparison of models · {comparison.rig}",
        title="Comparison of models",
        headline=headline,
        tone="no_mismatch" if best.adequacy == "explained" else "missing_physics",
        lead=_lead(comparison),
        sections=drop_empty(
            next_steps_section(comparison.next_steps),
            section("Measurement and models", *pictures),
            section("How well each predicts", _models(comparison), _terms(comparison)),
            _parameters(comparison),
            section("Data", recordings_table(comparison.recordings), _facts(comparison)),
        ),
        foot=foot,
    )


def _lead(comparison: ComparisonPart) -> tuple[Content, ...]:
    best = comparison.best_model
    worst = max(comparison.models, key=lambda model: model.times_best or float("inf"))
    entries: list[tuple[str, Content, Content]] = [
        ("Smallest error", format_quantity(best.rmse_over_noise, digits=3), "noise levels"),
        ("Largest error", format_quantity(worst.rmse_over_noise, digits=3), f"noise levels, {worst.name}"),
        ("Model to take", comparison.preferred, "the simplest of those that are as good as the best"),
    ]
    statement = tag("p", format_powers(comparison.statement), class_="lead")
    return (statement, *map(warning, comparison.notes), tiles(entries))


def _models(comparison: ComparisonPart) -> Markup:
    columns = (
        *text("Model", "Output"),
        *numbers("RMSE", "Noise floor", "Noise levels", "R²", "Parameters", "× best", "p"),
    )
    rows = [
        _model(model, row, best=model.name == comparison.best)
        for model in comparison.models
        for row in model.per_channel
    ]
    return table(f"{comparison_basis(comparison)}; p: of being no worse than the best", columns, rows)


def _model(model: ComparedModel, row: ComparedChannel, *, best: bool) -> Sequence[Content]:
    return (
        tag("strong", model.name) if best else model.name,
        name_code(row.channel, row.joint),
        format_quantity(row.rmse, row.unit),
        format_quantity(row.noise_floor, row.unit),
        format_quantity(row.rmse_over_noise, digits=3),
        format_percent(row.r2),
        model.n_parameters,
        format_quantity(model.times_best, digits=3),
        "best" if best else format_p_value(model.p_value),
    )


def _terms(comparison: ComparisonPart) -> Markup:
    pairs: list[tuple[Content, Content]] = [
        (
            model.name,
            join((names(model.terms), tag("span", f" ({model.made_by} {model.path})", class_="remark"))),
        )
        for model in comparison.models
    ]
    return facts(pairs)


def _parameters(comparison: ComparisonPart) -> PageSection | None:
    if not comparison.parameters:
        return None
    columns = (*text("Parameter"), *numbers(*(model.name for model in comparison.models)), *text("Values"))
    caption = "Parameters that two models or more have: value, and 99 % interval under it"
    rows = [_parameter(row, comparison.models) for row in comparison.parameters]
    remark = tag(
        "p",
        "The errors of two fits are added as if they were independent; fits of one recording share its "
        "noise, so that values that disagree do so all the more. z: the largest difference over its error.",
        class_="remark",
    )
    return section("Parameters side by side", table(caption, columns, rows), remark)


def _parameter(row: SharedParameter, models: Sequence[ComparedModel]) -> Sequence[Content]:
    z = "" if row.z is None else f", z {format_quantity(row.z, digits=2)}"
    verdict = f"{AGREE[row.agree]}{z}"
    return (
        join((name_code(row.name, row.joint), f", {row.unit}" if row.unit not in ("", "1") else "")),
        *(_value(row, model.name) for model in models),
        tag("strong", verdict) if row.agree is False else verdict,
    )


def _value(row: SharedParameter, model: str) -> Content:
    estimate = next((candidate for candidate in row.values if candidate.model == model), None)
    if estimate is None:
        return NOTHING
    if estimate.held:
        remark = "held"
    elif not estimate.identifiable:
        remark = "not identifiable"
    else:
        remark = format_interval(estimate.ci99)
    return join((format_quantity(estimate.value), tag("br"), tag("span", remark, class_="remark")))


def _facts(comparison: ComparisonPart) -> Markup:
    horizon = (
        "inverse dynamics"
        if comparison.horizon is None
        else f"windows of {format_quantity(comparison.horizon, 's')}"
    )
    return facts(
        (
            ("Metric", f"{comparison.metric.replace('_', ' ')}, {horizon}"),
            ("False alarms", f"{format_quantity(comparison.alpha, digits=2)} of each question"),
            ("Time taken", format_quantity(comparison.seconds, "s", digits=3)),
        )
    )
