"""What a bridge's configuration may contain, in a TOML file or as flags; one that ships."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Literal

from msgspec import Meta, Struct

__all__ = [
    "BridgeConfig",
    "Direction",
    "PositionConfig",
    "RelayConfig",
    "ServiceConfig",
    "turtlesim_config",
]

Direction = Literal["to_ros", "from_ros", "both"]
_Depth = Annotated[int, Meta(ge=1, le=2**31 - 1)]
_Capacity = Annotated[int, Meta(ge=1, le=2**30)]
_Positive = Annotated[float, Meta(gt=0)]


class RelayConfig(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A slot and a topic."""

    slot: str
    type: str
    """Its ROS name, as ``geometry_msgs/msg/Twist``."""
    direction: Direction
    topic: str | None = None
    """None: the slot's name."""
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: _Depth | None = None
    """Messages that wait for a slow reader; None: 10 to ROS, its default, and 1 to a slot."""
    rate: _Positive | None = None
    """At most so many messages a second, in each direction."""
    capacity: _Capacity | None = None
    """Bytes of the longest message in a new slot; None: what the type needs."""


class ServiceConfig(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A ROS service that is called or answered through slots."""

    service: str
    type: str
    """Its ROS name, as ``turtlesim/srv/Spawn``."""
    slots: str | None = None
    """The slots are ``SLOTS/request`` and ``SLOTS/answer``; None: the service's name."""
    timeout: _Positive = 5.0
    """Seconds that an answer may take."""
    capacity: _Capacity | None = None


class PositionConfig(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The service ``turtle_position``."""

    pose: str
    """The slot with the turtle's pose."""


class BridgeConfig(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A bridge's configuration."""

    node: str = "llfsm_bridge"
    """The bridge's node name, optionally with a namespace."""
    types: tuple[str, ...] = ()
    """Where definitions are searched first: packages, folders of packages, or files."""
    relay: tuple[RelayConfig, ...] = ()
    client: tuple[ServiceConfig, ...] = ()
    """Services called by requests in a slot."""
    server: tuple[ServiceConfig, ...] = ()
    """Services answered from a slot."""
    turtle_position: PositionConfig | None = None


def turtlesim_config(turtles: Sequence[str]) -> BridgeConfig:
    """Return the configuration with which machines drive turtles of turtlesim_node.

    ``turtles`` are their names, at least one; ``turtle_position`` reports the first.
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
