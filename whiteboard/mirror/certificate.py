"""The name in a certificate, which Python's library reads only from those of a connection."""

from __future__ import annotations

import re
import ssl

__all__ = ["common_name"]

_FIRST = re.compile(r"-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----", re.DOTALL)
_VERSION = 0xA0  # the tag of an optional field before the others
_SUBJECT = 4  # fields before it: serial number, algorithm, issuer, validity
_COMMON_NAME = bytes((0x55, 0x04, 0x03))


def common_name(pem: str) -> str | None:
    """Return the common name of the first certificate in a PEM text; None if there is none.

    Raise ValueError for a text that is not a certificate.
    """
    found = _FIRST.search(pem)
    if found is None:
        raise ValueError("not a certificate in PEM")
    try:
        (certificate,) = _fields(ssl.PEM_cert_to_DER_cert(found[0]))
        fields = _fields(_fields(certificate[1])[0][1])
        if fields[0][0] == _VERSION:
            del fields[0]
        for _, relative_name in _fields(fields[_SUBJECT][1]):
            for _, attribute in _fields(relative_name):
                (_, kind), (_, value) = _fields(attribute)
                if kind == _COMMON_NAME:
                    return value.decode()
    except (IndexError, ValueError) as error:
        raise ValueError(f"not a certificate: {error}") from error
    return None


def _fields(data: bytes) -> list[tuple[int, bytes]]:
    """Return the tags and contents of consecutive DER values."""
    found = []
    at = 0
    while at < len(data):
        tag, length, at = data[at], data[at + 1], at + 2
        if length & 0x80:
            size = length & 0x7F
            length, at = int.from_bytes(data[at : at + size], "big"), at + size
        if at + length > len(data):
            raise ValueError("it ends too early")
        found.append((tag, data[at : at + length]))
        at += length
    return found
