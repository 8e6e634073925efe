"""The places where definitions are searched, in this order.

1. the texts, then the places that the library was given;
2. ``share`` of each folder in AMENT_PREFIX_PATH, which a sourced ROS 2 environment sets;
3. the definitions that ship with llfsm;
4. those of rosbags, if it is installed: the messages of a desktop installation of ROS 2 Jazzy. They
   have no defaults and no services. Where that matters, ours has a definition of its own.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from llfsm.bridges.ros2.errors import DefinitionPathError, DefinitionSyntaxError, UnknownTypeError
from llfsm.bridges.ros2.types.definition import TYPE_NAME, Definition, parse, unbundled

_SHIPPED = Path(__file__).parents[1] / "definitions"


class SearchPath:
    """Finds definitions by name and keeps those found.

    A place is a folder of packages (``/opt/ros/jazzy/share``, a workspace's ``src``), one package,
    or one file. In all of them a type is ``package/msg/Type.msg``, likewise ``srv`` and
    ``action``. Raise :class:`.DefinitionPathError` if a place is not there.
    """

    def __init__(
        self, given: Iterable[Path], texts: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self._texts = texts
        self._places = [Path(place).absolute() for place in given]
        for place in self._places:
            if not place.exists():
                raise DefinitionPathError(f"{place}: no such folder or file of definitions")
        ament = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        self._places += [Path(prefix, "share") for prefix in ament if prefix]
        self._places.append(_SHIPPED)
        self._found: dict[str, Definition] = {}

    def find(self, name: str) -> Definition:
        """Find the definition of a full name, as ``turtlesim/srv/Spawn_Request``.

        Raise :class:`.UnknownTypeError` or :class:`.DefinitionSyntaxError`.
        """
        if name not in self._found:
            self._look_for(name)
        return self._found[name]

    def source(self, name: str) -> tuple[str, str]:
        """Find the text that defines a type, and its encoding, as in ROS's type sources.

        A part of a service or action is ``implicit``, without a text of its own. What only rosbags
        knows is written out by it. Raise as :meth:`find`.
        """
        self.find(name)
        package, kind, base = name.split("/")
        if "_" in base:
            return "implicit", ""
        return kind, self._text(name, self._path(package, kind, base)) or ""

    def names(self) -> list[str]:
        """List the names of all types that can be found."""
        return sorted({*self._texts, *self._names(), *jazzy_names()})

    def _look_for(self, name: str) -> None:
        match = TYPE_NAME.fullmatch(name)
        if match is None or (match[2] == "msg" and match[4]):
            raise UnknownTypeError(
                f"{name!r} is not a type name such as geometry_msgs/msg/Twist{self._near(name)}"
            )
        package, kind, base, _ = match.groups()
        path = self._path(package, kind, base)
        text = self._text(name, path)
        where = name if path is None or name in self._texts else str(path)
        made = {} if text is None else parse(text, f"{package}/{kind}/{base}", where)
        if name not in made:
            raise UnknownTypeError(f"{name}: {self._reason(path)}{self._near(name)}")
        self._found.update(made)

    def _text(self, name: str, path: Path | None) -> str | None:
        if name in self._texts:
            return self._texts[name]
        return jazzy_text(name) if path is None else _text(path)

    def _path(self, package: str, kind: str, base: str) -> Path | None:
        file = f"{base}.{kind}"
        for place in self._places:
            if place.parts[-3:] == (package, kind, file):
                return place
            for folder in (place / package, *([place] if place.name == package else [])):
                if (folder / kind / file).is_file():
                    return folder / kind / file
        return None

    def _reason(self, path: Path | None) -> str:
        if path is not None:
            return f"{path} defines no such part"
        where = ", ".join(map(str, self._places))
        rosbags = "" if jazzy_names() else "; install llfsm[ros] for ROS 2's common types"
        return f"no definition in {where}, nor in rosbags{rosbags}"

    def _near(self, name: str) -> str:
        known = self.names()
        package, _, last = name.rpartition("/")
        if f"{package}/msg/{last}" in known:
            return f"; did you mean {package}/msg/{last}?"
        near = difflib.get_close_matches(name, known, 3) or [
            one for one in known if one.endswith(f"/{last}")
        ]
        return f"; did you mean {' or '.join(near[:3])}?" if near else ""

    def _names(self) -> Iterator[str]:
        for place in self._places:
            files = [place] if place.is_file() else [*place.glob("*/*/*"), *place.glob("*/*")]
            for file in files:
                package, kind = file.parts[-3:-1]
                if file.suffix == f".{kind}":
                    yield f"{package}/{kind}/{file.stem}"


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DefinitionSyntaxError(f"{path}: cannot be read: {error}") from error


def jazzy_text(name: str) -> str | None:
    """Write the .msg of a message of rosbags; None if it does not have it or is not installed."""
    if name not in jazzy_names():
        return None
    text, _ = _rosbags().generate_msgdef(name, ros_version=2)
    return unbundled(name, text)[name]


def jazzy_names() -> list[str]:
    """List the messages of rosbags; none if it is not installed."""
    store = _rosbags()
    return [] if store is None else list(store.fielddefs)


@cache
def _rosbags() -> Any:
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        return None
    return get_typestore(Stores.ROS2_JAZZY)
