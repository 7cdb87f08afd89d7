"""The entry point of the command ``labhil``, which ends with a message wherever Ctrl+C strikes it.

All commands are in ``command_line.py``. To import them takes a while, in which Python would answer Ctrl+C
with a traceback, so this module imports nothing before it can handle that.
"""

from __future__ import annotations


def main() -> None:
    """Run the command line; ends the process with 0 (done), 1 (failed), 2 (wrong use) or 130 (Ctrl+C)."""
    try:
        _import_commands()
        from labhil.command_line import run_command_line

        run_command_line()
    except KeyboardInterrupt:
        from labhil.interrupted import INTERRUPTED, say_interrupted

        say_interrupted()
        raise SystemExit(INTERRUPTED) from None


def _import_commands() -> None:
    """Import all commands; Ctrl+C ends the process meanwhile, unless somebody else has it."""
    import signal
    import sys
    import threading

    from labhil.interrupted import leave_at_once

    if "labhil.command_line" in sys.modules or threading.current_thread() is not threading.main_thread():
        return
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler:
        return
    signal.signal(signal.SIGINT, leave_at_once)
    import labhil.command_line  # noqa: F401

    signal.signal(signal.SIGINT, before)
