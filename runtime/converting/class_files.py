"""The files of a machine class: its module, and its layout beside it."""

from __future__ import annotations

import re
import sys
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path

from llfsm.runtime.bundles.plist import read_layout
from llfsm.runtime.bundles.read import read_file
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.machine import Machine
from llfsm.runtime.engine.table import MachineLayout

LAYOUT_SUFFIX = ".layout"


def class_file(cls: type[Machine]) -> Path:
    """Find the file of a class statement; raise `BundleError` if there is none."""
    file = getattr(sys.modules.get(cls.__module__), "__file__", None)
    if file is None or not Path(file).is_file():
        raise BundleError(f"{cls.__name__} is in no file of Python")
    return Path(file).resolve()


def layout_file(cls: type[Machine]) -> Path:
    """Return the file beside a class in which its layout is kept: ``Patrol.layout``."""
    return class_file(cls).with_name(f"{cls.__name__}{LAYOUT_SUFFIX}")


def class_layout(cls: type[Machine]) -> MachineLayout | None:
    """Read the layout that an editor has kept beside a class; None if there is none."""
    if not Path(getattr(sys.modules.get(cls.__module__), "__file__", None) or "").is_file():
        return None
    file = layout_file(cls)
    data = read_file(file)
    return None if data is None else read_layout(data, file)


def module_name(name: str) -> str:
    """Make the name of the module for a class: ``wall_follower`` for WallFollower."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def write_class(name: str, text: str, folder: Path) -> Path:
    """Write the module of a class; return its file.

    Raise `BundleError` if the file exists, would hide another module, or cannot be written.
    """
    module = module_name(name)
    file = folder / f"{module}.py"
    if file.exists():
        raise BundleError("not written: it is there already", file)
    if iskeyword(module) or find_spec(module) is not None or name in ("Machine", "State"):
        raise BundleError(
            f"not written: {module}.py would hide a module of Python or of a library; "
            f"choose another name for {name}"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with file.open("x", encoding="utf-8") as opened:
            opened.write(text)
    except OSError as error:
        raise BundleError(f"not written: {error.strerror}", file) from error
    return file
