"""The folder of certificates and the folder that a person is given: what is in them, and what is refused."""

from __future__ import annotations

import json
import os
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from typer.testing import CliRunner

from labhil.bus.rights import access_control
from labhil.bus.session import open_bus, open_to_guests
from labhil.command_line import app
from labhil.errors import BusError, LabhilError, UsageError
from labhil.security.authority import Authority
from labhil.security.connection import load_connection
from labhil.security.roles import RIGHTS, Role


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority.create(tmp_path / "keys", ["lab-pc.local", "192.168.1.20", "fe80::1"], 7447)


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def certificate_in(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def purpose_of(certificate: x509.Certificate) -> list[x509.ObjectIdentifier]:
    return list(certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)


def replace_text(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_private_keys_are_for_their_owner_alone_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        authority = Authority.create(tmp_path / "keys", ["127.0.0.1"], 7447)
        given = authority.add("anna", Role.VIEWER, 30)
        authority.revoke("anna")
    finally:
        os.umask(before)
    keys = authority.folder
    assert [mode_of(folder) for folder in (keys, keys / "people", given)] == [0o700] * 3
    private = [keys / "ca.key", keys / "server.key", keys / "lab.json", given / "private.key"]
    assert [mode_of(path) for path in private] == [0o600] * 4


def test_certificates_say_what_they_are_for_and_the_authority_signs_them(authority: Authority) -> None:
    given = authority.add("anna", Role.OPERATOR, 30)
    ca, server = (certificate_in(authority.folder / name) for name in ("ca.pem", "server.pem"))
    anna = certificate_in(given / "certificate.pem")
    for certificate in (server, anna):
        certificate.verify_directly_issued_by(ca)
        assert not certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
        assert isinstance(certificate.public_key(), ec.EllipticCurvePublicKey)
    assert purpose_of(server) == [ExtendedKeyUsageOID.SERVER_AUTH]
    assert purpose_of(anna) == [ExtendedKeyUsageOID.CLIENT_AUTH]
    assert [name.value for name in anna.subject.get_attributes_for_oid(NameOID.COMMON_NAME)] == ["anna"]
    hosts = server.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert hosts.get_values_for_type(x509.DNSName) == ["lab-pc.local"]
    addresses = [str(address) for address in hosts.get_values_for_type(x509.IPAddress)]
    assert addresses == ["192.168.1.20", "fe80::1"]
    assert timedelta(days=29) < anna.not_valid_after_utc - datetime.now(UTC) < timedelta(days=31)


def test_a_given_folder_is_a_connection(authority: Authority) -> None:
    connection = load_connection(authority.add("anna", Role.OPERATOR, 30))
    assert (connection.endpoint, connection.name) == ("tls/lab-pc.local:7447", "anna")
    assert connection.role is Role.OPERATOR
    assert connection.tls()["transport/link/tls/verify_name_on_connect"] is True


def test_a_name_is_given_once_and_not_again_after_it_was_revoked(authority: Authority) -> None:
    authority.add("anna", Role.VIEWER, 30)
    with pytest.raises(UsageError, match=r"'anna' has a certificate as viewer until .* such as anna-2"):
        authority.add("anna", Role.ADMIN, 30)
    authority.revoke("anna")
    with pytest.raises(UsageError, match="'anna' was revoked"):
        authority.add("anna", Role.VIEWER, 30)
    anna = Authority.load(authority.folder).people["anna"]
    assert (anna.role, anna.state) == (Role.VIEWER, "revoked")
    assert Authority.load(authority.folder).valid_people() == {}


def test_revoking_does_not_undo_what_another_process_has_added(authority: Authority) -> None:
    elsewhere = Authority.load(authority.folder)
    authority.add("anna", Role.VIEWER, 30)
    elsewhere.add("boris", Role.VIEWER, 30)
    authority.revoke("boris")
    people = Authority.load(authority.folder).people
    assert {name: person.state for name, person in people.items()} == {"anna": "valid", "boris": "revoked"}


def test_access_control_names_only_what_a_role_may_and_only_under_its_own_name() -> None:
    people = {"vera": Role.VIEWER, "otto": Role.OPERATOR, "ada": Role.ADMIN}
    section = access_control(people)
    assert (section["enabled"], section["default_permission"]) == (True, "deny")
    rules = {rule["id"]: rule for rule in section["rules"]}
    assert all(rule["permission"] == "allow" for rule in rules.values())
    for policy in section["policies"]:
        (person,) = policy["subjects"]
        keys = [key for name in policy["rules"] for key in rules[name]["key_exprs"] if "/by/" in key]
        assert {key.split("/")[3] for key in keys} == {person}
        sent = [rules[name] for name in policy["rules"] if rules[name]["flows"] == ["ingress"]]
        allowed = {key.split("/", 4)[4] for rule in sent for key in rule["key_exprs"] if "/by/" in key}
        commands = {name if name == "setpoint" else f"cmd/{name}" for name in RIGHTS[people[person]]}
        assert allowed == commands
        messages = {message for rule in sent for message in rule["messages"]}
        # nobody answers for a device, or is there in its place
        assert not messages & {"reply", "declare_queryable", "liveliness_token", "delete"}


def test_without_certificates_a_bus_is_on_the_loopback_only() -> None:
    with open_bus() as bus:
        assert bus.guest is None
        assert bus.endpoint.startswith("tcp/127.0.0.1:")


def test_a_door_at_an_address_of_another_machine_cannot_be_opened(authority: Authority) -> None:
    with pytest.raises(BusError, match=r"listen at tls/192.0.2.1:7447.*an address of this machine"):
        open_to_guests(authority, "192.0.2.1")


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (lambda folder: (folder / "connection.toml").unlink(), "expected an endpoint like tcp/.* or the"),
        (lambda folder: (folder / "connection.toml").write_text("endpoint = 3"), "cannot be used"),
        (lambda folder: (folder / "connection.toml").write_text("["), "cannot be used"),
        (
            lambda folder: replace_text(folder / "connection.toml", "tls/lab-pc.local", "tcp/lab-pc.local"),
            "cannot be used",
        ),
        (lambda folder: (folder / "ca.pem").unlink(), "ca.pem: expected the certificate"),
        (lambda folder: (folder / "certificate.pem").unlink(), "certificate.pem: expected the certificate"),
        (lambda folder: (folder / "private.key").unlink(), "private.key: expected a private key that can"),
        (lambda folder: (folder / "private.key").chmod(0o644), "only its owner can read .*chmod 600"),
        (
            lambda folder: replace_text(folder / "connection.toml", 'until = "20', 'until = "19'),
            "the certificate of 'anna' expired on 19",
        ),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_connection_is_said(authority: Authority, spoil, complaint: str) -> None:
    folder = authority.add("anna", Role.VIEWER, 30)
    spoil(folder)
    with pytest.raises(UsageError, match=complaint) as refused:
        open_bus(str(folder))
    assert refused.value.exit_status == 2


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["init", "keys", "--host", "lab"], "keys: expected a name that is free"),
        (["init", "new", "--host", "a b"], "expected a name like lab-pc.local or an IP address, found 'a b'"),
        (["init", "new", "--host", "300.1.1.1"], "found '300.1.1.1'"),
        (["init", "new", "--host", "-x"], "found '-x'"),
        (["init", "new", "--host", "lab", "--host", "lab/../x"], "found 'lab/../x'"),
        (
            ["add", "nowhere", "anna", "--role", "viewer"],
            "expected a folder that `labhil security init` made",
        ),
        (["add", "keys", "../anna", "--role", "viewer"], "expected small letters"),
        (["add", "keys", "*", "--role", "viewer"], "expected small letters"),
        (["add", "keys", "anna", "--role", "viewer", "--days", "0"], "--days: expected 1 to 3650, found 0"),
        (["add", "keys", "anna", "--role", "king"], "any emergency stop), found 'king'"),
        (["revoke", "keys", "nobody"], "expected somebody who has a certificate"),
        (["list", "nowhere"], "expected a folder that `labhil security init` made"),
        (["serve", "nowhere"], "expected a folder that `labhil security init` made"),
    ],
)
def test_wrong_use_is_refused_with_what_was_expected(
    authority: Authority, arguments: list[str], complaint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(authority.folder.parent)
    result = CliRunner().invoke(app, ["security", *arguments])
    error = result.exception
    assert isinstance(error, LabhilError)
    said = getattr(error, "on_command_line", str(error))
    assert (error.exit_status, complaint in said) == (2, True), said
    assert not (authority.folder.parent / "new").exists()


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (
            lambda folder: (folder / "ca.key").chmod(0o640),
            "ca.key: expected a private key that only",
        ),
        (
            lambda folder: (folder / "server.key").unlink(),
            "server.key: expected a private key that can be read",
        ),
        (lambda folder: (folder / "server.pem").unlink(), "server.pem: expected a certificate"),
        (lambda folder: (folder / "lab.json").write_text("{"), "lab.json there cannot be used"),
        (
            lambda folder: (folder / "lab.json").write_text(
                json.dumps({**json.loads((folder / "lab.json").read_text()), "until": "2020-01-01T00:00:00Z"})
            ),
            "the certificate of the machine expired on 2020-01-01",
        ),
    ],
)
def test_a_spoilt_folder_opens_no_door(authority: Authority, spoil, complaint: str) -> None:
    spoil(authority.folder)
    result = CliRunner().invoke(app, ["security", "serve", str(authority.folder), "--listen", "127.0.0.1"])
    assert isinstance(result.exception, UsageError)
    assert complaint in str(result.exception)
