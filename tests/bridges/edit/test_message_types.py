"""What can be included: each text that is offered makes the type that it is offered for."""

from __future__ import annotations

import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.edit.message_types import message_class_text, offered, ros_class
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.view.live_source import LiveSource
from llfsm.whiteboard import Message, Slot, Whiteboard
from llfsm.whiteboard.message_text import shipped_types
from llfsm.whiteboard.messages.geometry_msgs import Twist
from llfsm.whiteboard.messages.llfsm import BELL, Bell

from .conftest import EditServer


class Wind(Message):
    speed: float = 0.0


class Odd(Message, type_name="not a name"):
    speed: float = 0.0


def included(text: str, name: str) -> Any:
    names: dict[str, Any] = {}
    made = re.sub(r"\bNAME\b", name, text)
    exec(compile(made, "text", "exec", dont_inherit=True), names)
    return names[name]


def test_each_type_is_what_its_text_makes() -> None:
    types = {each["type"]: each for each in offered(None)["types"] if each["type"]}
    assert len(types) > 100
    assert types.keys() >= {*TypeLibrary().message_names(), "sensor_msgs/msg/LaserScan"}
    assert types["geometry_msgs/msg/Twist"] == {
        "name": "Twist",
        "type": "geometry_msgs/msg/Twist",
        "text": "from llfsm.whiteboard.messages.geometry_msgs import Twist as NAME\n",
    }
    for name in ("geometry_msgs/msg/Twist", "turtlesim/msg/Pose", "sensor_msgs/msg/LaserScan"):
        assert included(types[name]["text"], "Other").__type_name__ == name
    assert included(types["geometry_msgs/msg/Twist"]["text"], "T") is Twist
    base = [each for each in offered(None)["types"] if not each["type"]]
    assert {each["name"] for each in base} == {"Actuator", "Sensor", "Message", "Slot"}
    for each in base:
        assert included(each["text"], each["name"]).__name__ == each["name"]


def test_slots_of_the_board_and_types_that_only_it_has() -> None:
    board = Whiteboard.local()
    board.add_message(Slot("wind", Wind), Wind())
    board.add_message(Slot("odd", Odd), Odd())
    board.add_message(Slot("cmd_vel", Twist), Twist())
    board.add_message(BELL, Bell())
    found = offered(LiveSource("robot", given=board))
    assert found["slots"] == {
        "wind": "Wind",
        "odd": "not a name",
        "cmd_vel": "geometry_msgs/msg/Twist",
    }
    assert [each["name"] for each in found["types"]].count("Twist") == 1
    assert "not a name" not in {each["type"] for each in found["types"]}
    [wind] = [each for each in found["types"] if each["type"] == "Wind"]
    assert Slot("wind", included(wind["text"], "Wind")).schema == Slot("wind", Wind).schema


def test_types_of_ros_by_name() -> None:
    made = ros_class("std_msgs/msg/String")
    assert made is not None
    assert made.__struct_fields__ == ("data",)
    assert ros_class("std_msgs/msg/Nothing") is ros_class("..") is None


@pytest.mark.parametrize("query", ["", "?token=wrong"])
def test_a_stranger_learns_no_slots(bundle: Path, query: str) -> None:
    server = EditServer(bundle)
    try:
        assert server.get(f"/offered{query}").status_code == 401
        assert len(server.get("/offered?token=secret").json()["types"]) > 100
    finally:
        server.end()


SCHEMAS = [Slot("any", each).schema for each in shipped_types()]
ODD = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5) | st.just("tensor"),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)


@given(st.data())
def test_a_schema_of_another_program_is_a_class_or_a_value_error(data: st.DataObject) -> None:
    schema = json.loads(json.dumps(data.draw(st.sampled_from(SCHEMAS))))
    for _ in range(data.draw(st.integers(1, 3))):
        part = schema
        while isinstance(part, dict) and part:
            key = data.draw(st.sampled_from(sorted(part)))
            if not isinstance(part[key], dict) or data.draw(st.booleans()):
                part[key] = data.draw(ODD)
                break
            part = part[key]
    with suppress(ValueError):
        compile(message_class_text(schema), "made", "exec")
