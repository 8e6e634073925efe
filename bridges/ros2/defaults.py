"""The transports, domains and router that there are by default; it imports next to nothing."""

from __future__ import annotations

from llfsm.whiteboard.mirror.settings import PORT

TRANSPORTS = ("auto", "rclpy", "zenoh")
"""The names of transports on command lines."""

DOMAINS = range(233)  # above, DDS has no ports left

ROUTER = f"tcp/localhost:{PORT}"  # where rmw_zenohd listens

ROS_ARGUMENTS = "--ros-args"
"""The argument before ROS's own on a command line."""
