"""The page of a verification: the verdict, what was tested, and what contradicts the model."""

from __future__ import annotations

from collections.abc import Sequence

from labhil.analysis.schema import ChannelVerdict, ValueChange, VerificationPart
from labhil.report.formatting import format_multiple, format_p_value, format_quantity
from labhil.report.html.element import Content, Markup, tag
from labhil.report.html.model import name_code, names, next_steps_section, recordings_table, warning
from labhil.report.html.page import Page, PageSection, drop_empty, section
from labhil.report.html.table import bullets, facts, numbers, table, text, tiles

CONSISTENT = "The recording is consistent with the model."
CONTRADICTED = "The recording contradicts the model."


def verification_page(verification: VerificationPart, foot: str) -> Page:
    """Make the page of a verification.

    Args:
        verification: The result.
        foot: Last line of the page: where it comes from.
    """
    return Page(
        kind=f"Verification of a model · {verification.rig}",
        title="Verification",
        headline=CONSISTENT if verification.consistent else CONTRADICTED,
        tone="no_mismatch" if verification.consistent else "missing_physics",
        lead=_lead(verification),
        sections=drop_empty(
            next_steps_section(verification.next_steps),
            section("What contradicts", bullets(verification.reasons) if verification.reasons else None),
            _channels(verification),
            _values(verification.parameters, verification),
            _windows(verification),
            section("Recording and model", recordings_table(verification.recordings), _facts(verification)),
        ),
        foot=foot,
    )


def _lead(verification: VerificationPart) -> tuple[Content, ...]:
    worst = max(verification.channels, key=lambda row: row.ratio or 0.0, default=None)
    entries: list[tuple[str, Content, Content]] = [
        (
            "p of the model",
            format_p_value(verification.p_value),
            f"contradicted below {format_quantity(verification.alpha, digits=2)}",
        ),
    ]
    if worst is not None:
        limit = format_quantity(worst.limit, digits=3)
        entries.append(
            ("RMSE ÷ noise floor", format_multiple(worst.rmse, worst.noise_floor), f"limit {limit}")
        )
    entries.append(("p of the values", format_p_value(verification.values_p), "all parameters together"))
    statement = tag("p", verification.statement, class_="lead")
    doubtful = (
        *(fault.statement for fault in verification.faults),
        *verification.doubts,
        *verification.notes,
    )
    return (statement, *map(warning, doubtful), tiles(entries))


def _channels(verification: VerificationPart) -> PageSection | None:
    columns = (
        *text("Output"),
        *numbers("RMSE", "Noise floor", "Ratio", "Limit", "p", "p of residuals and input"),
    )
    horizon = verification.score.horizon
    how = "inverse dynamics" if horizon is None else f"simulated windows of {format_quantity(horizon, 's')}"
    caption = f"Each output with the values as they are, {how}"
    return section(
        "How well it predicts", table(caption, columns, [_channel(row) for row in verification.channels])
    )


def _channel(row: ChannelVerdict) -> Sequence[Content]:
    return (
        name_code(row.channel, row.joint),
        format_quantity(row.rmse, row.unit),
        format_quantity(row.noise_floor, row.unit),
        format_quantity(row.ratio, digits=3),
        format_quantity(row.limit, digits=3),
        format_p_value(row.rmse_p),
        format_p_value(row.structure_p),
    )


def _values(rows: Sequence[ValueChange], verification: VerificationPart) -> PageSection | None:
    if not rows:
        return None
    columns = (
        *text("Parameter"),
        *numbers("Accepted", "Refitted", "± of the difference", "z", "p"),
        *text(""),
    )
    window = format_quantity(verification.window, "s")
    caption = f"Values, refitted on windows of {window}; p allows for all that were looked at"
    return section("Whether its values hold", table(caption, columns, [_value(row) for row in rows]))


def _value(row: ValueChange) -> Sequence[Content]:
    return (
        name_code(row.name, row.joint),
        format_quantity(row.before, row.unit),
        format_quantity(row.after, row.unit),
        format_quantity(row.std_error, digits=2),
        format_quantity(row.z, digits=2),
        format_p_value(row.p_value),
        "changed" if row.changed else "",
    )


def _windows(verification: VerificationPart) -> PageSection | None:
    if verification.score.horizon is None or not verification.worst_windows:
        return None
    rows = [
        (
            f"{format_quantity(window.begin, 's')} to {format_quantity(window.end, 's')}",
            format_quantity(window.ratio, digits=3),
        )
        for window in verification.worst_windows
    ]
    columns = (*text("When"), *numbers("RMSE ÷ noise floor"))
    return section("Where it is worst", table("The windows that are simulated worst", columns, rows))


def _facts(verification: VerificationPart) -> Markup:
    return facts(
        (
            ("Model", tag("code", verification.model)),
            ("Terms", names(verification.terms)),
            ("False alarms", format_quantity(verification.alpha, digits=2)),
            ("Time taken", format_quantity(verification.seconds, "s", digits=3)),
        )
    )
