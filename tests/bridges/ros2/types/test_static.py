"""The classes that ship in ``llfsm.whiteboard.messages`` are what ROS says they are."""

import importlib
import pkgutil

import msgspec
import pytest

import llfsm.whiteboard.messages
from llfsm.bridges.ros2.errors import TypeMismatchError, UnknownTypeError
from llfsm.bridges.ros2.types._search_path import SearchPath
from llfsm.bridges.ros2.types.message_classes import make_class
from llfsm.whiteboard import Message
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.schema import describe


def classes() -> list[type[Message]]:
    found = []
    for module in pkgutil.iter_modules(llfsm.whiteboard.messages.__path__):
        reported = vars(
            importlib.import_module(f"{llfsm.whiteboard.messages.__name__}.{module.name}")
        )
        found += [one for one in reported.values() if isinstance(one, type) and "/" in name_of(one)]
    return sorted(set(found), key=name_of)


def name_of(cls: type) -> str:
    return getattr(cls, "__type_name__", "")


@pytest.mark.parametrize("cls", [c for c in classes() if "/msg/" in name_of(c)], ids=name_of)
def test_a_shipped_class_is_the_type_of_its_name(types, cls):
    """Fields, ranges, sizes, and the defaults: those of the definition."""
    places = SearchPath([])

    def made(name: str) -> type[Message]:
        return make_class(places.find(name), made)

    generated = made(name_of(cls))
    assert describe(cls) == describe(generated)
    assert msgspec.to_builtins(cls()) == msgspec.to_builtins(generated())
    kind = types.message(name_of(cls))
    assert kind.message is cls
    assert kind.decode(kind.encode(cls())) == cls()


def test_classes_ship_for_the_usual_types():
    names = set(map(name_of, classes()))
    assert {"geometry_msgs/msg/TwistStamped", "std_msgs/msg/Header"} <= names
    assert "builtin_interfaces/msg/Time" in names


def test_a_class_of_ones_own_is_encoded_and_decoded(types):
    class Step(Message, type_name="geometry_msgs/msg/Vector3"):
        x: float = 0.0
        y: float = 0.0
        z: float = 0.0

    class Drive(Message, type_name="geometry_msgs/msg/Twist"):
        linear: Step = Step()
        angular: Step = Step()

    drive = types.of(Drive)
    data = types.of(Twist).encode(Twist(linear=Vector3(x=2.0)))
    assert drive.decode(data) == Drive(linear=Step(x=2.0))
    assert type(drive.decode(data).linear) is Step
    assert drive.type_hash == types.of(Twist).type_hash
    assert types.of(Drive) is drive


def test_a_class_with_other_fields_is_refused(types):
    class Twist(Message, type_name="geometry_msgs/msg/Twist"):
        linear: Vector3 = Vector3()
        angular: float = 0.0

    with pytest.raises(TypeMismatchError, match=r"geometry_msgs/msg/Twist.*angular"):
        types.of(Twist)


def test_a_class_without_a_ros_name_is_refused(types):
    class Battery(Message):
        volts: float

    with pytest.raises(UnknownTypeError, match="'Battery' is not a type name"):
        types.of(Battery)


def test_a_definition_of_ones_own_goes_before_a_shipped_class(tmp_path, define):
    folder = tmp_path / "geometry_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Vector3.msg").write_text("float64 x\nfloat64 y\n")
    library = define()
    assert library.message("geometry_msgs/msg/Vector3").message is not Vector3
    assert library.message("geometry_msgs/msg/Twist").message is not Twist
    assert library.message("geometry_msgs/msg/Point").message.__module__.startswith(
        "llfsm.whiteboard"
    )
