"""The certificate of a page that is served beyond this computer: one given by file, or one that it makes itself."""

from __future__ import annotations

import datetime
import ipaddress
import socket
import ssl
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from valor.common import whole_file
from valor.common.errors import ConfigurationError

_EXPECTED = "expected a PEM file of a certificate and its key"
_VALID = datetime.timedelta(days=365)
_LEFT = datetime.timedelta(days=7)  # a self-made one with less is made anew
_SKEW = datetime.timedelta(hours=1)  # of others' clocks


def context(file: Path) -> ssl.SSLContext:
    """Of a server with this certificate: TLS 1.2 and newer.

    Raises:
        ConfigurationError: the file does not hold a certificate and its key.
    """
    made = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    made.set_alpn_protocols(["http/1.1"])
    try:
        made.load_cert_chain(file)
    except (OSError, ssl.SSLError) as error:
        why = error.strerror if not isinstance(error, ssl.SSLError) else error.reason or str(error)
        raise ConfigurationError(f"{file}: {why}; {_EXPECTED}") from None
    return made


def fingerprint(file: Path) -> str:
    """SHA-256 of the first certificate in a file, as browsers show it: ``AB:CD:…``.

    Raises:
        ConfigurationError: there is none.
    """
    return _read(file).fingerprint(hashes.SHA256()).hex(":").upper()


def self_made(file: Path, host: str) -> None:
    """See that a file holds a certificate of our own for a host, still valid; else make one.

    Raises:
        ConfigurationError: it cannot be written.
    """
    names = {host, socket.gethostname(), "localhost", "127.0.0.1"}
    try:
        if file.exists() and _serves(_read(file), names):
            return
    except ConfigurationError:
        pass  # what cannot be read is made anew
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"valor on {socket.gethostname()}"[:64])])
    now = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _SKEW)
        .not_valid_after(now + _VALID)
        .add_extension(x509.SubjectAlternativeName([_general(each) for each in sorted(names)]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    secret = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    try:
        file.touch(0o600)
        with whole_file.replacing(file) as beside:
            beside.touch(0o600)
            beside.write_bytes(secret + made.public_bytes(serialization.Encoding.PEM))
    except OSError as error:
        raise ConfigurationError(f"{error.filename or file}: {error.strerror}") from None


def _read(file: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(file.read_bytes())
    except OSError as error:
        raise ConfigurationError(
            f"{file}: {error.strerror}; expected a PEM file of a certificate and its key"
        ) from None
    except ValueError:
        raise ConfigurationError(f"{file}: no certificate; {_EXPECTED}") from None


def _serves(certificate: x509.Certificate, names: set[str]) -> bool:
    if certificate.not_valid_after_utc - datetime.datetime.now(datetime.UTC) < _LEFT:
        return False
    try:
        known = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return False
    return {_general(name) for name in names} <= set(known)


def _general(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name.encode("idna").decode())
