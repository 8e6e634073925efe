"""A written package is a legal ROS 2 package: its XML, its Python, its names, its installation."""

from __future__ import annotations

import configparser
import os
import re
import runpy
import subprocess
import sys
import types
import unicodedata
from pathlib import Path
from xml.etree import ElementTree

import pytest
from catkin_pkg.package import parse_package
from hypothesis import given
from hypothesis import strategies as st

from free_ports import free_endpoint
from llfsm.bridges.ros2.opening import open_router
from llfsm.cli.package import PackageError, package_name, write_package

ORIGIN = "llfsm.machines:RosPingPong"


def write_bundle(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "Language").write_text("python")
    (folder / "States").write_text("A")
    (folder / "State_A_OnEntry.py").write_text("print('here I am')")
    (folder / ".hidden").touch()
    (folder / "__pycache__").mkdir()
    return folder


def contents(folder: Path) -> set[str]:
    return {str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file()}


@pytest.mark.parametrize(
    ("machine", "name"),
    [
        ("RosPingPong", "ros_ping_pong"),
        ("ROSWall2Turtle", "ros_wall2_turtle"),
        ("a-b c__D", "a_b_c_d"),
        ("Zähler", "zahler"),
        ("7Segments", "machine_7_segments"),
        ("X", "x_machine"),
        ("Class", "class_machine"),
        ("Signal", "signal_machine"),
        ("LLFSM", "llfsm_machine"),
    ],
)
def test_names_are_made_legal(machine: str, name: str) -> None:
    assert package_name(machine) == name


@given(st.text())
def test_every_name_is_legal_or_refused(machine: str) -> None:
    if not re.search("[a-z]", unicodedata.normalize("NFKD", machine), re.IGNORECASE | re.ASCII):
        with pytest.raises(PackageError, match="has no letter from a to z") as raised:
            package_name(machine)
        assert repr(machine) in str(raised.value)
        return
    name = package_name(machine)
    assert re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name)
    assert len(name) > 1
    assert package_name(name) == name


def test_what_a_package_consists_of(tmp_path: Path) -> None:
    package = write_package("RosPingPong", ORIGIN, tmp_path / "ws" / "src")
    assert package == tmp_path / "ws" / "src" / "ros_ping_pong"
    assert contents(package.parent) == {
        "ros_ping_pong/" + file
        for file in (
            "package.xml",
            "setup.py",
            "setup.cfg",
            "resource/ros_ping_pong",
            "ros_ping_pong/__init__.py",
            "ros_ping_pong/run.py",
            "launch/ros_ping_pong.launch.py",
        )
    }
    for file in package.rglob("*.py"):
        compile(file.read_text(), file, "exec")
    config = configparser.ConfigParser(interpolation=None)
    config.read(package / "setup.cfg")
    assert config["install"]["install_scripts"] == "$base/lib/ros_ping_pong"
    assert config["develop"]["script_dir"] == "$base/lib/ros_ping_pong"


def test_the_manifest_has_what_format_3_asks_for_in_its_order(tmp_path: Path) -> None:
    package = write_package("A<&>B", write_bundle(tmp_path / "A<&>B.machine"), tmp_path)
    manifest = ElementTree.parse(package / "package.xml").getroot()
    assert (manifest.tag, manifest.attrib) == ("package", {"format": "3"})
    required = ["name", "version", "description", "maintainer", "license"]
    assert [element.tag for element in manifest][:5] == required
    assert all(manifest.findtext(tag) for tag in required)
    assert manifest.findtext("name") == package.name == "a_b"
    assert re.fullmatch(r"\d+\.\d+\.\d+", manifest.findtext("version") or "")
    assert "A<&>B" in (manifest.findtext("description") or "")
    assert "@" in manifest[3].attrib["email"]
    assert manifest.findtext("export/build_type") == "ament_python"
    warnings: list[str] = []
    assert parse_package(str(package), warnings=warnings).get_build_type() == "ament_python"
    assert warnings == []


def test_the_launch_file_starts_the_executable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    launch, actions = types.ModuleType("launch"), types.ModuleType("launch_ros.actions")
    launch.LaunchDescription = list  # type: ignore[attr-defined]
    actions.Node = dict  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "launch", launch)
    monkeypatch.setitem(sys.modules, "launch_ros", types.ModuleType("launch_ros"))
    monkeypatch.setitem(sys.modules, "launch_ros.actions", actions)
    package = write_package("RosPingPong", ORIGIN, tmp_path)
    file = runpy.run_path(str(package / "launch" / "ros_ping_pong.launch.py"))
    (node,) = file["generate_launch_description"]()
    assert node == {"package": package.name, "executable": package.name, "output": "screen"}


def test_what_is_there_is_not_touched(tmp_path: Path) -> None:
    package = write_package("RosPingPong", ORIGIN, tmp_path)
    (package / "setup.py").write_text("mine")
    with pytest.raises(PackageError, match="ros_ping_pong is there already: remove it"):
        write_package("RosPingPong", ORIGIN, tmp_path)
    assert (package / "setup.py").read_text() == "mine"
    assert os.listdir(tmp_path) == ["ros_ping_pong"]


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(PackageError, match=r"lost cannot be written: .*Lost\.machine"):
        write_package("Lost", tmp_path / "Lost.machine", tmp_path / "src")
    assert os.listdir(tmp_path / "src") == []
    (tmp_path / "file").touch()
    with pytest.raises(PackageError, match="cannot be written"):
        write_package("RosPingPong", ORIGIN, tmp_path / "file")


def test_it_installs_and_its_script_runs_the_machine(tmp_path: Path) -> None:
    """From the installed copy: the bundle that was packaged is gone by then."""
    bundle = write_bundle(tmp_path / "Here.machine")
    package = write_package("Here", bundle, tmp_path / "src")
    assert {file for file in contents(package / "here") if "machine" in file} == {
        f"Here.machine/{file}" for file in ("Language", "States", "State_A_OnEntry.py")
    }
    bundle.rename(tmp_path / "Gone.machine")
    site = tmp_path / "site"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
         "--no-deps", "--no-build-isolation", "--use-pep517", "--no-index", "--target", str(site),
         str(package)],
        check=True,
    )  # fmt: skip
    assert {
        "share/here/package.xml",
        "share/here/launch/here.launch.py",
        "share/ament_index/resource_index/packages/here",
        "here/Here.machine/State_A_OnEntry.py",
        "bin/here",
    } <= contents(site)
    board = f"test-packaging-{os.getpid()}"
    options = ["-q", "--board", board, "--remove-board", "--transport", "zenoh"]
    endpoint = free_endpoint()
    with open_router([endpoint]):
        done = _run([str(site / "bin" / "here"), *options, "--router", endpoint], site, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "here I am\n", "")


def _run(command: list[str], site: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        env=os.environ | {"PYTHONPATH": str(site)},
        cwd=folder,
        text=True,
        capture_output=True,
        check=False,
    )
