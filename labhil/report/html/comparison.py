"""A comparison of models as a page: the verdict, the models over the measurement, their shared parameters."""

from __future__ import annotations

from collections.abc import Sequence

from labhil.analysis.schema import ComparedChannel, ComparedModel, ComparisonPart, SharedParameter
from labhil.report.comparison import on_what
from labhil.report.html.element import Content, Markup, joined, tag
from labhil.report.html.model import named, names, recordings_table, warning
from labhil.report.html.page import Page, Section, present, section
from labhil.report.html.quantity import NOTHING, interval, p_value, percent, quantity
from labhil.report.html.table import bullets, facts, numbers, table, text, tiles, with_code

AGREE = {True: "agree", False: "disagree", None: "not known"}


def comparison_page(found: ComparisonPart, foot: str, pictures: Sequence[Markup] = ()) -> Page:
    """The page of a comparison; without ``pictures`` where there are no samples to draw."""
    best = found.best_model
    alike = sum(not model.worse_than_best for model in found.models)
    headline = (
        f"{found.best} explains the data best."
        if found.verdict == "one_best"
        else f"{alike} of {len(found.models)} models explain the data alike."
    )
    return Page(
        kind=f"Comparison of models · {found.rig}",
        title="Comparison of models",
        headline=headline,
        tone="no_mismatch" if best.adequacy == "explained" else "missing_physics",
        lead=_lead(found),
        sections=present(
            section(
                "What to do next", bullets(map(with_code, found.next_steps)) if found.next_steps else None
            ),
            section("Measurement and models", *pictures),
            section("How well each predicts", _models(found), _terms(found)),
            _parameters(found),
            section("Data", recordings_table(found.recordings), _facts(found)),
        ),
        foot=foot,
    )


def _lead(found: ComparisonPart) -> tuple[Content, ...]:
    best = found.best_model
    worst = max(found.models, key=lambda model: model.times_best or float("inf"))
    entries: list[tuple[str, Content, Content]] = [
        ("Smallest error", quantity(best.rmse_over_noise, digits=3), "noise levels"),
        ("Largest error", quantity(worst.rmse_over_noise, digits=3), f"noise levels, {worst.name}"),
        ("Model to take", found.preferred, "the simplest of those that are as good as the best"),
    ]
    statement = tag("p", found.statement, class_="lead")
    return (statement, *map(warning, found.notes), tiles(entries))


def _models(found: ComparisonPart) -> Markup:
    columns = (
        *text("Model", "Output"),
        *numbers("RMSE", "Noise floor", "Noise levels", "R²", "Parameters", "× best", "p"),
    )
    rows = [
        _model(model, row, best=model.name == found.best)
        for model in found.models
        for row in model.per_channel
    ]
    return table(f"{on_what(found)}; p: of being no worse than the best", columns, rows)


def _model(model: ComparedModel, row: ComparedChannel, *, best: bool) -> Sequence[Content]:
    return (
        tag("strong", model.name) if best else model.name,
        named(row.channel, row.joint),
        quantity(row.rmse, row.unit),
        quantity(row.noise_floor, row.unit),
        quantity(row.rmse_over_noise, digits=3),
        percent(row.r2),
        model.n_parameters,
        quantity(model.times_best, digits=3),
        "best" if best else p_value(model.p_value),
    )


def _terms(found: ComparisonPart) -> Markup:
    pairs: list[tuple[Content, Content]] = [
        (
            model.name,
            joined((names(model.terms), tag("span", f" ({model.made_by} {model.path})", class_="remark"))),
        )
        for model in found.models
    ]
    return facts(pairs)


def _parameters(found: ComparisonPart) -> Section | None:
    if not found.parameters:
        return None
    columns = (*text("Parameter"), *numbers(*(model.name for model in found.models)), *text("Values"))
    caption = "Parameters that two models or more have: value, and 99 % interval under it"
    rows = [_parameter(row, found.models) for row in found.parameters]
    remark = tag(
        "p",
        "The errors of two fits are added as if they were independent; fits of one recording share its "
        "noise, so that values that disagree do so all the more. z: the largest difference over its error.",
        class_="remark",
    )
    return section("Parameters side by side", table(caption, columns, rows), remark)


def _parameter(row: SharedParameter, models: Sequence[ComparedModel]) -> Sequence[Content]:
    z = "" if row.z is None else f", z {quantity(row.z, digits=2)}"
    verdict = f"{AGREE[row.agree]}{z}"
    return (
        joined((named(row.name, row.joint), f", {row.unit}" if row.unit not in ("", "1") else "")),
        *(_value(row, model.name) for model in models),
        tag("strong", verdict) if row.agree is False else verdict,
    )


def _value(row: SharedParameter, model: str) -> Content:
    value = next((each for each in row.values if each.model == model), None)
    if value is None:
        return NOTHING
    if value.held:
        about = "held"
    elif not value.identifiable:
        about = "not identifiable"
    else:
        about = interval(value.ci99)
    return joined((quantity(value.value), tag("br"), tag("span", about, class_="remark")))


def _facts(found: ComparisonPart) -> Markup:
    horizon = "inverse dynamics" if found.horizon is None else f"windows of {quantity(found.horizon, 's')}"
    return facts(
        (
            ("Metric", f"{found.metric.replace('_', ' ')}, {horizon}"),
            ("False alarms", f"{quantity(found.alpha, digits=2)} of each question"),
            ("Time taken", quantity(found.seconds, "s", digits=3)),
        )
    )
