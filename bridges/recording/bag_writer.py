"""The file of a recording that ROS's tools take for a bag: MCAP with CDR, profile ``ros2``.

It is what rosbag2's storage writes: a topic has one channel, its schema is the text of the type's
definition and of all that it refers to. So it has no machines' events and no other slots of llfsm's
own, and no slot whose type is not a ROS type.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.well_known import Profile, SchemaEncoding

from llfsm.runtime.engine.failure import logger
from llfsm.whiteboard import Message, Sample, Slot
from llfsm.whiteboard.own_slots import is_own

from ..ros2.errors import RosNameError, RosTypeError
from ..ros2.ros_names import Names
from ..ros2.types import RosMessage, TypeLibrary
from ..ros2.types.definition_text import bundled
from .writer import RecordingWriter

__all__ = ["CDR", "BagWriter"]

CDR = "cdr"


class BagWriter(RecordingWriter):
    """Write a bag; slots of other types are left out, with a warning each."""

    profile = Profile.ROS2

    def __init__(self, path: Path, about: Mapping[str, str], types: TypeLibrary):
        super().__init__(path, about)
        self._types = types
        self._topics: dict[str, int] = {}
        self._found: dict[str, RosMessage[Any] | None] = {}

    def add(self, slot: Slot[Any], sample: Sample[Message], *, new: bool = False) -> None:
        """Write a message of a slot, if its type is a ROS type."""
        if slot.name not in self._found:
            self._found[slot.name] = self._find(slot)
        if self._found[slot.name] is not None:
            super().add(slot, sample, new=new)

    def _find(self, slot: Slot[Any]) -> RosMessage[Any] | None:
        if is_own(slot.name):
            return None
        try:
            Names("bag").full(f"/{slot.name}")
            return self._types.of(slot.type)
        except (RosNameError, RosTypeError) as error:
            logger().warning("slot %s is not recorded: %s", slot.name, error)
            return None

    def _add_channel(self, slot: Slot[Any], writer: int, wraps: int) -> int:
        """Return the topic's channel, whoever writes: in a bag, a topic has one."""
        channel = self._topics.get(slot.name)
        if channel is None:
            of = self._found[slot.name]
            assert of is not None, "a slot that is written has a ROS type"
            self._codecs[slot.name] = of
            text = bundled(self._types.sources(of.name))
            schema = self._schema(of.name, text.encode(), SchemaEncoding.ROS2)
            about = {
                "topic_type_hash": of.type_hash,
                "writer": "0",
                "capacity": str(slot.capacity),
                "wraps": "0",
            }
            channel = self._writer.register_channel(f"/{slot.name}", CDR, schema, about)
            self._topics[slot.name] = channel
        self._channels[slot.name, writer, wraps] = channel
        return channel
