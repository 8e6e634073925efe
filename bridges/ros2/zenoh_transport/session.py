"""Configures a Zenoh session that connects to those of rmw_zenoh.

It is a peer that connects to a router and discovers other peers through it, without multicast. The
environment configures it as it does rmw_zenoh: ``ZENOH_SESSION_CONFIG_URI`` names a base file,
``ZENOH_CONFIG_OVERRIDE`` is ``path=value;path=value``, values in JSON5.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

import zenoh

from llfsm.bridges.ros2.defaults import ROUTER
from llfsm.bridges.ros2.errors import TransportUnavailableError
from llfsm.whiteboard.mirror.settings import endpoint_problem
from llfsm.whiteboard.mirror.zenoh_internals import error_text

_OVERRIDE = "ZENOH_CONFIG_OVERRIDE"
_PEER: dict[str, Any] = {
    "mode": "peer",
    "connect/endpoints": [ROUTER],
    "connect/timeout_ms": -1,  # keep trying until a router is there
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
    "listen/endpoints": ["tcp/localhost:0"],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
}
_ALWAYS: dict[str, Any] = {
    "scouting/delay": 1,  # ms that opening takes; it waits for no other peer
    "timestamping/enabled": True,  # histories are ordered by time stamps
    "transport/shared_memory/enabled": False,  # not used, and its file outlives a killed process
    # Batches of 64 KB that may wait to be sent, the most that Zenoh accepts. With its own 2, who
    # publishes a large message sleeps again and again until the thread that sends has made room.
    "transport/link/tx/queue/size/data": 16,
    # As rmw_zenoh. Who stalls for longer than the others' leases takes their connections for dead.
    # Zenoh makes them again, but its subscriptions are lost. On a busy host, 10 s are too short.
    "transport/link/tx/lease": 60_000,
    "transport/link/tx/keep_alive": 2,
}


def open_node_session(router: Sequence[str] | None) -> tuple[zenoh.Session, list[str]]:
    """Open a node's session; return it with the endpoints where it looks for a router.

    ``router`` overrides the environment. Raise :class:`.TransportUnavailableError` if either
    cannot be used.
    """
    for problem in filter(None, map(endpoint_problem, router or ())):
        raise TransportUnavailableError(f"router: {problem}")
    path = os.environ.get("ZENOH_SESSION_CONFIG_URI")
    if path:
        try:
            config = zenoh.Config.from_file(path)
        except zenoh.ZError as error:
            raise TransportUnavailableError(
                f"ZENOH_SESSION_CONFIG_URI={path}: {error_text(error)}"
            ) from error
    else:
        config = _configured(_ALWAYS | _PEER)
    for entry in filter(None, map(str.strip, os.environ.get(_OVERRIDE, "").split(";"))):
        name, _, value = entry.partition("=")
        _insert(config, name.strip(), value.strip(), f"{_OVERRIDE}: {entry}: ")
    if router is not None:
        _insert(config, "connect/endpoints", json.dumps(list(router)), "router: ")
    return _open(config), json.loads(config.get_json("connect/endpoints"))


def open_with(settings: dict[str, Any]) -> zenoh.Session:
    """Open a session with settings alone; raise :class:`.TransportUnavailableError`."""
    return _open(_configured(_ALWAYS | settings))


def _configured(settings: Mapping[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for name, value in settings.items():
        _insert(config, name, json.dumps(value))
    return config


def _insert(config: zenoh.Config, name: str, value: str, source: str = "") -> None:
    try:
        config.insert_json5(name, value)
    except zenoh.ZError as error:
        raise TransportUnavailableError(f"{source}{error_text(error)}") from error


def _open(config: zenoh.Config) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise TransportUnavailableError(error_text(error)) from error
