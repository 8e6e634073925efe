"""A Zenoh session's configuration: our defaults, under the user's file, under the settings.

Times are chosen so that boards agree soon after a broken connection. With `access`, hosts are known
by the names in their certificates; the name in this host's own is read here, as Python's library
reads names only from the certificates of a connection.
"""

from __future__ import annotations

import json
import re
import ssl
from base64 import b64decode
from pathlib import Path
from typing import TYPE_CHECKING, Any

from llfsm.whiteboard.errors import NetworkError
from llfsm.whiteboard.mirror.keys import access_control, usable_name
from llfsm.whiteboard.mirror.settings import DEFAULT_ENDPOINT, Settings, endpoint_problem
from llfsm.whiteboard.mirror.zenoh_internals import error_text, open_client

if TYPE_CHECKING:
    import zenoh

# A broken connection is noticed within this time and retried at this interval, so that boards
# agree soon after it. (A connection that survived the break would wait for TCP's own, doubling
# pauses.)
LEASE_MS = 1500

_OPEN_MS = 2000  # three round trips of a link with 200 ms one way, and a lost packet

# Who connects must give up first: if the other side does, while its last answer is on its way, who
# connects takes for open what nobody reads, and never tries again (Zenoh 1.10).
_ACCEPT_MS = 2 * _OPEN_MS

_RETRY = {"period_init_ms": 100, "period_max_ms": 100, "period_increase_factor": 1.0}
_ATTEMPT_MS = 1000  # at least, of a client to connect
_OVERHEAD = 1 << 22  # bytes sent in addition to the largest message: names and schemas

# Each host connects to every host that it discovers, so that none has to forward.
_FULL_MESH = {"router": ["router", "peer"], "peer": ["router", "peer"], "client": []}


def configure(settings: Settings, mode: str) -> zenoh.Config:
    """Make the configuration of a session in mode ``peer`` or ``client``.

    Settings override the user's file, which overrides our defaults. Raise :class:`.NetworkError`
    for an unreadable file, and for a value that Zenoh does not accept.
    """
    import zenoh

    for which in ("listen", "connect"):
        for number, endpoint in enumerate(getattr(settings, which) or ()):
            if problem := endpoint_problem(endpoint):
                raise NetworkError(f"{which}: {problem}", (which, number))
    unchanged = zenoh.Config()
    config = zenoh.Config() if settings.zenoh is None else _read(settings.zenoh)
    # A key that the file does not set has Zenoh's own default.
    values = {
        key: value
        for key, value in _defaults(mode).items()
        if config.get_json(key) == unchanged.get_json(key)
    }
    values |= {
        "connect/exit_on_failure": mode == "client",
        "connect/timeout_ms": -1,  # of a client, see open_session
        "transport/shared_memory/enabled": False,  # not used; a killed process would leave it
        "transport/link/rx/max_message_size": settings.largest + _OVERHEAD,
    }
    if mode == "client":
        values["mode"] = mode
    if settings.listen is not None:
        values["listen/endpoints"] = list(settings.listen)
    if settings.connect is not None:
        values["connect/endpoints"] = list(settings.connect)
    if settings.multicast:
        values["scouting/multicast/enabled"] = True
        values["scouting/multicast/autoconnect"] = _FULL_MESH
    if settings.access:
        _check_certificates(config)
        values["access_control"] = access_control(settings.access)
    for key, value in values.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise NetworkError(
                f"Zenoh does not accept {key} = {value}: {error_text(error)}"
            ) from error
    return config


def _defaults(mode: str) -> dict[str, Any]:
    return {
        "mode": mode,
        "listen/endpoints": [DEFAULT_ENDPOINT] if mode == "peer" else [],
        "connect/retry": _RETRY,
        "scouting/delay": 1,
        "scouting/multicast/enabled": False,
        "scouting/gossip/autoconnect": _FULL_MESH,
        "transport/link/tx/lease": LEASE_MS,
        "transport/unicast/open_timeout": _OPEN_MS,
        "transport/unicast/accept_timeout": _ACCEPT_MS,
    }


def _read(path: str) -> zenoh.Config:
    import zenoh

    if not Path(path).is_file():
        raise NetworkError(f"{path}: no such Zenoh configuration file", ("zenoh",))
    try:
        return zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise NetworkError(f"{path}: {error_text(error)}") from error


def _check_certificates(config: zenoh.Config) -> None:
    """Raise :class:`.NetworkError` if access cannot be controlled by certificates."""
    if config.get_json("transport/link/tls/enable_mtls") != "true":
        raise NetworkError(
            "`access` names hosts by their certificates: let `zenoh` name a Zenoh configuration "
            "file with `enable_mtls: true` and this host's certificate",
            ("access",),
        )
    if config.get_json("access_control/enabled") == "true":
        raise NetworkError(
            "access_control is in the Zenoh configuration file, and in `access`", ("access",)
        )


def open_session(config: zenoh.Config, connect_s: float) -> zenoh.Session:
    """Open a session; a client tries to connect for `connect_s` seconds.

    Raise ``zenoh.ZError`` if it cannot.
    """
    import zenoh

    is_client = json.loads(config.get_json("mode")) == "client"
    if not (is_client and endpoints(config, "connect")):
        return zenoh.open(config)
    open_ms = json.loads(config.get_json("transport/unicast/open_timeout"))
    return open_client(config, max(_ATTEMPT_MS, 2 * open_ms), connect_s)


def endpoints(config: zenoh.Config, which: str) -> tuple[str, ...]:
    """Return a session's endpoints to listen at or to connect to: `which` is that word."""
    found = json.loads(config.get_json(f"{which}/endpoints"))
    if isinstance(found, dict):  # one list for each mode
        found = found.get(json.loads(config.get_json("mode")) or "peer", [])
    return tuple(str(endpoint) for endpoint in found)


def certificate_name(config: zenoh.Config) -> str:
    """Read the name in this host's certificate; ``-`` if it has none that can be in a key.

    Raise :class:`.NetworkError` for a file that cannot be read, or is no certificate.
    """
    for side in ("connect", "listen"):
        key = f"transport/link/tls/{side}_certificate"
        path, encoded = (json.loads(config.get_json(key + end)) for end in ("", "_base64"))
        if path is None and encoded is None:
            continue
        try:
            text = Path(path).read_text() if path else b64decode(encoded).decode()
            return usable_name(common_name(text))
        except (OSError, ValueError) as error:
            raise NetworkError(f"{key} {path or ''}: {error}") from error
    return "-"


# ---- Certificates ---------------------------------------------------------------------------

_FIRST = re.compile(r"-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----", re.DOTALL)
_VERSION = 0xA0  # the tag of an optional field before the others
_SUBJECT = 4  # fields before it: serial number, algorithm, issuer, validity
_COMMON_NAME = bytes((0x55, 0x04, 0x03))


def common_name(pem: str) -> str | None:
    """Read the common name of the first certificate in a PEM text; None if there is none.

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
    """Split DER (ITU-T X.690) into consecutive values, each a tag and its content."""
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
