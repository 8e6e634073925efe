"""A Zenoh session's configuration, from our defaults, the user's file and the settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import NetworkError
from .settings import DEFAULT_ENDPOINT, Settings
from .zenoh_internals import error_text

if TYPE_CHECKING:
    import zenoh

__all__ = ["LEASE_MS", "configure", "endpoints"]

# A broken connection is noticed within this time and retried at this interval, so that boards
# agree soon after it. (A connection that survived the break would wait for TCP's own, doubling
# pauses.)
LEASE_MS = 1500
_OPEN_MS = 500
_RETRY = {"period_init_ms": 100, "period_max_ms": 100, "period_increase_factor": 1.0}
_CONNECT_MS = 3000
_OVERHEAD = 1 << 22  # bytes sent in addition to the largest message: names and schemas

# Each host connects to every host that it discovers, so that none has to forward.
_FULL_MESH = {"router": ["router", "peer"], "peer": ["router", "peer"], "client": []}


def configure(settings: Settings, mode: str) -> zenoh.Config:
    """Return the configuration of a session in mode ``peer`` or ``client``.

    Settings override the user's file, which overrides our defaults. Raise :class:`.NetworkError`
    for an unreadable file, and for a value that Zenoh does not accept.
    """
    import zenoh

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
        "connect/timeout_ms": _CONNECT_MS if mode == "client" else -1,
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
        "transport/unicast/accept_timeout": _OPEN_MS,
    }


def _read(path: str) -> zenoh.Config:
    import zenoh

    if not Path(path).is_file():
        raise NetworkError(f"{path}: no such Zenoh configuration file")
    try:
        return zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise NetworkError(f"{path}: {error_text(error)}") from error


def endpoints(config: zenoh.Config, which: str) -> tuple[str, ...]:
    """Return the endpoints of a session, where `which` is ``listen`` or ``connect``."""
    found = json.loads(config.get_json(f"{which}/endpoints"))
    if isinstance(found, dict):  # one list for each mode
        found = found.get(json.loads(config.get_json("mode")) or "peer", [])
    return tuple(str(endpoint) for endpoint in found)
