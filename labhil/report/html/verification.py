"""A verification as a page: the verdict, what was tested, and what speaks against the model."""

from __future__ import annotations

from collections.abc import Sequence

from labhil.analysis.schema import ChannelVerdict, ValueChange, VerificationPart
from labhil.report.html.element import Content, Markup, tag
from labhil.report.html.model import named, names, recordings_table, warning
from labhil.report.html.page import Page, Section, present, section
from labhil.report.html.quantity import multiple, p_value, quantity
from labhil.report.html.table import bullets, facts, numbers, table, text, tiles

CONSISTENT = "The recording is consistent with the model."
CONTRADICTED = "The recording contradicts the model."


def verification_page(found: VerificationPart, foot: str) -> Page:
    """The page of a verification."""
    return Page(
        kind=f"Verification of a model · {found.rig}",
        title="Verification",
        headline=CONSISTENT if found.consistent else CONTRADICTED,
        tone="no_mismatch" if found.consistent else "missing_physics",
        lead=_lead(found),
        sections=present(
            section("What contradicts", bullets(found.reasons) if found.reasons else None),
            _channels(found),
            _values(found.parameters, found),
            _windows(found),
            section("Recording and model", recordings_table(found.recordings), _facts(found)),
        ),
        foot=foot,
    )


def _lead(found: VerificationPart) -> tuple[Content, ...]:
    worst = max(found.channels, key=lambda row: row.ratio or 0.0, default=None)
    entries: list[tuple[str, Content, Content]] = [
        ("p of the model", p_value(found.p_value), f"contradicted below {quantity(found.alpha, digits=2)}"),
    ]
    if worst is not None:
        limit = quantity(worst.limit, digits=3)
        entries.append(("RMSE ÷ noise floor", multiple(worst.rmse, worst.noise_floor), f"limit {limit}"))
    entries.append(("p of the values", p_value(found.values_p), "all parameters together"))
    statement = tag("p", found.statement, class_="lead")
    doubtful = (*(fault.statement for fault in found.faults), *found.doubts, *found.notes)
    return (statement, *map(warning, doubtful), tiles(entries))


def _channels(found: VerificationPart) -> Section | None:
    columns = (
        *text("Output"),
        *numbers("RMSE", "Noise floor", "Ratio", "Limit", "p", "p of residuals and input"),
    )
    horizon = found.score.horizon
    how = "inverse dynamics" if horizon is None else f"simulated windows of {quantity(horizon, 's')}"
    caption = f"Each output with the values as they are, {how}"
    return section("How well it predicts", table(caption, columns, [_channel(row) for row in found.channels]))


def _channel(row: ChannelVerdict) -> Sequence[Content]:
    return (
        named(row.channel, row.joint),
        quantity(row.rmse, row.unit),
        quantity(row.noise_floor, row.unit),
        quantity(row.ratio, digits=3),
        quantity(row.limit, digits=3),
        p_value(row.rmse_p),
        p_value(row.structure_p),
    )


def _values(rows: Sequence[ValueChange], found: VerificationPart) -> Section | None:
    if not rows:
        return None
    columns = (
        *text("Parameter"),
        *numbers("Accepted", "Refitted", "± of the difference", "z", "p"),
        *text(""),
    )
    caption = (
        f"Values, refitted on windows of {quantity(found.window, 's')}; p allows for all that were looked at"
    )
    return section("Whether its values hold", table(caption, columns, [_value(row) for row in rows]))


def _value(row: ValueChange) -> Sequence[Content]:
    return (
        named(row.name, row.joint),
        quantity(row.before, row.unit),
        quantity(row.after, row.unit),
        quantity(row.std_error, digits=2),
        quantity(row.z, digits=2),
        p_value(row.p_value),
        "changed" if row.changed else "",
    )


def _windows(found: VerificationPart) -> Section | None:
    if found.score.horizon is None or not found.worst_windows:
        return None
    rows = [
        (f"{quantity(each.begin, 's')} to {quantity(each.end, 's')}", quantity(each.ratio, digits=3))
        for each in found.worst_windows
    ]
    columns = (*text("When"), *numbers("RMSE ÷ noise floor"))
    return section("Where it is worst", table("The windows that are simulated worst", columns, rows))


def _facts(found: VerificationPart) -> Markup:
    return facts(
        (
            ("Model", tag("code", found.model)),
            ("Terms", names(found.terms)),
            ("False alarms", quantity(found.alpha, digits=2)),
            ("Time taken", quantity(found.seconds, "s", digits=3)),
        )
    )
