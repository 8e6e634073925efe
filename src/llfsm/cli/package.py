"""``llfsm package``: the ROS 2 package that starts a machine.

machine_catkin_setup.sh did this for ROS 1. A bundle is copied into the package; a class is imported
from where it is installed.
"""

from __future__ import annotations

import keyword
import re
import shutil
import sys
import tempfile
import unicodedata
from pathlib import Path
from string import Template
from xml.sax.saxutils import escape

import click

from llfsm.cli.echo import echo
from llfsm.cli.machines import find_bundle, find_machine_class
from llfsm.cli.options import output_option
from llfsm.errors import LlfsmError
from llfsm.runtime.bundles import SUFFIX, read_bundle, require_python
from llfsm.runtime.checking.bundles import check_bundle
from llfsm.runtime.engine.errors import BundleError


class PackageError(LlfsmError):
    """A package has no legal name, exists already or cannot be written."""


_WORDS = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[^A-Za-z0-9]+")
_TAKEN = {"launch", "launch_ros", "llfsm", "setup", *keyword.kwlist, *sys.stdlib_module_names}

# What only the owner of the package knows is marked as `ros2 pkg create` marks it.
_FILES = {
    "package.xml": """\
<?xml version="1.0"?>
<?xml-model href="http://download.ros.org/schema/package_format3.xsd"
  schematypens="http://www.w3.org/2001/XMLSchema"?>
<package format="3">
  <name>$name</name>
  <version>0.1.0</version>
  <description>$description</description>
  <maintainer email="user@todo.todo">TODO: maintainer</maintainer>
  <license>TODO: License declaration</license>

  <exec_depend>launch</exec_depend>
  <exec_depend>launch_ros</exec_depend>
  <exec_depend>rclpy</exec_depend>

  <export>
    <build_type>ament_python</build_type>
  </export>
</package>
""",
    "setup.py": """\
from setuptools import setup

setup(
    name="$name",
    version="0.1.0",
    packages=["$name"],
    package_data={"$name": ["*.machine/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/$name"]),
        ("share/$name", ["package.xml"]),
        ("share/$name/launch", ["launch/$name.launch.py"]),
    ],
    install_requires=["setuptools", "llfsm"],
    zip_safe=False,
    entry_points={"console_scripts": ["$name = $name.run:main"]},
)
""",
    "setup.cfg": """\
[develop]
script_dir=$$base/lib/$name
[install]
install_scripts=$$base/lib/$name
""",
    "resource/$name": "",
    "$name/__init__.py": "",
    "$name/run.py": '''\
"""Run the machine as a node, with the arguments of ``llfsm run``."""

import sys
$imports
from llfsm.cli.root import main as llfsm

MACHINE = $machine


def main() -> None:
    """Run it; the arguments of ROS are those from --ros-args to -- or the end."""
    arguments = ["run", "--ros", "--node", "$name", MACHINE, *sys.argv[1:]]
    llfsm.main(arguments, prog_name="$name")


if __name__ == "__main__":
    main()
''',
    "launch/$name.launch.py": '''\
"""Start the machine: ``ros2 launch $name $name.launch.py``."""

from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Describe the launch: the machine, as a node."""
    return LaunchDescription([Node(package="$name", executable="$name", output="screen")])
''',
}


@click.command()
@click.argument("machine")
@output_option("the package")
def package(machine: str, output: Path) -> None:
    """Write the ROS 2 package that starts MACHINE, named as for `llfsm run`.

    A bundle is copied into it, with those that its states run, and its code is not run. A class is
    imported, so it must be installed where it runs.

    \b
    llfsm package RosPingPong -o ~/ros2_ws/src
    cd ~/ros2_ws && colcon build && . install/setup.sh
    ros2 launch ros_ping_pong ros_ping_pong.launch.py
    """
    folder = find_bundle(machine)
    if folder is None:
        cls = find_machine_class(machine)
        target = write_package(cls.__name__, cls.table.path, output)
    else:
        for each in with_inner_bundles(folder):
            require_python(read_bundle(each))
            for found in check_bundle(each, load=False):
                if found.severity == "error":
                    raise PackageError(f"{found.file}:{found.line}: {found.text}")
        target = write_package(read_bundle(folder).name, folder, output)
    echo(f"wrote {target}: ros2 run {target.name} {target.name}")


def package_name(machine: str, module: str = "") -> str:
    """Make the name of a machine's package: lower case, digits, single underscores (REP 144).

    ``_machine`` is appended to a name of one letter, to one that Python or ROS uses and to that of
    the ``module`` from which the machine is imported. Raise `PackageError` if the name has no
    letter from a to z.
    """
    plain = unicodedata.normalize("NFKD", machine).encode("ascii", "ignore").decode()
    name = "_".join(word for word in _WORDS.split(plain) if word).lower()
    if not re.search("[a-z]", name):
        raise PackageError(f"{machine!r} has no letter from a to z for the name of a package")
    if name[0].isdigit():
        name = f"machine_{name}"
    return f"{name}_machine" if len(name) < 2 or name in {*_TAKEN, module} else name


def write_package(machine: str, origin: Path | str, folder: Path) -> Path:
    """Write the package of `machine` into `folder`, all of it or nothing; return its folder.

    `origin` is the folder of the machine's bundle, or ``package.module:Class``. Raise
    `PackageError` if the package exists already or cannot be written.
    """
    name = package_name(machine, re.split("[.:]", origin)[0] if isinstance(origin, str) else "")
    target = folder / name
    if target.exists() or target.is_symlink():
        raise PackageError(f"{target} is there already: remove it, or write to another folder")
    if isinstance(origin, Path):
        imports, code = (
            "from pathlib import Path\n",
            f"str(Path(__file__).with_name({origin.name!r}))",
        )
    else:
        imports, code = "", repr(origin)
    values = {
        "name": name,
        "imports": imports,
        "machine": code,
        "description": escape(f"The machine {machine}, run by llfsm"),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=f".{name}-") as made:
            draft = Path(made) / name
            for path, text in _FILES.items():
                file = draft / Template(path).substitute(values)
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(Template(text).substitute(values), encoding="utf-8")
            if isinstance(origin, Path):
                for each in with_inner_bundles(origin):
                    _copy_bundle(each, draft / name / each.name)
            draft.rename(target)
    except (OSError, BundleError) as error:
        raise PackageError(f"{target} cannot be written: {error}") from error
    return target


def with_inner_bundles(folder: Path) -> list[Path]:
    """List a bundle and those beside it that its states run, and so on; raise `BundleError`."""
    found = [folder]
    for each in found:  # which grows
        names = {name for state in read_bundle(each).states for name in state.runs}
        beside = (each.with_name(f"{name}{SUFFIX}") for name in sorted(names))
        found += [inner for inner in beside if inner.is_dir() and inner not in found]
    return found


def _copy_bundle(source: Path, target: Path) -> None:
    """Copy the files of a bundle, which has no folders; leave out an editor's hidden files.

    A link is an error: a bundle from elsewhere could put any file of its reader into the package.
    """
    target.mkdir()
    for file in source.iterdir():
        if file.is_symlink():
            raise PackageError(f"{file} is a link: put the file itself there, or remove it")
        if file.is_file() and not file.name.startswith("."):
            shutil.copyfile(file, target / file.name)
