"""The repository is a ROS 2 package that colcon builds: what that needs, without colcon and ROS."""

from __future__ import annotations

import ast
import configparser
import json
import os
import runpy
import shutil
import subprocess
import sys
import tomllib
import types
import zipfile
from pathlib import Path
from typing import Any

import click
import pytest
from catkin_pkg.package import parse_package

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
    assert manifest.version == PROJECT["version"]
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


def test_a_wheel_has_it_all(tmp_path: Path) -> None:
    """Without a C compiler, to be quick: an installation lacks only the extension then."""
    source = tmp_path / "source"
    source.mkdir()
    for name in ("pyproject.toml", "setup.py", "setup.cfg", "package.xml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in ("src", "launch", "resource", "whiteboard", "runtime", "machines", "bridges"):
        ignored = shutil.ignore_patterns("*.so", "*.egg-info", "__pycache__")
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=ignored)
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check",
         "--no-deps", "--no-build-isolation", "--no-index", "-w", str(tmp_path), str(source)],
        env=os.environ | {"CC": "/bin/false"},
        check=True,
    )  # fmt: skip
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        names = {name.partition("/")[2] for name in file.namelist()}
        (metadata,) = (name for name in file.namelist() if name.endswith("/METADATA"))
        told = file.read(metadata).decode().splitlines()
    assert {
        "data/share/ament_index/resource_index/packages/llfsm",
        "data/share/llfsm/package.xml",
        "data/share/llfsm/launch/wall.launch.py",
        "cli/root.py",
        "machines/RosPingPong.machine/States",
    } <= names
    assert {"Requires-Python: >=3.11", "License: Apache-2.0"} <= set(told)


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


def test_the_launch_file_starts_commands_that_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    def module(name: str, **contents: object) -> None:
        fake = types.ModuleType(name)
        vars(fake).update(contents)
        monkeypatch.setitem(sys.modules, name, fake)

    module("launch", LaunchDescription=list)
    module("launch.actions", ExecuteProcess=dict, Shutdown=lambda: "shutdown")
    module("launch_ros")
    module("launch_ros.actions", Node=dict)
    module("launch_ros.substitutions", ExecutableInPackage=dict)
    file = runpy.run_path(str(ROOT / "launch" / "wall.launch.py"))
    node, *processes = file["generate_launch_description"]()
    assert (node["package"], node["executable"]) == ("turtlesim", "turtlesim_node")
    started = []
    for process in processes:
        program, *words = process["cmd"]
        assert program == {"package": "llfsm", "executable": "llfsm"}
        started.append(" ".join(words[:2]))
        command: click.Command = main
        while isinstance(command, click.Group):
            context = click.Context(command)
            _, found, words = command.resolve_command(context, words)
            assert found is not None
            command = found
        command.make_context("llfsm", words)  # which raises if an argument is wrong
    assert started == ["bridge turtlesim", "run RosWallTurttleBot"]


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
