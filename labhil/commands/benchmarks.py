"""Commands of ``benchmarks/`` in a checkout of the repository; they are forwarded to it."""

from __future__ import annotations

from typing import Any

import typer

FORWARD_ARGUMENTS: dict[str, Any] = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "allow_interspersed_args": False,
    "help_option_names": [],
}
"""Settings that leave all arguments, help and errors to the benchmarks' own command line."""


def add_benchmarks(app: typer.Typer) -> None:
    """Register ``labhil reference`` and ``labhil benchmark``."""
    _forward(app, "reference", "5.3 5.5 --quick", "Set the reference text's tables beside ours (benchmarks).")
    _forward(
        app,
        "benchmark",
        "dc_motor --recordings 20 -o bench",
        "Measure the statistics by simulation (benchmarks).",
    )


def add_trial_benchmarks(trial: typer.Typer) -> None:
    """Register the benchmarks of sealed trials."""
    _forward(
        trial,
        "trial benchmark",
        "axis --trials 300 -o axis-trials",
        "Make, diagnose and score hundreds of trials (benchmarks).",
    )
    _forward(
        trial, "trial compare", "axis.json dc_motor.json", "Print score cards side by side (benchmarks)."
    )
    _forward(
        trial,
        "trial calibrate",
        "axis-trials/effects",
        "Calibrate the probability of a claim on trials (benchmarks).",
    )


def _forward(app: typer.Typer, path: str, example: str, about: str) -> None:
    def command(context: typer.Context) -> None:
        from labhil.campaign.benchmarks import benchmark_module

        module = benchmark_module("command_line", f"`labhil {path}`")
        module.run([*path.split(), *context.args])

    command.__doc__ = about
    name = path.rpartition(" ")[2]
    app.command(name, epilog=f"Example: labhil {path} {example}", context_settings=FORWARD_ARGUMENTS)(command)
