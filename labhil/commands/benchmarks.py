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
    _hand_on(app, "reference", "5.3 5.5 --quick", "Set the reference text's tables beside ours (benchmarks).")
    _hand_on(
        app,
        "benchmark",
        "dc_motor --recordings 20 -o bench",
        "Measure the statistics by simulation (benchmarks).",
    )


def add_trial_benchmarks(trial: typer.Typer) -> None:
    """Register what is done with many sealed trials."""
    _hand_on(
        trial,
        "trial benchmark",
        "axis --trials 300 -o axis-trials",
        "Make, diagnose and score hundreds of trials (benchmarks).",
    )
    _hand_on(
        trial, "trial compare", "axis.json dc_motor.json", "Print score cards side by side (benchmarks)."
    )
    _hand_on(
        trial, "trial calibrate", "axis-trials/effects", "Fit how probable a claim is to trials (benchmarks)."
    )


def _hand_on(app: typer.Typer, words: str, example: str, about: str) -> None:
    def command(context: typer.Context) -> None:
        from labhil.campaign.benchmarks import benchmark_module

        module = benchmark_module("command_line", f"`labhil {words}`")
        module.run([*words.split(), *context.args])

    command.__doc__ = about
    name = words.rpartition(" ")[2]
    app.command(name, epilog=f"Example: labhil {words} {example}", context_settings=AS_THEY_ARE)(command)
