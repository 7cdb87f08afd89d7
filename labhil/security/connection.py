"""The connection of a guest to a lab on another machine: a folder that ``labhil security add`` made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from labhil.documents import DocumentError, parse_toml, read_document
from labhil.errors import UsageError
from labhil.security.private import check_private
from labhil.security.roles import Role
from labhil.validation_errors import reason_of

SETTINGS, AUTHORITY, CERTIFICATE, KEY = "connection.toml", "ca.pem", "certificate.pem", "private.key"


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    endpoint: str = Field(pattern=r"^tls/(\[[0-9a-fA-F:]+\]|[A-Za-z0-9.-]+):\d{1,5}$")
    name: str
    role: Role
    until: AwareDatetime


@dataclass(frozen=True, slots=True)
class Connection:
    """A connection to a lab on another machine.

    Attributes:
        folder: The folder with the certificates.
        endpoint: Where the lab is reached, ``tls/HOST:PORT``.
        name: Name of the person.
        role: Role of the person when the folder was made; the lab decides by its own list.
    """

    folder: Path
    endpoint: str
    name: str
    role: Role

    def tls(self) -> Mapping[str, object]:
        """Return the TLS settings of the bus for this connection, by their place in its configuration."""
        place = "transport/link/tls"
        return {
            "transport/link/protocols": ["tls"],
            f"{place}/root_ca_certificate": str(self.folder / AUTHORITY),
            f"{place}/connect_certificate": str(self.folder / CERTIFICATE),
            f"{place}/connect_private_key": str(self.folder / KEY),
            f"{place}/enable_mtls": True,
            f"{place}/verify_name_on_connect": True,
            f"{place}/close_link_on_expiration": True,
        }


def load_connection(folder: Path) -> Connection:
    """Read a folder that ``labhil security add`` made.

    Raises:
        UsageError: A file is missing or malformed, others can read the private key, or the certificate has
            expired.
    """
    path = folder / SETTINGS
    try:
        settings = _Settings.model_validate(parse_toml(read_document(path)))
    except (OSError, DocumentError, ValidationError) as error:
        raise UsageError(
            f"{folder}: expected an endpoint like tcp/127.0.0.1:40123, or the folder of a connection that"
            f" `labhil security add` made; found that {SETTINGS} there cannot be used:"
            f" {reason_of(error, path, _Settings)}"
        ) from error
    for name in (AUTHORITY, CERTIFICATE):
        if not (folder / name).is_file():
            raise UsageError(
                f"{folder / name}: expected the certificate that belongs to the connection, found none: copy"
                " the whole folder that `labhil security add` made"
            )
    check_private(folder / KEY)
    if settings.until <= datetime.now(UTC):
        raise UsageError(
            f"{folder}: the certificate of {settings.name!r} expired on {settings.until:%Y-%m-%d}; whoever"
            " keeps the lab issues a new one: labhil security add"
        )
    return Connection(folder, settings.endpoint, settings.name, settings.role)
