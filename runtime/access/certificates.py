"""X.509 certificates: the only import of `cryptography`, and only when keys are made.

The standard library makes none, and the openssl program is not on every robot and differs from version to
version.
"""

import datetime
import ipaddress
from collections.abc import Sequence
from typing import Any

from runtime.errors import HallwayError

_VALID_DAYS = 3650


class Certificates:
    """Makes and reads keys and certificates; raises HallwayError where the package is missing."""

    def __init__(self) -> None:
        try:
            from cryptography import x509
            from cryptography.hazmat.primitives import hashes, serialization
            from cryptography.hazmat.primitives.asymmetric import ec
        except ModuleNotFoundError as error:
            raise HallwayError(f"keys need the package {error.name!r}: pip install cryptography") from error

        self._x509, self._ec, self._hashes, self._serialization = x509, ec, hashes, serialization

    def new_key(self) -> Any:
        """Return a private key on the curve P-256."""
        return self._ec.generate_private_key(self._ec.SECP256R1())

    def certificate(
        self,
        name: str,
        key: Any,
        ca: Any | None,
        ca_key: Any | None,
        *,
        names: Sequence[str] = (),
        authority: bool = False,
    ) -> Any:
        """Return a certificate signed by `ca_key`, or by itself.

        Args:
            name: Common name.
            key: Whose public half is certified.
            ca: Certificate of the authority.
            ca_key: Its private key.
            names: Hosts that it may serve as; a guest has none.
            authority: Whether it may sign others.
        """
        x509 = self._x509
        usage = x509.oid.ExtendedKeyUsageOID
        subject = x509.Name([x509.NameAttribute(x509.oid.NameOID.COMMON_NAME, name)])
        now = datetime.datetime.now(datetime.UTC)
        builder = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(subject if ca is None else ca.subject)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            # A robot without a battery for its clock starts in the past.
            .not_valid_before(now - datetime.timedelta(days=3650))
            .not_valid_after(now + datetime.timedelta(days=_VALID_DAYS))
            .add_extension(
                x509.BasicConstraints(ca=authority, path_length=0 if authority else None), critical=True
            )
        )
        if names:
            builder = builder.add_extension(
                x509.SubjectAlternativeName([self._general_name(one) for one in names]), critical=False
            )
        if not authority:
            # A guest's certificate must not serve as a hub's.
            use = usage.SERVER_AUTH if names else usage.CLIENT_AUTH
            builder = builder.add_extension(x509.ExtendedKeyUsage([use]), critical=False)
        return builder.sign(key if ca_key is None else ca_key, self._hashes.SHA256())

    def _general_name(self, name: str) -> Any:
        try:
            return self._x509.IPAddress(ipaddress.ip_address(name))
        except ValueError:
            return self._x509.DNSName(name)

    def key_pem(self, key: Any) -> bytes:
        """Return a private key as PEM, without a password."""
        s = self._serialization
        return bytes(key.private_bytes(s.Encoding.PEM, s.PrivateFormat.PKCS8, s.NoEncryption()))

    def certificate_pem(self, certificate: Any) -> bytes:
        """Return a certificate as PEM."""
        return bytes(certificate.public_bytes(self._serialization.Encoding.PEM))

    def load(self, certificate: bytes, key: bytes) -> tuple[Any, Any]:
        """Read a certificate and its private key from PEM."""
        loaded = self._serialization.load_pem_private_key(key, password=None)
        return self._x509.load_pem_x509_certificate(certificate), loaded
