"""Defaults: the transport, domain and router that are used where none is named.

The environment decides as it does for ROS itself: ``ROS_DOMAIN_ID`` names the domain,
``RMW_IMPLEMENTATION`` the middleware of rclpy.
"""

from __future__ import annotations

import importlib.util
import os

from llfsm.bridges.ros2.errors import DomainIdError
from llfsm.whiteboard.mirror.settings import PORT

TRANSPORTS = ("auto", "rclpy", "zenoh")

DOMAINS = range(233)  # above, DDS has no ports left

ROUTER = f"tcp/localhost:{PORT}"  # where rmw_zenohd listens

ROS_ARGUMENTS = "--ros-args"
"""What precedes ROS's own arguments on a command line."""


def choose_transport(name: str, *, router: bool) -> str:
    """Choose ``rclpy`` or ``zenoh`` for ``auto``; return any other name as it is.

    It is rclpy where that can be imported, as its nodes may use any middleware; but Zenoh if a
    ``router`` is named, because rclpy has its own configuration.
    """
    if name != "auto":
        return name
    return "zenoh" if router or importlib.util.find_spec("rclpy") is None else "rclpy"


def needs_router(name: str, *, router: bool) -> bool:
    """Check if nodes on a transport find each other through a Zenoh router."""
    if choose_transport(name, router=router) == "zenoh":
        return True
    return os.environ.get("RMW_IMPLEMENTATION") == "rmw_zenoh_cpp"


def check_domain(domain: int) -> int:
    """Check a ROS domain id, and return it; raise :class:`.DomainIdError` if it is not 0 to 232."""
    if domain not in DOMAINS:
        raise DomainIdError(f"the ROS domain id {domain} is not in 0 to {DOMAINS[-1]}")
    return domain


def default_domain() -> int:
    """Read ``ROS_DOMAIN_ID``, 0 if it is not set; raise :class:`.DomainIdError`."""
    text = os.environ.get("ROS_DOMAIN_ID", "")
    try:
        return check_domain(int(text or "0"))
    except ValueError as error:
        raise DomainIdError(
            f"ROS_DOMAIN_ID={text!r} is not a number from 0 to {DOMAINS[-1]}"
        ) from error
