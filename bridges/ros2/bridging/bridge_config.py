"""The configuration of a bridge as data, in a TOML file or as flags; one that ships.

A relay with ``keyed_by = "transforms.child_frame_id"`` has a slot for each key. That is a path of
fields to a text or a whole number. If a field on the way is a sequence, each of its items is a
message for the slot of its key; otherwise the whole message is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct
from msgspec import inspect as mi

from llfsm.bridges.ros2.errors import KeyPathError
from llfsm.whiteboard import Message


class KeyPath:
    """The place of the keys in a message; ``part`` is the class of the messages of the slots."""

    def __init__(self, path: str, message: type[Message]) -> None:
        """Resolve a path in a class; raise :class:`.KeyPathError` if it does not lead to a key."""
        self.part: Any = message
        self._to_parts: list[str] | None = None
        """The fields on the way to a sequence, if there is one."""
        self._to_key: list[str] = []
        node: mi.Type = mi.type_info(message)
        for name in path.split("."):
            if not isinstance(node, mi.StructType):
                raise KeyPathError(f"{path!r}: there is no field {name!r} in a value")
            fields = {field.name.removesuffix("_"): field for field in node.fields}
            if name not in fields:
                known = ", ".join(fields)
                raise KeyPathError(f"{path!r}: no field {name!r}; there are: {known}")
            self._to_key.append(fields[name].name)
            node = fields[name].type
            item = getattr(node, "item_type", None)
            if self._to_parts is None and isinstance(item, mi.StructType):
                self._to_parts, self._to_key, self.part, node = self._to_key, [], item.cls, item
        if not isinstance(node, mi.StrType | mi.IntType):
            raise KeyPathError(f"{path!r}: a key is a text or a whole number")

    def split(self, message: Any) -> Iterator[tuple[str, Message]]:
        """Yield the keys in a message and the message of each."""
        parts = (message,) if self._to_parts is None else _at(message, self._to_parts)
        for part in parts:
            yield str(_at(part, self._to_key)).removeprefix("/"), part


def _at(value: Any, path: list[str]) -> Any:
    for name in path:
        value = getattr(value, name)
    return value


Direction = Literal["to_ros", "from_ros", "both"]
_Depth = Annotated[int, Meta(ge=1, le=2**31 - 1)]
_Capacity = Annotated[int, Meta(ge=1, le=2**30)]
_Positive = Annotated[float, Meta(gt=0, le=1e9)]


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
    deadline: _Positive | None = None
    """Seconds that may pass between two messages, as offered and requested; None: any."""
    lifespan: _Positive | None = None
    """Seconds for which a message to ROS is valid; None: for ever."""
    liveliness: Literal["automatic", "manual_by_topic"] = "automatic"
    lease: _Positive | None = None
    """Seconds that may pass between two signs of life; None: any."""
    depth: _Depth | None = None
    """Messages that wait for a slow reader; None: 10 to ROS, its default; 1 to a slot; 100 if
    keyed."""
    rate: _Positive | None = None
    """At most so many messages a second, in each direction."""
    capacity: _Capacity | None = None
    """Bytes of the longest message in a new slot; None: what the type needs."""
    keyed_by: str | None = None
    """A path of fields to a key: one slot ``SLOT/KEY`` for each key, from ROS only."""
    at_loss: dict[str, Any] | None = None
    """The message to post when the process that posted the latest one dies; to ROS only."""


class _ThroughSlots(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The settings common to services and actions through slots."""

    type: str
    """Its ROS name, as ``turtlesim/srv/Spawn`` or ``nav2_msgs/action/NavigateToPose``."""
    slots: str | None = None
    """The slots are ``SLOTS/request``, ``SLOTS/goal`` and so on; None: the name in ROS."""
    timeout: _Positive = 5.0
    """Seconds that an answer may take, and for which an action's server may be away."""
    capacity: _Capacity | None = None


class ServiceConfig(_ThroughSlots, frozen=True, kw_only=True):
    """A ROS service that is called or answered through slots."""

    service: str


class ActionConfig(_ThroughSlots, frozen=True, kw_only=True):
    """An action whose goals are sent or served through slots."""

    action: str
    role: Literal["client", "server"] = "client"


class PositionConfig(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The service ``turtle_position``."""

    pose: str
    """The slot with the turtle's pose."""


class BridgeConfig(Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A bridge's configuration."""

    node: str = "llfsm_bridge"
    """The bridge's node name, optionally with a namespace."""
    types: tuple[str, ...] = ()
    """Places that are searched first for definitions: packages, folders of packages, or files."""
    relay: tuple[RelayConfig, ...] = ()
    client: tuple[ServiceConfig, ...] = ()
    """Services called by requests in a slot."""
    server: tuple[ServiceConfig, ...] = ()
    """Services answered from a slot."""
    action: tuple[ActionConfig, ...] = ()
    """Actions of others, and those that machines serve."""
    turtle_position: PositionConfig | None = None


_OF_TURTLE: tuple[tuple[str, str, Direction], ...] = (
    ("cmd_vel", "geometry_msgs/msg/Twist", "to_ros"),
    ("pose", "turtlesim/msg/Pose", "from_ros"),
    ("color_sensor", "turtlesim/msg/Color", "from_ros"),
)


def turtlesim_config(turtles: Sequence[str]) -> BridgeConfig:
    """Make the configuration with which machines drive turtles of turtlesim_node.

    ``turtles`` are their names, at least one; ``turtle_position`` reports the first.
    """
    return BridgeConfig(
        node="llfsm_turtlesim_bridge",
        relay=(
            *(
                RelayConfig(slot=f"{name}/{what}", type=kind, direction=direction)
                for name in turtles
                for what, kind, direction in _OF_TURTLE
            ),
            RelayConfig(slot="pinpong", type="std_msgs/msg/String", direction="to_ros"),
        ),
        turtle_position=PositionConfig(pose=f"{turtles[0]}/pose"),
    )
