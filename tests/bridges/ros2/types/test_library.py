"""Where types are found, and the classes that are made of them."""

import subprocess
import sys
from typing import get_args

import msgspec
import pytest

from llfsm.bridges.ros2.errors import (
    DefinitionPathError,
    DefinitionSyntaxError,
    UnknownTypeError,
)
from llfsm.bridges.ros2.types import TypeLibrary
from llfsm.bridges.ros2.types._search_path import jazzy_names
from llfsm.whiteboard import MessageFieldError, Slot, Whiteboard

EVERYTHING = """
int8 LEAST=-3
string NAME="x"
bool b
byte octet
char letter 65
int8 i8 -1
uint64 u64
float32 f32 0.5
float64 f64
string s "none"
string<=3 short
wstring w
uint8[] raw
byte[2] pair
char[<=4] few [1, 2]
int16[2] two
float32[<=2] some
bool[] flags [true]
string[2] names
builtin_interfaces/Time at
builtin_interfaces/Time[2] span
builtin_interfaces/Time[] times
float32 class
int32 data
"""


def test_a_message_has_fields_defaults_and_constants(define):
    thing = define(Thing=EVERYTHING).message("own_msgs/msg/Thing").message
    time = thing().at
    assert msgspec.structs.asdict(thing()) == {
        "b": False,
        "octet": 0,
        "letter": 65,
        "i8": -1,
        "u64": 0,
        "f32": 0.5,
        "f64": 0.0,
        "s": "none",
        "short": "",
        "w": "",
        "raw": b"",
        "pair": b"\0\0",
        "few": b"\1\2",
        "two": (0, 0),
        "some": (),
        "flags": (True,),
        "names": ("", ""),
        "at": time,
        "span": (time, time),
        "times": (),
        "class_": 0.0,
        "data": 0,
    }
    assert (thing.LEAST, thing.NAME) == (-3, "x")
    assert thing.__type_name__ == "own_msgs/msg/Thing"
    with pytest.raises(AttributeError):
        thing().b = True


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("i8", 128),
        ("octet", -1),
        ("u64", -1),
        ("b", 1),
        ("short", "four"),
        ("pair", b"123"),
        ("few", b"12345"),
        ("two", (1,)),
        ("two", (1, 2**15)),
        ("some", (1.0, 2.0, 3.0)),
        ("names", ("a", "b", "c")),
    ],
)
def test_a_board_refuses_values_that_ros_has_no_room_for(define, field, value):
    thing = define(Thing=EVERYTHING).message("own_msgs/msg/Thing").message
    board, slot = Whiteboard.local(), Slot("thing", thing)
    board.add_message(slot, thing())
    with pytest.raises(MessageFieldError, match=field):
        board.add_message(slot, thing(**{field: value}))


def test_every_type_of_jazzy_is_a_message_that_comes_back(types):
    assert len(jazzy_names()) > 150
    for name in jazzy_names():
        kind = types.message(name)
        assert kind.decode(kind.encode(kind.message())) == kind.message(), name


def test_a_library_makes_each_type_once(types):
    assert types.message("turtlesim/msg/Pose") is types.message("turtlesim/msg/Pose")
    spawn = types.service("turtlesim/srv/Spawn")
    assert types.service("turtlesim/srv/Spawn") is spawn
    assert types.message("turtlesim/srv/Spawn_Request") is spawn.request
    rotate = types.action("turtlesim/action/RotateAbsolute")
    assert types.action("turtlesim/action/RotateAbsolute") is rotate
    assert types.service("turtlesim/action/RotateAbsolute_SendGoal") is rotate.send_goal


@pytest.fixture
def package(tmp_path):
    """A package as it lies in an installed share folder."""
    folder = tmp_path / "share" / "own_msgs"
    for kind, name, text in [
        ("msg", "Part", "int32 x"),
        ("msg", "Whole", "Part[] parts"),
        ("srv", "Ask", "Part part\n---\nPart part"),
        ("action", "Do", "Part part\n---\n---\n"),
    ]:
        (folder / kind).mkdir(parents=True, exist_ok=True)
        (folder / kind / f"{name}.{kind}").write_text(text)
    return folder


@pytest.mark.parametrize("place", ["share", "package", "ament"])
def test_places_of_definitions(package, place, monkeypatch):
    if place == "ament":
        monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{package.parents[1]}")
        library = TypeLibrary()
    else:
        library = TypeLibrary(share=[package if place == "package" else package.parent])
    whole = library.message("own_msgs/msg/Whole")
    part = library.message("own_msgs/msg/Part").message
    assert whole.message(parts=(part(x=1),)).parts[0].x == 1
    assert get_args(whole.message.__annotations__["parts"])[0] is part
    assert library.service("own_msgs/srv/Ask").response.message().part == part()
    assert library.action("own_msgs/action/Do").goal.message().part == part()


