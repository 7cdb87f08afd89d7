"""The commands of ``labhil``: one thin function per command, in ``commands/``; ``cli.py`` starts them.

Each command imports what it needs when it runs, so that a rack PC that records loads no compiler and a
laptop that fits loads no bus. Results go to stdout, everything else to stderr.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from typing import Annotated

import typer
from typer.main import get_command

from labhil.commands.acquisition import add_acquisition
from labhil.commands.analysis import add_analysis
from labhil.commands.benchmarks import add_benchmarks
from labhil.commands.compare import add_compare
from labhil.commands.files import add_files
from labhil.commands.firmware import add_firmware
from labhil.commands.help_pages import link_pages
from labhil.commands.machine import add_machine
from labhil.commands.new import add_new
from labhil.commands.patch import add_patch
from labhil.commands.replay import add_replay
from labhil.commands.safety import add_safety
from labhil.commands.security import add_security
from labhil.commands.serve import add_serve
from labhil.commands.studies import add_studies
from labhil.commands.trials import add_trials
from labhil.commands.tui import add_tui
from labhil.console import forgiving_streams
from labhil.errors import LabhilError, OptionError
from labhil.extras import missing_extra
from labhil.interrupted import INTERRUPTED
from labhil.terminal import complain, show

app = typer.Typer(
    help="Record a rig and its simulation, find where they disagree, and say what physics was left out.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def run_command_line() -> None:
    """Run the command line; ends the process with 0 (done), 1 (failed), 2 (wrong use) or 130 (Ctrl+C)."""
    with forgiving_streams():
        try:
            _command()()
        except LabhilError as error:
            complain(error.on_command_line if isinstance(error, OptionError) else error)
            sys.exit(error.exit_status)
        except ModuleNotFoundError as error:
            missing = missing_extra(error, "this command")
            if missing is None:
                raise
            complain(missing)
            sys.exit(missing.exit_status)
        except (KeyboardInterrupt, SystemExit) as end:
            # typer makes a silent exit of a KeyboardInterrupt
            if isinstance(end, SystemExit) and end.code != INTERRUPTED:
                raise
            complain(
                "interrupted (Ctrl+C) before there was a result; run the command again to get one. A fit or "
                "a diagnosis gives the best so far once it says what it searches"
            )
            sys.exit(INTERRUPTED)


@cache
def _command() -> Callable[[], object]:
    """Build the tree of all commands, once for a process that runs several of them."""
    return get_command(app)


def _print_version(wanted: bool) -> None:
    if wanted:
        from labhil.version import __version__

        show(f"labhil {__version__}")
        raise typer.Exit


@app.callback()
def _labhil(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Say which version it is."),
    ] = False,
) -> None:
    """Bench-to-model loop: acquire, fit, diagnose."""


for add in (
    add_new,
    add_acquisition,
    add_safety,
    add_serve,
    add_security,
    add_firmware,
    add_files,
    add_analysis,
    add_compare,
    add_patch,
    add_trials,
    add_studies,
    add_benchmarks,
    add_tui,
    add_replay,
    add_machine,
):
    add(app)
link_pages(app)
