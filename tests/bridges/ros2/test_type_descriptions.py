"""A type's description, as a node answers it, is what the type's hash was made of."""

from __future__ import annotations

import hashlib
import json

import pytest
from rosbags.typesys import Stores, get_typestore

from llfsm.bridges.ros2.standard_node import TypeDescriptionServer
from llfsm.bridges.ros2.types._search_path import jazzy_names, jazzy_text
from llfsm.bridges.ros2.types.definition import EMPTY_MEMBER, parse
from memory_transport import MemoryTransport, MemoryWorld
from waiting import PATIENCE_S

SERVICE = "type_description_interfaces/srv/GetTypeDescription"


@pytest.fixture
def ask(types):
    world = MemoryWorld()
    with MemoryTransport(world) as ours, MemoryTransport(world) as theirs:
        TypeDescriptionServer(ours.node("robot"), types, lambda do: do())
        of = types.service(SERVICE)
        client = theirs.node("tool").client("/robot/get_type_description", of)

        def ask(name, type_hash):
            request = of.request.message(type_name=name, type_hash=type_hash)
            return client.call(request, timeout=PATIENCE_S).result(PATIENCE_S)

        yield ask


def plain(individual):
    """Return a description as the data that is hashed: without default values."""
    return {
        "type_name": individual.type_name,
        "fields": [
            {
                "name": field.name,
                "type": {
                    name: getattr(field.type, name)
                    for name in ("type_id", "capacity", "string_capacity", "nested_type_name")
                },
            }
            for field in individual.fields
        ],
    }


@pytest.mark.parametrize(
    "name",
    ["turtlesim/msg/Pose", "geometry_msgs/msg/Twist", "turtlesim/srv/Spawn",
     "turtlesim/action/RotateAbsolute", "rcl_interfaces/msg/ParameterEvent"],
)  # fmt: skip
def test_the_answer_has_the_hash_that_was_asked_for(ask, types, name):
    kind = {"msg": types.message, "srv": types.service, "action": types.action}[name.split("/")[1]]
    answer = ask(name, kind(name).type_hash)
    assert answer.successful
    whole = {
        "type_description": plain(answer.type_description.type_description),
        "referenced_type_descriptions": [
            plain(each) for each in answer.type_description.referenced_type_descriptions
        ],
    }
    digest = hashlib.sha256(json.dumps(whole).encode()).hexdigest()
    assert kind(name).type_hash == f"RIHS01_{digest}"


@pytest.mark.parametrize("name", ["", "turtlesim/msg/Color", "no name"])
def test_a_type_in_use_is_found_by_its_hash_whatever_the_name(ask, types, name):
    answer = ask(name, types.message("turtlesim/msg/Pose").type_hash)
    assert (answer.successful, answer.failure_reason) == (True, "")
    assert answer.type_description.type_description.type_name == "turtlesim/msg/Pose"
    assert "turtlesim/msg/Pose" in sources(answer)


@pytest.mark.parametrize(
    ("name", "type_hash", "reason"),
    [
        ("turtlesim/msg/Pose", "RIHS01_00", "the hash of turtlesim/msg/Pose is RIHS01_7"),
        ("turtlesim/msg/Pos", "RIHS01_00", "did you mean turtlesim/msg/Pose"),
        ("", "", "is not a type name"),
    ],
)
def test_a_failure_says_why(ask, name, type_hash, reason):
    answer = ask(name, type_hash)
    assert not answer.successful
    assert reason in answer.failure_reason


def sources(answer):
    return {each.type_name: (each.encoding, each.raw_file_contents) for each in answer.type_sources}


def test_sources_are_the_files_and_what_has_none_says_so(ask, types):
    spawn = sources(ask("turtlesim/srv/Spawn", types.service("turtlesim/srv/Spawn").type_hash))
    assert spawn["turtlesim/srv/Spawn"][0] == "srv"
    assert "float32 x" in spawn["turtlesim/srv/Spawn"][1]
    assert spawn["turtlesim/srv/Spawn_Request"] == ("implicit", "")
    assert spawn["builtin_interfaces/msg/Time"][0] == "msg"
    assert "int32 sec" in spawn["builtin_interfaces/msg/Time"][1]


def test_a_type_that_only_rosbags_knows_is_written_out(ask, types):
    scan = types.message("sensor_msgs/msg/LaserScan")
    written = sources(ask(scan.name, scan.type_hash))
    assert set(written) == {scan.name, "std_msgs/msg/Header", "builtin_interfaces/msg/Time"}
    assert written[scan.name][1].splitlines()[0] == "std_msgs/Header header"
    assert written[scan.name][1].endswith("\nfloat32[] intensities")  # as rosidl: no end of line


def test_sources_are_left_out_on_request(types):
    world = MemoryWorld()
    with MemoryTransport(world) as transport:
        node = transport.node("robot")
        TypeDescriptionServer(node, types, lambda do: do())
        of = types.service(SERVICE)
        client = node.client("~/get_type_description", of)
        pose = types.message("turtlesim/msg/Pose")
        request = of.request.message(pose.name, pose.type_hash, False)
        answer = client.call(request, timeout=PATIENCE_S).result(PATIENCE_S)
    assert answer.successful
    assert answer.type_sources == ()


@pytest.mark.parametrize("name", sorted(jazzy_names()))
def test_the_source_of_a_type_of_rosbags_defines_its_fields_and_constants(name):
    known = get_typestore(Stores.ROS2_JAZZY).fielddefs[name]
    made = parse(jazzy_text(name), name, name)[name]
    assert [(each.name, each.type, each.value) for each in made.constants] == known[0]
    assert [each.name for each in made.fields] == [n for n, _ in known[1] if n != EMPTY_MEMBER]
