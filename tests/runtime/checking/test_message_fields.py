"""What an editor completes behind a point, without a run of the bundle."""

from __future__ import annotations

import os
from pathlib import Path

import llfsm.machines
from llfsm.runtime.bundles import read_bundle
from llfsm.runtime.checking.message_fields import class_fields, message_fields
from llfsm.whiteboard.messages.geometry_msgs import Twist

MACHINES = Path(llfsm.machines.__file__).parent


def fields(folder: Path, includes: str, variables: str, **files: str) -> dict[str, object]:
    bundle = folder / "M.machine"
    bundle.mkdir()
    (bundle / "Language").write_text("python\n")
    (bundle / "States").write_text("A\n")
    (bundle / "State_A_OnEntry.py").write_text("\n")
    (bundle / "M_Includes.py").write_text(f"raise SystemExit\n{includes}")
    (bundle / "M_Variables.py").write_text(variables)
    for name, text in files.items():
        (bundle / name.replace("__", ".")).write_text(text)
    return dict(message_fields(read_bundle(bundle)))


def test_fields_of_types_that_ship_and_of_those_within() -> None:
    found = message_fields(read_bundle(MACHINES / "RosWallTurttleBot.machine"))
    assert found.keys() == {"asked", "answer"}
    assert {"x", "y", "number", "failure"} <= found["answer"].keys()


def test_fields_of_classes_in_the_bundle_and_beside_it(tmp_path: Path) -> None:
    (tmp_path / "kinds.py").write_text(
        "raise SystemExit\nLEVELS = Slot('level', Level)\n"
        "class Base(Message):\n    id: int = 0\n"
        "class Level(Base):\n    value: float = 0.0\n    next: 'Level | None' = None\n"
    )
    found = fields(
        tmp_path,
        "from kinds import LEVELS, Level as Height\n"
        "from llfsm.whiteboard.messages.geometry_msgs import Twist\n"
        "from os import path, environ\n"
        "class Both(Message):\n    height: Height\n    twist: Twist\n    again: 'Both'\n",
        "level = Sensor(LEVELS, default=Height())\n"
        "both = Sensor(Slot('both', Both))\nlast: Both | None = None\nheight = Height()\n"
        "drive = Actuator(Slot('cmd', Twist))\ncount: int = 0\nunknown = Sensor(NOTHING)\n"
        "other = Sensor(path)\n",
        IncludePath="..\n",
    )
    assert found.keys() == {"level", "both", "last", "height"}
    assert found["level"] == {"id": {}, "value": {}, "next": {}}
    both = found["both"]
    assert isinstance(both, dict)
    classes = class_fields(read_bundle(tmp_path / "M.machine"))
    assert classes["Both"] == ["height", "twist", "again"]
    assert (classes["Twist"], classes["Height"]) == (["linear", "angular"], ["id", "value", "next"])
    assert both["twist"]["linear"].keys() == {"x", "y", "z"}
    assert both["height"] == found["height"] == found["level"]


def test_what_cannot_be_read_has_no_fields(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.py")
    (tmp_path / "wrong.py").write_bytes(b"\xff\xfe")
    found = fields(
        tmp_path,
        "from pipe import A\nfrom wrong import B\nfrom nowhere import C\nfrom .x import D\n"
        "from llfsm.machines.nowhere import E\n",
        "".join(f"{name.lower()} = Sensor({name})\n" for name in "ABCDE"),
        IncludePath="..\n",
    )
    assert found == {}


def test_classes_that_have_themselves_have_an_end(tmp_path: Path) -> None:
    many = "".join(f"    field_{i}: 'Many'\n" for i in range(1000))
    found = fields(tmp_path, f"class Many(Message):\n{many}", "many = Sensor(Slot('many', Many))\n")
    assert len(str(found)) < 200_000


def test_types_of_ros_are_found_by_their_names(tmp_path: Path) -> None:
    includes = (
        "from llfsm.bridges.ros2.types import TypeLibrary\n\n"
        'Scan = TypeLibrary().message("sensor_msgs/msg/LaserScan").message\n'
        'Unknown = TypeLibrary().message("a/msg/B").message\n'
    )
    ports = "scan = Sensor(Slot('scan', Scan))\nunknown = Sensor(Slot('unknown', Unknown))\n"
    assert fields(tmp_path, includes, ports) == {}
    bundle = read_bundle(tmp_path / "M.machine")
    found = message_fields(bundle, {"sensor_msgs/msg/LaserScan": Twist}.get)
    assert found.keys() == {"scan"}
    assert found["scan"].keys() == {"linear", "angular"}
