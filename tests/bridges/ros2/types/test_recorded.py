"""Hashes and bytes that ROS 2 Jazzy itself made."""

from typing import Any, get_args

import msgspec
import pytest
from rosbags.typesys import Stores, get_typestore

from llfsm.bridges.ros2.types._search_path import SearchPath


def built(annotation: Any, plain: Any) -> Any:
    """Make what a field of that type holds from what JSON can say of it."""
    if isinstance(plain, list):
        if annotation is bytes or bytes in get_args(annotation):
            return bytes(plain)
        return tuple(built(annotation, item) for item in plain)
    if isinstance(plain, dict):
        while arguments := get_args(annotation):
            annotation = arguments[0]
        fields = {field.name: field.type for field in msgspec.structs.fields(annotation)}
        return annotation(**{name: built(fields[name], value) for name, value in plain.items()})
    return plain


def test_every_recorded_hash(types, recorded):
    hashes = recorded("type_hashes.json")
    kinds = {"message": types.message, "service": types.service, "action": types.action}
    found = {name: kinds[SearchPath([]).find(name).kind](name).type_hash for name in hashes}
    assert len(hashes) > 160
    assert found == hashes


def test_hashes_of_rosbags(types):
    store = get_typestore(Stores.ROS2_JAZZY)
    ours = {name: types.message(name).type_hash for name in store.fielddefs}
    theirs = {name: store.hash_rihs01(name) for name in store.fielddefs}
    wrong = {name for name in ours if ours[name] != theirs[name]}

    def has_char(name: str) -> bool:
        kinds = [field.type for field in SearchPath([]).find(name).fields]
        return any(k.base == "char" or (k.nested and has_char(k.base)) for k in kinds)

    # rosbags takes a char for IDL's; in ROS 2 it is a uint8, as the recorded hashes tell.
    assert wrong == {name for name in ours if has_char(name)}
    assert {"service_msgs/msg/ServiceEventInfo", "std_msgs/msg/Char"} <= wrong


def test_shipped_definitions_are_those_of_rosbags(types):
    """With their constants; rosbags does not know whether a constant is a byte or a uint8."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, (constants, _) in store.fielddefs.items():
        ours = {c.name: c.value for c in SearchPath([]).find(name).constants}
        assert ours == {constant: value for constant, _, value in constants}, name


def test_every_recorded_message(types, recorded):
    vectors = recorded("cdr_vectors.json")["vectors"]
    assert len(vectors) >= 30
    for vector in vectors:
        kind, data = types.message(vector["type"]), bytes.fromhex(vector["hex"])
        message = built(kind.message, vector["fields"])
        assert kind.encode(message) == data, vector
        assert kind.encode(kind.decode(data)) == data, vector
        assert kind.decode(memoryview(data)) == kind.decode(data)


@pytest.mark.parametrize(
    ("name", "dds_name"),
    [
        ("geometry_msgs/msg/Twist", "geometry_msgs::msg::dds_::Twist_"),
        ("turtlesim/srv/Spawn_Request", "turtlesim::srv::dds_::Spawn_Request_"),
        (
            "turtlesim/action/RotateAbsolute_FeedbackMessage",
            "turtlesim::action::dds_::RotateAbsolute_FeedbackMessage_",
        ),
    ],
)
def test_dds_names(types, name, dds_name):
    assert types.message(name).dds_name == dds_name


def test_a_service_and_an_action_have_their_parts(types):
    spawn = types.service("turtlesim/srv/Spawn")
    assert spawn.dds_name == "turtlesim::srv::dds_::Spawn_"
    assert spawn.request.message(name="bob").name == "bob"
    assert spawn.response.name == "turtlesim/srv/Spawn_Response"
    rotate = types.action("turtlesim/action/RotateAbsolute")
    assert rotate.send_goal.dds_name == "turtlesim::action::dds_::RotateAbsolute_SendGoal_"
    goal = rotate.goal.message(theta=1.5)
    assert rotate.send_goal.request.message(goal=goal).goal.theta == 1.5
    assert rotate.get_result.response.message().status == 0
    assert rotate.feedback_message.message().feedback == rotate.feedback.message()