def test_files_are_places_too(package):
    files = [package / "msg" / "Part.msg", package / "msg" / "Whole.msg"]
    assert TypeLibrary(share=files).message("own_msgs/msg/Whole").message().parts == ()
    with pytest.raises(UnknownTypeError, match=r"msg/Whole has a field of type own_msgs/msg/Part"):
        TypeLibrary(share=files[1:]).message("own_msgs/msg/Whole")


def test_the_first_place_decides(package, tmp_path, monkeypatch):
    other = tmp_path / "other" / "own_msgs" / "msg"
    other.mkdir(parents=True)
    (other / "Part.msg").write_text("string text")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(package.parents[1]))
    first = TypeLibrary(share=[tmp_path / "other"]).message("own_msgs/msg/Part")
    assert first.message().text == ""
    assert TypeLibrary().message("own_msgs/msg/Part").message().x == 0


def test_a_place_that_is_not_there(tmp_path):
    with pytest.raises(DefinitionPathError, match="nowhere: no such folder or file"):
        TypeLibrary(share=[tmp_path / "nowhere"])


def test_a_file_that_is_no_text(package):
    (package / "msg" / "Part.msg").write_bytes(b"int32 \xff")
    with pytest.raises(DefinitionSyntaxError, match=r"Part\.msg: cannot be read"):
        TypeLibrary(share=[package]).message("own_msgs/msg/Part")


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("geometry_msgs/Twist", "did you mean geometry_msgs/msg/Twist"),
        ("geometry_msgs/msg/Twists", "did you mean geometry_msgs/msg/Twist"),
        ("wrong_package/msg/Spawn", "no definition in .*definitions, nor in rosbags"),
        ("../msg/Twist", "not a type name"),
        ("turtlesim/msg/Pose_Request", "not a type name"),
        ("turtlesim/srv/Spawn_Answer", r"Spawn\.srv defines no such part"),
        ("turtlesim/srv/Spawn", "a type of services, not of messages"),
        ("turtlesim/action/RotateAbsolute", "a type of actions, not of messages"),
        ("", "not a type name"),
    ],
)
def test_types_that_nobody_defines(types, name, reported):
    with pytest.raises(UnknownTypeError, match=reported):
        types.message(name)


def test_kinds_are_not_mixed_up(types):
    with pytest.raises(UnknownTypeError, match="a type of messages, not of services"):
        types.service("turtlesim/msg/Pose")
    with pytest.raises(UnknownTypeError, match="a type of services, not of actions"):
        types.action("turtlesim/srv/Spawn")


def test_without_rosbags_an_unknown_type_says_how_to_get_more():
    code = """
import sys
sys.modules["rosbags"] = None
from llfsm.bridges.ros2.types import TypeLibrary
library = TypeLibrary()
assert library.message("turtlesim/msg/Pose").name == "turtlesim/msg/Pose"
library.message("sensor_msgs/msg/Image")
"""
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=False)
    assert "UnknownTypeError: sensor_msgs/msg/Image: " in done.stderr
    assert "install llfsm[ros]" in done.stderr


def test_a_type_that_contains_itself(define):
    library = define(A="B[] b", B="A[] a")
    with pytest.raises(DefinitionSyntaxError, match=r"msg/A > own_msgs/msg/B > .*contains itself"):
        library.message("own_msgs/msg/A")


def test_rosbags_is_only_imported_for_a_type_that_does_not_ship():
    code = """
import sys
from llfsm.bridges.ros2.types import TypeLibrary
library = TypeLibrary()
library.message("turtlesim/msg/Pose")
library.service("rcl_interfaces/srv/GetParameters")
assert not {"rosbags", "numpy", "zenoh"} & sys.modules.keys()
library.message("sensor_msgs/msg/Image")
assert "rosbags" in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def bomb(levels: int, width: int) -> dict[str, str]:
    """Define types of types, of which each has so many fields of the next."""
    texts = {
        f"T{n}": "".join(f"T{n + 1} f{each}\n" for each in range(width)) for n in range(levels)
    }
    return {**texts, f"T{levels}": "int32 x\n"}


@pytest.mark.parametrize(
    ("texts", "why"),
    [
        ({"T0": "int32[4000000000] x"}, "4,000,000,000 values"),
        ({"T0": "uint8[4000000000] x"}, "250,000,000 values"),
        ({"T0": "T1[2000] x", "T1": "float64[2000] x"}, "4,000,000 values"),
        (bomb(10, 10), "100,000 fields"),
        (bomb(400, 1), "more than 64 deep"),
    ],
)
def test_a_type_that_would_fill_the_memory_is_refused(define, texts, why):
    with pytest.raises(DefinitionSyntaxError, match=why):
        define(**texts).message("own_msgs/msg/T0")


def test_a_large_type_is_not():
    library = TypeLibrary()
    for name in library.message_names():
        assert library.message(name).message() is not None
