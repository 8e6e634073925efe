"""The ROS package of the turtle position, for those who build it with colcon."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from llfsm.bridges.ros2.types import TypeLibrary

ROOT = Path(__file__).parents[3]
PACKAGE = ROOT / "ros" / "turtle_sensor_poster"


def test_it_defines_what_the_bridge_serves():
    name = "turtle_sensor_poster/srv/TurtlePosition"
    built = TypeLibrary(share=[PACKAGE]).service(name)
    assert built.type_hash == TypeLibrary().service(name).type_hash
    shipped = (
        ROOT / "bridges" / "ros2" / "definitions" / PACKAGE.name / "srv" / "TurtlePosition.srv"
    )
    assert (PACKAGE / "srv" / "TurtlePosition.srv").read_bytes() == shipped.read_bytes()


def test_its_files_name_it_and_all_its_definitions():
    package = ET.parse(PACKAGE / "package.xml").getroot()
    assert package.findtext("name") == PACKAGE.name
    assert package.findtext("member_of_group") == "rosidl_interface_packages"
    assert package.findtext("export/build_type") == "ament_cmake"
    build = (PACKAGE / "CMakeLists.txt").read_text()
    assert f"project({PACKAGE.name})" in build
    generated = set(re.findall(r'"(srv/\w+\.srv)"', build))
    assert generated == {f"srv/{file.name}" for file in (PACKAGE / "srv").iterdir()}
