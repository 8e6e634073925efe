"""The repository is a ROS 2 package that colcon builds: what that needs, without colcon and ROS."""

from __future__ import annotations

import ast
import configparser
import json
import os
import runpy
import subprocess
import sys
import tomllib
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest
from catkin_pkg.package import parse_package
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from ruamel.yaml import YAML

from llfsm.cli import VERSION
from llfsm.cli.root import main

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

# What setup() was given, as colcon sees it: the public attributes that are no code, as text.
ASK = """
import json, setuptools
from distutils.core import run_setup
given = run_setup("setup.py", stop_after="config")
skipped = {"cmdclass", "distclass", "ext_modules", "metadata", *given.display_option_names}
data = {name: repr(value) for name, value in vars(given).items()
        if name[0] != "_" and name not in skipped and not callable(value)}
metadata = {name: getattr(given.metadata, name) for name in ("name", "version", "license")}
print(json.dumps([data, metadata]))
"""


@pytest.fixture(scope="module")
def setup() -> dict[str, Any]:
    """Return what colcon learns from setup.py; only plain data can be learned."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", ASK],
        cwd=ROOT,
        text=True,
        capture_output=True,
        check=True,
    )
    data, metadata = json.loads(done.stdout)
    return metadata | {name: ast.literal_eval(value) for name, value in data.items()}


@pytest.mark.parametrize("path", [".", "ros/turtle_sensor_poster"])
def test_manifests_are_in_order_and_say_what_the_project_says(path: str) -> None:
    warnings: list[str] = []
    manifest = parse_package(str(ROOT / path), warnings=warnings)
    assert warnings == []
    assert manifest.package_format == 3
    assert manifest.version == PROJECT["version"] == VERSION
    assert [str(licence) for licence in manifest.licenses] == ["Apache-2.0"]


def test_the_manifest_agrees_with_the_rest(setup: dict[str, Any]) -> None:
    manifest = parse_package(str(ROOT))
    assert manifest.name == PROJECT["name"] == setup["name"]
    assert manifest.description == PROJECT["description"]
    assert manifest.get_build_type() == "ament_python"
    assert (setup["version"], setup["license"]) == (manifest.version, "Apache-2.0")
    assert (ROOT / manifest.licenses[0].file).is_file()


def test_what_colcon_stumbles_over_is_not_there(setup: dict[str, Any]) -> None:
    """It reads only plain data, and takes the extra `test` for what a package depends on."""
    assert setup["python_requires"] == ">=3.11"
    assert "requires-python" not in PROJECT  # which older setuptools make an object of
    for extra, requirements in setup["extras_require"].items():
        assert not [name for name in requirements if name.startswith("llfsm")], extra


def test_it_is_installed_where_ros_looks(setup: dict[str, Any]) -> None:
    places = dict(setup["data_files"])
    assert places["share/ament_index/resource_index/packages"] == ["resource/llfsm"]
    assert places["share/llfsm"] == ["package.xml"]
    assert all((ROOT / file).is_file() for files in places.values() for file in files)
    launch = sorted(str(file.relative_to(ROOT)) for file in ROOT.glob("launch/*.launch.py"))
    assert places["share/llfsm/launch"] == launch
    config = configparser.ConfigParser(interpolation=None)
    config.read(ROOT / "setup.cfg")
    assert config["install"]["install_scripts"] == "$base/lib/llfsm"
    assert config["develop"]["script_dir"] == "$base/lib/llfsm"


def test_each_dependency_has_a_key_of_rosdep() -> None:
    """Common ones are in rosdistro; for the others, ours are ready."""
    known = {"click", "pillow", "rich", "rosbags", "ruamel-yaml", "uvicorn", "websockets"}
    keys = YAML(typ="safe").load(ROOT / "ros" / "rosdep.yaml")
    needed = {*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["all"]}
    names = {canonicalize_name(Requirement(line).name) for line in needed}
    packages = {key.removeprefix("python3-").removesuffix("-pip"): key for key in keys}
    assert names - known == packages.keys()
    for package, key in packages.items():
        pip = {"pip": {"packages": [package]}}
        rule = pip if key.endswith("-pip") else [key]
        assert keys[key] == {"debian": rule, "ubuntu": rule}


def test_a_debian_package_has_all_that_it_needs() -> None:
    """It compiles the extensions; and apt cannot install what only pip has."""
    package = parse_package(str(ROOT))
    assert [each.name for each in package.build_depends] == ["python3-dev"]
    names = {each.name for each in package.exec_depends}
    assert {"python3-click", "python3-rich"} <= names
    assert not [name for name in names if name.endswith("-pip")]


def test_links_to_some_of_its_files_are_enough(tmp_path: Path) -> None:
    """As `colcon build --symlink-install` makes them, in a folder for what is built."""
    for name in ("setup.py", "setup.cfg", "package.xml", "resource", "launch", "src"):
        (tmp_path / name).symlink_to(ROOT / name)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "setup.py", "--name", "--version"],
        cwd=tmp_path,
        text=True,
        capture_output=True,
        check=True,
    )
    assert done.stdout.split() == [PROJECT["name"], PROJECT["version"]]
    assert (tmp_path / "whiteboard" / "_shm.c").is_file()


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[dict[str, Any]]]:
    """Run the launch file with values of its arguments, and return what it starts."""

    def module(name: str, **contents: object) -> None:
        fake = types.ModuleType(name)
        vars(fake).update(contents)
        monkeypatch.setitem(sys.modules, name, fake)

    module("launch", LaunchDescription=list, LaunchContext=object)
    module(
        "launch.actions",
        DeclareLaunchArgument=lambda name, **rest: {"name": name, **rest},
        ExecuteProcess=dict,
        OpaqueFunction=lambda function: function,
        SetEnvironmentVariable=lambda name, value: {name: value},
        Shutdown=lambda: "shutdown",
    )
    module("launch_ros")
    module("launch_ros.actions", Node=dict)

    def launch(**given: str) -> list[dict[str, Any]]:
        file = runpy.run_path(str(ROOT / "launch" / "wall.launch.py"))
        *declared, start = file["generate_launch_description"]()
        defaults = {each["name"]: each["default_value"] for each in declared}
        assert given.keys() <= defaults.keys()
        found: list[dict[str, Any]] = start(
            types.SimpleNamespace(launch_configurations=defaults | given)
        )
        return found

    return launch


def _checked(node: dict[str, Any]) -> click.Context:
    """Return the command that launch would start as a node, which raises if there is none."""
    assert (node["package"], node["executable"]) == ("llfsm", "llfsm")
    remaps = [word for pair in node["remappings"] for word in ("-r", ":=".join(pair))]
    words = [*node["arguments"], "--ros-args", "-r", f"__node:={node['name']}", *remaps]
    command: click.Command = main
    while isinstance(command, click.Group):
        context = click.Context(command)
        _, found, words = command.resolve_command(context, words)
        assert found is not None
        command = found
    return command.make_context("llfsm", words)


def test_the_launch_file_starts_commands_that_there_are(
    launched: Callable[..., list[dict[str, Any]]],
) -> None:
    turtlesim, machine = launched()
    assert turtlesim == {
        "package": "turtlesim",
        "executable": "turtlesim_node",
        "on_exit": "shutdown",
    }
    given = _checked(machine).params
    assert (given["ros"], given["machines"]) == (True, ("RosWallTurttleBot",))
    assert (given["transport"], given["remove_board"]) == ("auto", False)


def test_the_launch_file_has_arguments(launched: Callable[..., list[dict[str, Any]]]) -> None:
    arguments = {"turtle": "bob", "machine": "RosBlindTurttleBot", "transport": "zenoh"}
    environment, _, spawn, machine = launched(**arguments, domain="7", board="shown")
    assert environment == {"ROS_DOMAIN_ID": "7"}
    assert spawn["cmd"][:4] == ["ros2", "service", "call", "/spawn"]
    assert YAML(typ="safe").load(spawn["cmd"][-1])["name"] == "bob"
    assert ("turtle1/cmd_vel", "bob/cmd_vel") in machine["remappings"]
    given = _checked(machine).params
    assert (given["machines"], given["transport"]) == (("RosBlindTurttleBot",), "zenoh")
    assert (given["board"], given["remove_board"]) == ("shown", True)


def make(sourced: bool, venv: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if name[:5] != "AMENT"}
    if sourced:
        environment["AMENT_PREFIX_PATH"] = "/opt/ros/jazzy"
    command = ["make", "--dry-run", f"VENV={venv}", "setup"]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, text=True, capture_output=True, check=True
    )
    return done.stdout


def test_setup_makes_an_environment_that_sees_ros_where_ros_is_sourced(tmp_path: Path) -> None:
    venv = tmp_path / "venv"
    seeing, plain = f"-m venv --clear --system-site-packages {venv}", f"-m venv {venv}"
    assert seeing in make(True, venv)
    assert plain in make(False, venv)
    venv.mkdir()
    (venv / "pyvenv.cfg").touch()
    (venv / ".ready").touch()
    assert seeing in make(True, venv)  # and so it installs again, into that
    assert "pip install" in make(True, venv)
    assert "venv" not in make(False, venv).replace(str(venv), "")
    (venv / ".sees-system").touch()
    (venv / ".ready").touch()
    for sourced in (True, False):
        assert "-m venv" not in make(sourced, venv)
