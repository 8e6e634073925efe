"""What a session of Zenoh is told: by us, by the settings, and by the file that they name."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import NetworkError
from .settings import DEFAULT_ENDPOINT, Settings

if TYPE_CHECKING:
    import zenoh

__all__ = ["LEASE_MS", "configure", "endpoints", "plain"]

# A cut is noticed within this time and bridged again at this pace, so that boards agree soon after
# it. (A connection that outlived a cut would wait for TCP's own, doubling pauses.)
LEASE_MS = 1500
_OPEN_MS = 500
_RETRY = {"period_init_ms": 100, "period_max_ms": 100, "period_increase_factor": 1.0}
_CONNECT_MS = 3000
_ROOM = 1 << 22  # bytes of what travels with the largest message, or without it: names and types

# Each host connects to all that it hears of, so that no host is between two others.
_EVERYBODY = {"router": ["router", "peer"], "peer": ["router", "peer"], "client": []}


def configure(settings: Settings, mode: str) -> zenoh.Config:
    """Return the configuration of a session that is a ``peer`` or a ``client``.

    Raise :class:`.NetworkError` for a file that is none, and for what Zenoh does not take.
    """
    import zenoh

    config = zenoh.Config()
    said = config if settings.zenoh is None else _read(settings.zenoh)
    # The file counts more than these: what it does not name has Zenoh's own default there.
    values = {
        key: value
        for key, value in _defaults(mode).items()
        if said.get_json(key) == config.get_json(key)
    }
    values |= {
        "connect/exit_on_failure": mode == "client",
        "connect/timeout_ms": _CONNECT_MS if mode == "client" else -1,
        "transport/shared_memory/enabled": False,  # not used, and left behind when killed
        "transport/link/rx/max_message_size": settings.largest + _ROOM,
    }
    if mode == "client":
        values["mode"] = mode
    if settings.listen is not None:
        values["listen/endpoints"] = list(settings.listen)
    if settings.connect is not None:
        values["connect/endpoints"] = list(settings.connect)
    if settings.multicast:
        values["scouting/multicast/enabled"] = True
        values["scouting/multicast/autoconnect"] = _EVERYBODY
    for key, value in values.items():
        try:
            said.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise NetworkError(f"Zenoh does not take {key} = {value}: {plain(error)}") from error
    return said


def _defaults(mode: str) -> dict[str, Any]:
    return {
        "mode": mode,
        "listen/endpoints": [DEFAULT_ENDPOINT] if mode == "peer" else [],
        "connect/retry": _RETRY,
        "scouting/delay": 1,
        "scouting/multicast/enabled": False,
        "scouting/gossip/autoconnect": _EVERYBODY,
        "transport/link/tx/lease": LEASE_MS,
        "transport/unicast/open_timeout": _OPEN_MS,
        "transport/unicast/accept_timeout": _OPEN_MS,
    }


def _read(path: str) -> zenoh.Config:
    import zenoh

    if not Path(path).is_file():
        raise NetworkError(f"{path}: no such file of Zenoh's configuration")
    try:
        return zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise NetworkError(f"{path}: {plain(error)}") from error


def endpoints(config: zenoh.Config, which: str) -> tuple[str, ...]:
    """Return where a session is to ``listen``, or to ``connect`` to."""
    found = json.loads(config.get_json(f"{which}/endpoints"))
    if isinstance(found, dict):  # for each mode its own
        found = found.get(json.loads(config.get_json("mode")) or "peer", [])
    return tuple(str(endpoint) for endpoint in found)


def plain(error: Exception) -> str:
    """Return what an error of Zenoh's says, without the places in its sources."""
    text = re.sub(r" at /\S+?\.rs:\d+\.?", "", str(error)).strip()
    wrapped = re.match(r'Json5Err\(Message \{ msg: "(.*?)", location: ', text)
    return wrapped[1] if wrapped else text
