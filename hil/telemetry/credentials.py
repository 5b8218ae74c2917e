"""Who is who beyond this machine: a directory with certificate, key, authority and, for operators, a shared secret.

deploy/zenoh/make-certificates.sh makes such directories. The role is the certificate's organizational unit: `sidecar`,
`operator` or `monitor`. TLS 1.3, both sides show a certificate of the same authority.
"""

import ssl
from pathlib import Path
from typing import Any, NamedTuple

SIDECAR, OPERATOR = "sidecar", "operator"  # roles; whoever has another one may watch
AUTHORITY, CERTIFICATE, KEY, SECRET = "authority.pem", "certificate.pem", "key.pem", "secret"
_LEAST_SECRET = 32  # bytes, as hex digits twice as many


class CredentialsError(Exception):
    """A directory of credentials that cannot be used; the text names the file."""


class Identity(NamedTuple):
    """What a verified certificate says."""

    name: str
    role: str


class Credentials:
    """One side's. Raises CredentialsError where a file is missing, or a private one is open to others."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        for name in (AUTHORITY, CERTIFICATE, KEY):
            if not (directory / name).is_file():
                raise CredentialsError(f"{directory / name}: no such file")
        for name in (KEY, SECRET):
            path = directory / name
            if path.exists() and path.stat().st_mode & 0o077:
                raise CredentialsError(f"{path}: other users can read it: chmod 600")

    def path(self, name: str) -> str:
        """Of one of the files above."""
        return str((self.directory / name).absolute())

    @property
    def secret(self) -> bytes:
        """What commands are authenticated with, beside the certificate. Raises CredentialsError."""
        path = self.directory / SECRET
        try:
            secret = bytes.fromhex(path.read_text(encoding="ascii").strip())
        except (OSError, ValueError) as error:
            raise CredentialsError(f"{path}: {error}") from None
        if len(secret) < _LEAST_SECRET:
            raise CredentialsError(f"{path}: {len(secret)} bytes; at least {_LEAST_SECRET}")
        return secret

    def context(self, *, server: bool) -> ssl.SSLContext:
        """Mutual TLS. Names of hosts are not compared: the role in the certificate is."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        context.check_hostname = False
        context.verify_mode = ssl.CERT_REQUIRED
        try:
            context.load_cert_chain(self.path(CERTIFICATE), self.path(KEY))
            context.load_verify_locations(self.path(AUTHORITY))
        except (ssl.SSLError, OSError) as error:
            raise CredentialsError(f"{self.directory}: {error}") from None
        return context


def identity(certificate: dict[str, Any] | None) -> Identity:
    """Of a verified peer (ssl.SSLSocket.getpeercert)."""
    subject = {key: value for part in (certificate or {}).get("subject", ()) for key, value in part}
    return Identity(str(subject.get("commonName", "")), str(subject.get("organizationalUnitName", "")))
