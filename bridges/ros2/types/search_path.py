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
from typing import Any, cast

from llfsm.bridges.ros2.errors import DefinitionPathError, DefinitionSyntaxError, UnknownTypeError
from llfsm.bridges.ros2.types.definition import (
    EMPTY_MEMBER,
    TYPE_NAME,
    Constant,
    Definition,
    Field,
    FieldType,
    Shape,
    definition_text,
    parse,
)

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
        knows is written out from its fields. Raise as :meth:`find`.
        """
        definition = self.find(name)
        package, kind, base = name.split("/")
        if "_" in base:
            return "implicit", ""
        if name in self._texts:
            return kind, self._texts[name]
        path = self._path(package, kind, base)
        return kind, _text(path) if path is not None else definition_text(definition)

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
        if name in self._texts:
            made = parse(self._texts[name], name, name)
        elif path is not None:
            made = parse(_text(path), f"{package}/{kind}/{base}", str(path))
        else:
            known = jazzy_definition(name)
            made = {} if known is None else {name: known}
        if name not in made:
            raise UnknownTypeError(f"{name}: {self._reason(path)}{self._near(name)}")
        self._found.update(made)

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


_SHAPES = {3: Shape.ARRAY, 4: Shape.SEQUENCE}  # as rosbags numbers them


def jazzy_definition(name: str) -> Definition | None:
    """Find a message of rosbags; None if it does not have it or is not installed."""
    entry = _rosbags().get(name)
    if entry is None:
        return None
    constants, fields = entry
    return Definition(
        name,
        tuple(Field(n, _rosbags_type(kind)) for n, kind in fields if n != EMPTY_MEMBER),
        tuple(Constant(n, value, kind) for n, kind, value in constants),
    )


def jazzy_names() -> list[str]:
    """List the messages of rosbags; none if it is not installed."""
    return list(_rosbags())


@cache
def _rosbags() -> dict[str, tuple[Any, Any]]:
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        return {}
    return cast("dict[str, tuple[Any, Any]]", get_typestore(Stores.ROS2_JAZZY).fielddefs)


def _rosbags_type(entry: tuple[int, Any]) -> FieldType:
    kind, inner = entry
    if kind == 1:
        return FieldType(inner[0], bound=inner[1])
    if kind == 2:
        return FieldType(inner)
    item, size = inner
    shape = Shape.BOUNDED if kind == 4 and size else _SHAPES[kind]
    single = _rosbags_type(item)
    return FieldType(single.base, shape, size, single.bound)
