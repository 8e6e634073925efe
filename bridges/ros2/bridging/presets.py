"""Configurations that ship."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from .config import BridgeConfig, Direction, PositionConfig, RelayConfig

__all__ = ["turtlesim"]


def turtlesim(turtles: Sequence[str]) -> BridgeConfig:
    """Return what lets machines drive turtles of turtlesim_node; at least one.

    ``turtle_position`` tells of the first.
    """
    return BridgeConfig(
        relay=(
            *_turtles(turtles),
            RelayConfig(slot="pinpong", type="std_msgs/msg/String", direction="to_ros"),
        ),
        turtle_position=PositionConfig(pose=f"{turtles[0]}/pose"),
    )


def _turtles(names: Iterable[str]) -> list[RelayConfig]:
    each: list[tuple[str, str, Direction]] = [
        ("cmd_vel", "geometry_msgs/msg/Twist", "to_ros"),
        ("pose", "turtlesim/msg/Pose", "from_ros"),
        ("color_sensor", "turtlesim/msg/Color", "from_ros"),
    ]
    return [
        RelayConfig(slot=f"{name}/{what}", type=kind, direction=direction)
        for name in names
        for what, kind, direction in each
    ]
