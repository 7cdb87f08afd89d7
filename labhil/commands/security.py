"""Commands of access from other machines: ``labhil security``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from labhil.console import tell
from labhil.security.roles import Role, parse_role
from labhil.terminal import show

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The folder that `labhil security init` made.")]
DEFAULT_PORT = 7447


def add_security(app: typer.Typer) -> None:
    """Register the group ``security``."""
    security = typer.Typer(
        help="Open a lab to other machines: certificates, and what each person may do.",
        no_args_is_help=True,
        rich_markup_mode=None,
    )
    security.command(epilog="Example: labhil security init ~/lab-keys --host lab-pc.local")(init)
    security.command(epilog="Example: labhil security add ~/lab-keys anna --role viewer")(add)
    security.command("list", epilog="Example: labhil security list ~/lab-keys")(list_)
    security.command(epilog="Example: labhil security revoke ~/lab-keys anna")(revoke)
    security.command(epilog="Example: labhil security serve ~/lab-keys")(serve)
    app.add_typer(security, name="security")


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder that does not exist yet.")],
    *,
    host: Annotated[
        list[str],
        typer.Option(
            metavar="NAME_OR_IP", help="Name of this machine for others; may be repeated, the first is used."
        ),
    ],
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Port at which the lab will be served.")
    ] = DEFAULT_PORT,
) -> None:
    """Make a certificate authority, and the certificate of this machine; no port is opened yet."""
    from labhil.security.authority import Authority

    authority = Authority.create(folder, host, port)
    show(f"{folder}: certificates until {authority.until:%Y-%m-%d} for {', '.join(host)}")
    tell(
        [
            f"Keep {folder} secret: whoever reads it can act as anybody in this lab.",
            f"Next: labhil security add {folder} NAME --role viewer, then labhil security serve {folder}",
        ]
    )


def add(
    folder: Folder,
    name: Annotated[str, typer.Argument(help="Who: small letters, digits and hyphens.")],
    *,
    role: Annotated[
        str,
        typer.Option(
            metavar="ROLE",
            help="What the person may do: viewer, operator or admin.",
            autocompletion=lambda: [role.value for role in Role],
        ),
    ],
    days: Annotated[int, typer.Option(help="How long the certificate is valid.")] = 365,
) -> None:
    """Issue a certificate, and print the folder that the person needs."""
    from labhil.security.authority import Authority

    rights = parse_role(role)
    authority = Authority.load(folder)
    person_folder = authority.add(name, rights, days)
    until = Authority.load(folder).people[name].until
    show(person_folder)
    tell(
        [
            f"{name} is {rights} until {until:%Y-%m-%d}. Hand the folder over so that nobody else reads it.",
            f"There `labhil tui --connect {name}` shows the lab at {authority.endpoint}.",
        ]
    )


def list_(folder: Folder) -> None:
    """Show who has a certificate, with which role, until when."""
    from labhil.security.authority import Authority

    authority = Authority.load(folder)
    for name, person in sorted(authority.people.items()):
        show(f"{name:20} {person.role:9} {person.until:%Y-%m-%d}  {person.state}")
    tell([f"served at {authority.endpoint}, whose certificate is valid until {authority.until:%Y-%m-%d}"])


def revoke(folder: Folder, name: Annotated[str, typer.Argument(help="Who.")]) -> None:
    """Revoke a certificate at once; a served lab closes its connections within a second."""
    from labhil.security.authority import Authority

    person = Authority.load(folder).revoke(name)
    show(f"{name}: revoked; the certificate, valid until {person.until:%Y-%m-%d}, has no rights any more")


def serve(
    folder: Folder,
    *,
    listen: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Address of this machine; default: all of them.")
    ] = "0.0.0.0",
) -> None:
    """Open this machine's runs and labs to those who have a certificate, until Ctrl+C.

    They see the present and future buses of `labhil run`, `labhil serve` and `labhil.connect` of this user,
    which stay on the loopback. Whoever has no certificate gets no connection.
    """
    from labhil.experiment.interruption import Interruption
    from labhil.service.gateway import serve_guests

    with Interruption() as interrupted:
        serve_guests(folder, listen, interrupted, lambda line: tell([line]))
