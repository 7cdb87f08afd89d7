"""The page of the documentation that the help of each command names."""

from __future__ import annotations

from collections.abc import Mapping

import typer

GUIDES: Mapping[str, str] = {
    "labhil new": "docs/how-to/new-bench.md",
    "labhil twin": "docs/tutorials/first-recording.md",
    "labhil devices": "docs/how-to/index.md",
    "labhil run": "docs/how-to/write-an-experiment.md",
    "labhil estop": "docs/explanation/safety.md",
    "labhil control": "docs/explanation/safety.md",
    **dict.fromkeys(
        (f"labhil security {name}" for name in ("init", "add", "list", "revoke", "serve")),
        "docs/how-to/open-the-lab-to-others.md",
    ),
    "labhil serve": "docs/how-to/automate.md",
    "labhil firmware": "docs/how-to/flash-firmware.md",
    "labhil import": "docs/how-to/import-and-export.md",
    "labhil export": "docs/how-to/import-and-export.md",
    "labhil layout": "docs/how-to/other-viewers.md",
    "labhil recover": "docs/how-to/recover-a-recording.md",
    "labhil terms": "docs/reference/terms.md",
    "labhil fit": "docs/tutorials/refit.md",
    "labhil diagnose": "docs/how-to/read-a-diagnosis.md",
    "labhil verify": "docs/how-to/gate-in-ci.md",
    "labhil compare": "docs/how-to/compare-models.md",
    "labhil report": "docs/how-to/automate.md",
    "labhil linear": "docs/explanation/rigs.md",
    "labhil demo": "docs/tutorials/demo.md",
    "labhil tui": "docs/how-to/terminal-ui.md",
    "labhil replay": "docs/how-to/replay.md",
    "labhil doctor": "docs/how-to/what-to-do-when.md",
}
"""Page by command; for other commands it is the reference of the command line."""


def link_pages(app: typer.Typer, path: str = "labhil") -> None:
    """Add a page of the documentation to the help of every command, also in groups.

    Args:
        app: The application, or a group of it, with all commands registered.
        path: The command line up to it.
    """
    for command in app.registered_commands:
        typed = f"{path} {command.name or getattr(command.callback, '__name__', '')}"
        reference = f"docs/reference/cli.md#{typed.replace(' ', '-')}"
        command.epilog = "\n\n".join(
            part for part in (command.epilog, f"Page: {GUIDES.get(typed, reference)}") if part
        )
    for group in app.registered_groups:
        if group.typer_instance is not None:
            link_pages(group.typer_instance, f"{path} {group.name}")
