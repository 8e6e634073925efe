"""Ways into ROS by name; what one needs is imported when it is opened."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from types import ModuleType

from .errors import PortUnavailableError
from .port import Notice, Port
from .telling import log_notice

__all__ = ["WAYS", "load", "open_port"]

WAYS = ("auto", "rclpy", "zenoh")


def open_port(
    way: str = "auto",
    domain: int | None = None,
    *,
    notify: Callable[[Notice], None] = log_notice,
) -> Port:
    """Open a way into ROS: ``rclpy``, ``zenoh``, or ``auto``.

    ``auto`` is rclpy where a ROS environment is sourced (rclpy can be imported), as its nodes may
    use any middleware; else Zenoh. ``domain`` defaults to ``ROS_DOMAIN_ID``. Raise
    :class:`.PortUnavailableError` and :class:`.DomainIdError`.
    """
    if way == "auto":
        way = "rclpy" if importlib.util.find_spec("rclpy") else "zenoh"
    if way == "rclpy":
        port: Port = load("llfsm.bridges.ros2.rcl.port").RclpyPort(domain, notify=notify)
    elif way == "zenoh":
        port = load("llfsm.bridges.ros2.wire.port").ZenohPort(domain, notify=notify)
    else:
        raise PortUnavailableError(f"no way into ROS is called {way!r}: {', '.join(WAYS)}")
    return port


_GET = {
    "zenoh": "install it with: pip install 'llfsm[ros]'",
    "rclpy": "source a ROS 2 environment that has it, as: source /opt/ros/jazzy/setup.bash",
}


def load(module: str) -> ModuleType:
    """Import a module that needs a library; raise :class:`.PortUnavailableError` without it."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        how = _GET.get(error.name or "")
        if how is None:
            raise
        raise PortUnavailableError(f"{error.name} is not installed; {how}") from error
