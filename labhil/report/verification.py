"""A verification as tables for a person."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from labhil.analysis.schema import VerificationPart
from labhil.physics.terms import keyed
from labhil.report.parameter_columns import figure, small


def show_verification(found: VerificationPart, console: Console) -> None:
    """Print the answer, what was tested, and where the simulation is worst."""
    console.print(verification_text(found))


def verification_text(found: VerificationPart) -> RenderableType:
    """The answer, what was tested, and where the simulation is worst."""
    return Group(*_pieces(found))


def _pieces(found: VerificationPart) -> Iterator[RenderableType]:
    verdict = "consistent with the model" if found.consistent else "The recording contradicts the model"
    begin = "The recording is " if found.consistent else ""
    yield Text(
        f"{begin}{verdict} (p {small(found.p_value)}, false alarms {found.alpha:g}).",
        style="bold green" if found.consistent else "bold red",
    )
    yield Text(found.statement, style="" if found.adequacy == "explained" else "yellow")
    for line in (*(f"! {fault.statement}" for fault in found.faults), *found.doubts):
        yield Text(line, style="yellow")
    for reason in found.reasons:
        yield Text("· " + reason)
    for note in found.notes:
        yield Text("· " + note, style="yellow")
    yield channel_table(found)
    if found.parameters:
        yield value_table(found)
    if found.score.horizon is not None:
        yield window_table(found)


def _table(title: str, left: tuple[str, ...], right: tuple[str, ...]) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for name in left:
        table.add_column(name, no_wrap=True)
    for name in right:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def channel_table(found: VerificationPart) -> Table:
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
            f"{figure(c.rmse, '.4g')} {c.unit}",
            f"{figure(c.noise_floor, '.4g')} {c.unit}",
            figure(c.ratio, ".3g"),
            figure(c.limit, ".3g"),
            small(c.rmse_p).removeprefix("= "),
            small(c.structure_p).removeprefix("= "),
        )
    return table


def value_table(found: VerificationPart) -> Table:
    """A row per parameter: accepted, refitted, and whether they differ."""
    table = _table(
        f"Values, refitted on windows of {figure(found.window, '.3g')} s: "
        f"all together p {small(found.values_p)}",
        ("parameter",),
        ("accepted", "refitted", "± of the difference", "z", "p (all looked at)"),
    )
    table.add_column("")
    table.add_column("unit")
    for change in found.parameters:
        table.add_row(
            keyed(change.name, change.joint),
            figure(change.before, ".5g"),
            figure(change.after, ".5g"),
            figure(change.std_error, ".2g"),
            figure(change.z, ".1f"),
            small(change.p_value).removeprefix("= "),
            "changed" if change.changed else "",
            change.unit,
        )
    return table


def window_table(found: VerificationPart) -> Table:
    """The windows that are simulated worst."""
    table = _table("Worst windows", (), ("from", "to", "RMSE / noise floor"))
    for window in found.worst_windows:
        table.add_row(f"{window.begin:.4g} s", f"{window.end:.4g} s", figure(window.ratio, ".3g"))
    return table
