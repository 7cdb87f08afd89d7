"""The folder of a lab's certificate authority: people with their certificates, roles and expiry dates.

Roles are stored here, on the machine that serves the lab, and not in the certificates, which only identify a
person. Reading this folder is enough to issue certificates, so only its owner may read it.
"""

from __future__ import annotations

import fcntl
import ipaddress
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from labhil.atomic_file import atomic_file
from labhil.documents import DocumentError, parse_json, read_document
from labhil.errors import OptionError, UsageError
from labhil.extras import require
from labhil.security import connection
from labhil.security.private import FOLDER, PUBLIC, check_private, make_folder, write_new
from labhil.security.roles import Role
from labhil.toml_text import to_toml
from labhil.validation_errors import reason_of

LAB, CA, CA_KEY, SERVER, SERVER_KEY = "lab.json", "ca.pem", "ca.key", "server.pem", "server.key"
PEOPLE = "people"
AUTHORITY_DAYS = 3650
PURPOSE = "making certificates"
"""What the optional package is needed for, in messages."""
_LABEL = "[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?"
HOST = re.compile(rf"(?=.{{1,253}}$){_LABEL}(\.{_LABEL})*")
PERSON = re.compile(r"[a-z][a-z0-9-]{0,39}")


class Person(BaseModel):
    """A person with a certificate that is valid until ``until``, unless it was ``revoked``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    role: Role
    until: AwareDatetime
    revoked: bool = False

    @property
    def state(self) -> str:
        """The state of the certificate: "valid", "expired" or "revoked"."""
        if self.revoked:
            return "revoked"
        return "valid" if self.until > datetime.now(UTC) else "expired"


class _Lab(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    hosts: tuple[str, ...] = Field(min_length=1)
    port: int = Field(ge=1, le=65535)
    until: AwareDatetime
    people: Mapping[str, Person] = {}


@dataclass(frozen=True, slots=True)
class Authority:
    """The present contents of a folder that ``labhil security init`` made."""

    folder: Path
    _lab: _Lab

    @classmethod
    def create(cls, folder: Path, hosts: Sequence[str], port: int) -> Self:
        """Make the authority and the certificate of the machine that serves the lab.

        Args:
            folder: A folder that does not exist yet.
            hosts: Names or addresses at which others reach the machine; the first is the usual one.
            port: Port at which the lab is served.

        Raises:
            UsageError: The folder exists already, or a host is neither a name nor an address.
        """
        if not hosts:
            raise OptionError("host", ": expected the name or address of this machine, found none")
        for host in hosts:
            if not _is_host(host):
                raise OptionError(
                    "host", f": expected a name like lab-pc.local or an IP address, found {host!r}"
                )
        require("cryptography", PURPOSE)
        from labhil.security import certificates

        make_folder(folder)
        authority = certificates.make_authority(f"labhil authority of {hosts[0]}"[:64], AUTHORITY_DAYS)
        server = certificates.issue_server(authority, hosts, AUTHORITY_DAYS)
        write_new(folder / CA, authority.certificate, PUBLIC)
        write_new(folder / CA_KEY, authority.key)
        write_new(folder / SERVER, server.certificate, PUBLIC)
        write_new(folder / SERVER_KEY, server.key)
        made = cls(folder, _Lab(hosts=tuple(hosts), port=port, until=server.until))
        write_new(folder / LAB, made._lab.model_dump_json(indent=1).encode())
        return made

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read the folder; UsageError where a file is missing, malformed, or readable by others."""
        path = folder / LAB
        try:
            lab = _Lab.model_validate(parse_json(read_document(path)))
        except (OSError, DocumentError, ValidationError) as error:
            raise UsageError(
                f"{folder}: expected a folder that `labhil security init` made; {LAB} there cannot be used:"
                f" {reason_of(error, path, _Lab)}"
            ) from error
        for name in (CA, SERVER):
            if not (folder / name).is_file():
                raise UsageError(
                    f"{folder / name}: expected a certificate, found none: restore it from a copy"
                )
        for name in (CA_KEY, SERVER_KEY):
            check_private(folder / name)
        return cls(folder, lab)

    @property
    def people(self) -> Mapping[str, Person]:
        """Everybody who has or had a certificate, by name."""
        return self._lab.people

    @property
    def port(self) -> int:
        """Port at which the lab is served."""
        return self._lab.port

    @property
    def endpoint(self) -> str:
        """Where others reach the lab: ``tls/HOST:PORT``."""
        return f"tls/{bracketed(self._lab.hosts[0])}:{self._lab.port}"

    @property
    def until(self) -> datetime:
        """When the certificate of the serving machine expires."""
        return self._lab.until

    def valid_people(self) -> dict[str, Role]:
        """Return the role of everybody whose certificate is valid now."""
        return {name: person.role for name, person in self.people.items() if person.state == "valid"}

    def check_server(self) -> None:
        """Raise UsageError where the certificate of the serving machine has expired."""
        if self.until <= datetime.now(UTC):
            raise UsageError(
                f"{self.folder}: the certificate of the machine expired on {self.until:%Y-%m-%d}: make a new"
                " folder with `labhil security init` and issue new certificates"
            )

    def tls(self) -> Mapping[str, object]:
        """Return the TLS settings of the bus for guests, by their place in its configuration."""
        place = "transport/link/tls"
        return {
            "transport/link/protocols": ["tls"],
            f"{place}/root_ca_certificate": str(self.folder / CA),
            f"{place}/listen_certificate": str(self.folder / SERVER),
            f"{place}/listen_private_key": str(self.folder / SERVER_KEY),
            f"{place}/enable_mtls": True,
            f"{place}/close_link_on_expiration": True,
        }

    def add(self, name: str, role: Role, days: int) -> Path:
        """Issue a certificate, and return the folder that the person gets.

        Args:
            name: Name of the person.
            role: Role of the person.
            days: How long the certificate is valid.

        Raises:
            UsageError: The name is malformed or in use, was revoked and is still valid, or its folder exists.
        """
        if not PERSON.fullmatch(name):
            raise UsageError(
                f"expected small letters, digits and hyphens, such as anna or anna-2, found {name!r}"
            )
        if not 1 <= days <= AUTHORITY_DAYS:
            raise OptionError("days", f": expected 1 to {AUTHORITY_DAYS}, found {days}")
        require("cryptography", PURPOSE)
        from labhil.security import certificates

        with self._locked() as now:
            now._refuse_known(name)
            signer = certificates.Certificate(
                (self.folder / CA).read_bytes(), (self.folder / CA_KEY).read_bytes(), self.until
            )
            issued = certificates.issue_client(signer, name, days)
            folder = self.folder / PEOPLE / name
            settings = {
                "endpoint": self.endpoint,
                "name": name,
                "role": str(role),
                "until": f"{issued.until:%FT%TZ}",
            }
            folder.parent.mkdir(mode=FOLDER, exist_ok=True)
            make_folder(folder)
            write_new(folder / connection.AUTHORITY, signer.certificate, PUBLIC)
            write_new(folder / connection.CERTIFICATE, issued.certificate, PUBLIC)
            write_new(folder / connection.KEY, issued.key)
            write_new(folder / connection.SETTINGS, to_toml(settings).encode(), PUBLIC)
            now._write(name, Person(role=role, until=issued.until))
        return folder

    def revoke(self, name: str) -> Person:
        """Revoke all rights of a person; UsageError where there is no such person."""
        with self._locked() as now:
            if name not in now.people:
                known = ", ".join(sorted(now.people)) or "nobody"
                raise UsageError(f"expected somebody who has a certificate ({known}), found {name!r}")
            person = now.people[name].model_copy(update={"revoked": True})
            now._write(name, person)
        return person

    def _refuse_known(self, name: str) -> None:
        person = self.people.get(name)
        if person is None or person.until <= datetime.now(UTC):
            return
        if person.revoked:
            raise UsageError(
                f"{name!r} was revoked, and that certificate does not expire before {person.until:%Y-%m-%d}:"
                f" it would be good again. Choose another name, such as {name}-2"
            )
        raise UsageError(
            f"{name!r} has a certificate as {person.role} until {person.until:%Y-%m-%d}: choose another name,"
            f" such as {name}-2, or `labhil security revoke {name}` first"
        )

    @contextmanager
    def _locked(self) -> Iterator[Self]:
        """Yield the present contents while no other process can change them: no revocation gets lost."""
        descriptor = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield type(self).load(self.folder)
        finally:
            os.close(descriptor)

    def _write(self, name: str, person: Person) -> None:
        people = {**self.people, name: person}
        lab = self._lab.model_copy(update={"people": people})
        with atomic_file(self.folder / LAB) as draft:
            draft.unlink(missing_ok=True)
            write_new(draft, json.dumps(lab.model_dump(mode="json"), indent=1).encode())


def bracketed(host: str) -> str:
    """Return a host as it is written in an endpoint: an IPv6 address in brackets."""
    return f"[{host}]" if ":" in host else host


def _is_host(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        # a malformed address is no name either
        return HOST.fullmatch(host) is not None and not re.fullmatch(r"[0-9.]+", host)
    return True
