"""Issuing certificates (X.509, ECDSA on P-256) for the authority, the serving machine and people."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

MAX_CLOCK_DIFFERENCE = timedelta(minutes=5)
"""How much the clocks of two machines may differ: certificates are valid from this long ago."""


@dataclass(frozen=True, slots=True)
class Certificate:
    """A certificate and its private key, both as PEM, and when it expires."""

    certificate: bytes
    key: bytes
    until: datetime


def make_authority(name: str, days: int) -> Certificate:
    """Make a certificate authority that cannot issue further authorities.

    Args:
        name: Its common name.
        days: How long it is valid.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _name(name)
    builder = _builder(subject, subject, key, days).add_extension(
        x509.BasicConstraints(True, 0), critical=True
    )
    builder = builder.add_extension(_usage(signs_certificates=True), critical=True)
    return _sign(builder, key, key)


def issue_server(authority: Certificate, hosts: Sequence[str], days: int) -> Certificate:
    """Issue the certificate of the serving machine.

    Args:
        authority: The issuer.
        hosts: Names or IP addresses of the machine.
        days: How long it is valid.
    """
    names = x509.SubjectAlternativeName([_host(host) for host in hosts])
    return _issue(authority, hosts[0], ExtendedKeyUsageOID.SERVER_AUTH, days, names)


def issue_client(authority: Certificate, person: str, days: int) -> Certificate:
    """Issue the certificate of a person, which is valid for connecting but not for serving.

    Args:
        authority: The issuer.
        person: Name of the person.
        days: How long it is valid.
    """
    return _issue(authority, person, ExtendedKeyUsageOID.CLIENT_AUTH, days)


def _issue(
    authority: Certificate,
    name: str,
    purpose: x509.ObjectIdentifier,
    days: int,
    hosts: x509.SubjectAlternativeName | None = None,
) -> Certificate:
    issuer = x509.load_pem_x509_certificate(authority.certificate)
    signer = serialization.load_pem_private_key(authority.key, password=None)
    assert isinstance(signer, ec.EllipticCurvePrivateKey)
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _builder(_name(name), issuer.subject, key, days, issuer.not_valid_after_utc)
    builder = builder.add_extension(x509.BasicConstraints(False, None), critical=True)
    builder = builder.add_extension(_usage(signs_certificates=False), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage([purpose]), critical=True)
    if hosts is not None:
        builder = builder.add_extension(hosts, critical=False)
    return _sign(builder, key, signer)


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    days: int,
    latest: datetime | None = None,
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    until = now + timedelta(days=days)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - MAX_CLOCK_DIFFERENCE)
        .not_valid_after(until if latest is None else min(until, latest))
    )


def _sign(
    builder: x509.CertificateBuilder, key: ec.EllipticCurvePrivateKey, signer: ec.EllipticCurvePrivateKey
) -> Certificate:
    certificate = builder.sign(signer, hashes.SHA256())
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    public = certificate.public_bytes(serialization.Encoding.PEM)
    return Certificate(public, private, certificate.not_valid_after_utc)


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )
