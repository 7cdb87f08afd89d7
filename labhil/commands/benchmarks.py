"""Commands whose work is in ``benchmarks/`` of a checkout: this room only hands them on."""

from __future__ import annotations

from typing import Any

import typer

AS_THEY_ARE: dict[str, Any] = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "allow_interspersed_args": False,
    "help_option_names": [],
}
"""Arguments are not read here: help and errors are those of the benchmarks' own command line."""


def add_benchmarks(app: typer.Typer) -> None:
    """Register the tables of the reference text and the benchmark of the statistics."""
    _hand_on(app, ("reference",), "Set the reference text's tables beside ours (benchmarks).")
    _hand_on(app, ("benchmark",), "Measure the statistics on recordings with known answers (benchmarks).")


def add_trial_benchmarks(trial: typer.Typer) -> None:
    """Register what is done with many sealed trials."""
    _hand_on(trial, ("trial", "benchmark"), "Make, diagnose and score hundreds of trials (benchmarks).")
    _hand_on(trial, ("trial", "compare"), "Print score cards side by side (benchmarks).")
    _hand_on(trial, ("trial", "calibrate"), "Fit how probable a claim is to trials (benchmarks).")


def _hand_on(app: typer.Typer, words: tuple[str, ...], about: str) -> None:
    def command(context: typer.Context) -> None:
        from labhil.campaign.benchmarks import benchmark_module

        module = benchmark_module("command_line", f"`labhil {' '.join(words)}`")
        module.run([*words, *context.args])

    app.command(words[-1], help=about, context_settings=AS_THEY_ARE)(command)
