"""Commands of control from outside: ``labhil estop``, ``labhil control``, ``labhil mark``."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from labhil.commands.json_flag import JsonFlagCommand, JsonOption
from labhil.console import STDOUT, tell, write_json
from labhil.terminal import complain, show

Connect = Annotated[
    str | None,
    typer.Option(
        metavar="ENDPOINT",
        help="A bus like tcp/127.0.0.1:40123, or a folder of `labhil security add` (default: discovered).",
    ),
]


def add_safety(app: typer.Typer) -> None:
    """Register these commands."""
    app.command(cls=JsonFlagCommand, epilog="Example: labhil estop --reason 'the ball jumped'")(estop)
    app.command(epilog="Example: labhil control pause --reason 'to look at the ball'")(control)
    app.command(epilog="Example: labhil mark 'oil added'")(mark)


def estop(
    *,
    release: Annotated[
        bool, typer.Option("--release", help="Release it: devices may be commanded again.")
    ] = False,
    reason: Annotated[str, typer.Option(help="Reason, written to every recording.")] = "no reason was given",
    connect: Connect = None,
    json_path: JsonOption = None,
) -> None:
    """Emergency stop: every device goes to its safe state at once, and stays there.

    The stop is latched: runs end, and no device can be commanded until `labhil estop --release`. The exit
    status is 1 when a device does not answer, which is then named, and when there was no device to stop.
    """
    from labhil.service.emergency import press_everywhere, release_everywhere

    by = f"labhil estop (user {os.getuid()}, pid {os.getpid()})"
    outcome = release_everywhere(connect) if release else press_everywhere(by, reason, connect)
    if json_path != STDOUT:
        for device, state in sorted(outcome.answered.items()):
            show(f"{device}: {state}")
    for device, why in sorted(outcome.failed.items()):
        complain(f"{device}: DID NOT STOP PROPERLY: {why}")
    for device in outcome.silent:
        complain(f"{device}: NO ANSWER. Do not rely on it: switch its power off.")
    if json_path is not None:
        message = {
            "schema": "labhil.estop/1",
            "action": "release" if release else "press",
            "answered": dict(outcome.answered),
            "failed": dict(outcome.failed),
            "silent": list(outcome.silent),
        }
        write_json(message, json_path)
    if release:
        no_device = not (outcome.answered or outcome.failed or outcome.silent)
        tell(["released"] + (["no device was there"] if no_device else []))
        raise typer.Exit(0 if no_device or outcome.complete else 1)
    if not (outcome.answered or outcome.failed or outcome.silent):
        tell(["no device was found to stop"])
    tell(["latched: no device can be commanded until `labhil estop --release`"])
    raise typer.Exit(0 if outcome.complete else 1)


def control(
    action: Annotated[str, typer.Argument(help="status, pause, resume, stop or abort.")],
    reason: Annotated[str | None, typer.Option(help="Reason, written to the recording.")] = None,
    connect: Connect = None,
) -> None:
    """Control a run: status, pause, resume, stop (exit status 0), abort (exit status 1).

    Prints the state of the run as JSON; status also that of a served lab.
    """
    from labhil.bus.ask import ask
    from labhil.bus.keys import RUN, command_key
    from labhil.bus.register import find_run
    from labhil.bus.session import open_bus
    from labhil.errors import UnknownNameError

    actions = ("status", "pause", "resume", "stop", "abort")
    if action not in actions:
        raise UnknownNameError("action", action, actions)
    payload = {} if reason is None else {"reason": reason}
    with open_bus(find_run(connect, or_lab=action == "status")) as bus:
        write_json(ask(bus, command_key(RUN, action), payload, timeout=5.0, patience=3.0))


def mark(
    text: Annotated[str, typer.Argument(help="What happened, in a few words.")],
    connect: Connect = None,
) -> None:
    """Put a marker into the recording of the present run, at this moment.

    It is recorded as an event of the kind `mark`; `labhil info` lists it.
    """
    from labhil.bus.ask import ask
    from labhil.bus.keys import RUN, command_key
    from labhil.bus.register import find_run
    from labhil.bus.session import open_bus

    with open_bus(find_run(connect)) as bus:
        answer = ask(bus, command_key(RUN, "mark"), {"text": text}, timeout=5.0, patience=3.0)
    show(f"marked at {answer['elapsed']:.2f} s of {answer['name']}")
