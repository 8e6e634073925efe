"""How a Zenoh session is set up to meet rmw_zenoh's.

A peer that connects to a router and learns of other peers from it, without multicast. The
environment says more, as for rmw_zenoh: ``ZENOH_SESSION_CONFIG_URI`` names a file to start from,
``ZENOH_CONFIG_OVERRIDE`` is ``path=value;path=value``, values in JSON5.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from typing import Any

import zenoh

from ..errors import PortUnavailableError

__all__ = ["ROUTER", "open_session", "override"]

ROUTER = "tcp/localhost:7447"
"""Where a session looks for its router unless told otherwise."""

_DEFAULTS: dict[str, Any] = {
    "mode": "peer",
    "connect/endpoints": [ROUTER],
    "connect/timeout_ms": -1,  # a router that is not there yet is no reason to give up
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
    "listen/endpoints": ["tcp/localhost:0"],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "timestamping/enabled": {"router": True, "peer": True, "client": True},  # for histories
}


def open_session(router: Sequence[str] | None) -> tuple[zenoh.Session, list[str]]:
    """Open a session; return it with the endpoints where it looks for a router.

    ``router`` wins over the environment. Raise :class:`.PortUnavailableError` if what either says
    cannot be used.
    """
    config = _config()
    if router is not None:
        _insert(config, "connect/endpoints", json.dumps(list(router)), "the router's address")
    try:
        endpoints = json.loads(config.get_json("connect/endpoints"))
        return zenoh.open(config), endpoints
    except zenoh.ZError as error:
        raise PortUnavailableError(f"no Zenoh session can be opened: {error}") from error


def override(config: zenoh.Config, text: str) -> None:
    """Change a configuration as ``ZENOH_CONFIG_OVERRIDE`` says."""
    for entry in filter(None, map(str.strip, text.split(";"))):
        path, _, value = entry.partition("=")
        _insert(config, path.strip(), value.strip(), f"ZENOH_CONFIG_OVERRIDE: {entry!r}")


def _config() -> zenoh.Config:
    path = os.environ.get("ZENOH_SESSION_CONFIG_URI")
    if path:
        try:
            config = zenoh.Config.from_file(path)
        except zenoh.ZError as error:
            raise PortUnavailableError(f"ZENOH_SESSION_CONFIG_URI={path}: {error}") from error
    else:
        config = zenoh.Config()
        for name, value in _DEFAULTS.items():
            config.insert_json5(name, json.dumps(value))
    override(config, os.environ.get("ZENOH_CONFIG_OVERRIDE", ""))
    return config


def _insert(config: zenoh.Config, path: str, value: str, source: str) -> None:
    try:
        config.insert_json5(path, value)
    except zenoh.ZError as error:
        raise PortUnavailableError(f"{source} is not something Zenoh takes: {error}") from error
