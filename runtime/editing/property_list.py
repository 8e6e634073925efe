"""The text of an XML property list, changed at the values that are set and nowhere else.

Editors write numbers, indentation and the order of keys in ways of their own. Reading such a file
and writing it again would change every line of it. Here the place of each value in the text is
found instead, and only the text of what changes is replaced. The text of a state that was read
before, as that of most states was, is not read again.
"""

from __future__ import annotations

import plistlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple
from xml.parsers import expat

from ..bundles.plist import split_states
from .errors import EditError

__all__ = ["PropertyList"]

_UTF_8 = re.compile(rb"(\xef\xbb\xbf)?<\?xml(?![^>]*encoding=(?![\"']utf-8[\"']))[^>]*\?>", re.I)


@dataclass
class _Place:
    """Where a value, with its tags, is in the text; of a dictionary, where its keys are, too."""

    tag: str
    start: int
    end: int = 0
    inside: int = 0  # where the closing tag begins; `start` if there is none
    keys: dict[str, _Key] = field(default_factory=dict)
    items: list[_Place] = field(default_factory=list)


class _Key(NamedTuple):
    """A key of a dictionary and its value, at `base` of what the dictionary is in."""

    start: int
    end: int
    value: _Place
    base: int = 0


class PropertyList:
    """A property list whose values are addressed by paths of keys, and of numbers in arrays.

    Changes are collected, and made by `data` at once. Raise `EditError` for a path that leads
    nowhere. The data must have been read with plistlib, which refuses what expat should not see.
    """

    def __init__(self, data: bytes):
        if not _UTF_8.match(data):
            data = plistlib.dumps(plistlib.loads(data), sort_keys=False)
        self._read(data)

    def _read(self, data: bytes) -> None:
        self._text = data
        self._root = _places_by_state(data) or _places(data)
        self._changes: list[tuple[int, int, bytes]] = []

    def has(self, *path: str | int) -> bool:
        """Return whether there is a value."""
        try:
            self._find(path)
        except EditError:
            return False
        return True

    def set(self, path: Sequence[str | int], value: Any) -> None:
        """Set one value, or add it behind the others of its dictionary, which must exist.

        A value of bytes is the text of one.
        """
        text = value if isinstance(value, bytes) else _written(value, len(path))
        *parents, key = path
        parent, base = self._find(parents)
        if isinstance(key, int) or key in parent.keys:
            self._replace(*self._find(path), text)
        elif parent.tag != "dict":
            raise _nowhere(path)
        else:
            tabs = b"\n" + b"\t" * len(path)
            self._insert(parent, base, tabs + _written_key(key) + tabs + text, len(parents))

    def remove(self, *path: str) -> None:
        """Remove a key and its value."""
        *parents, key = path
        parent, base = self._find(parents)
        there = parent.keys[key]
        base += there.base
        before = self._text[: base + there.start]
        self._changes.append((len(before.rstrip(b" \t\r\n")), base + there.value.end, b""))

    def rename(self, path: Sequence[str], key: str) -> None:
        """Give a value another key, in its place."""
        *parents, old = path
        parent, base = self._find(parents)
        there = parent.keys[old]
        base += there.base
        self._changes.append((base + there.start, base + there.end, _written_key(key)))

    def items(self, *path: str) -> list[bytes]:
        """Return the texts of an array's values; none if there is no such array."""
        if not self.has(*path):
            return []
        place, base = self._find(path)
        return [self._text[base + each.start : base + each.end] for each in place.items]

    def set_items(self, path: Sequence[str], items: Sequence[bytes | dict[str, Any]]) -> None:
        """Set an array; what it has in common with the old one keeps its text."""
        if list(items) == self.items(*path) and self.has(*path):
            return
        depth = len(path)
        tabs = b"\n" + b"\t" * (depth + 1)
        texts = [each if isinstance(each, bytes) else _written(each, depth + 1) for each in items]
        inside = b"".join(tabs + each for each in texts)
        end = b"\n" + b"\t" * depth + b"</array>"
        self.set(path, b"<array>" + inside + end if items else b"<array/>")

    @property
    def data(self) -> bytes:
        """The text with all changes."""
        text, rest = b"", 0
        for start, end, new in sorted(self._changes, key=lambda each: each[:2]):
            text += self._text[rest:start] + new
            rest = end
        return text + self._text[rest:]

    def _insert(self, parent: _Place, base: int, text: bytes, depth: int) -> None:
        """Add text behind the last value of a dictionary."""
        if parent.keys:
            last = base + max(key.base + key.value.end for key in parent.keys.values())
            self._changes.append((last, last, text))
        else:
            whole = b"<dict>" + text + b"\n" + b"\t" * depth + b"</dict>"
            self._replace(parent, base, whole)
        self._read(self.data)  # what is set next may be inside

    def _replace(self, place: _Place, base: int, text: bytes) -> None:
        self._changes.append((base + place.start, base + place.end, text))

    def _find(self, path: Sequence[str | int]) -> tuple[_Place, int]:
        """Return a place, and what it and all inside count from."""
        place, base = self._root, 0
        for each in path:
            if isinstance(each, int):
                if not 0 <= each < len(place.items):
                    raise _nowhere(path)
                place = place.items[each]
            else:
                if each not in place.keys:
                    raise _nowhere(path)
                key = place.keys[each]
                place, base = key.value, base + key.base
        return place, base


def _nowhere(path: Sequence[str | int]) -> EditError:
    where = " > ".join(map(str, path))
    return EditError(
        f"the layout has nothing at {where}, or what no editor writes; arrange it again"
    )


def _places_by_state(data: bytes) -> _Place | None:
    """Return the place of the outermost value; None if the states cannot be read one by one."""
    split = split_states(data)
    if split is None:
        return None
    head, texts, rest = split
    root = _places(head + rest)
    listed = root.keys.get("States")
    if listed is None or not listed.value.start < len(head) <= listed.value.inside:
        return None
    base = len(head)
    states: dict[str, _Key] = {}
    try:
        for text in texts:
            name, key = _place_of_state(text)
            states[name] = key._replace(base=base)
            base += len(text)
    except (expat.ExpatError, ValueError):
        return None
    _move(root, len(head), base - len(head))
    listed.value.keys = states
    return root


def _move(place: _Place, start: int, by: int) -> None:
    """Move what is behind `start`."""
    place.start += by if place.start >= start else 0
    place.inside += by if place.inside >= start else 0
    place.end += by if place.end >= start else 0
    for name, key in place.keys.items():
        if key.start >= start:
            place.keys[name] = key._replace(start=key.start + by, end=key.end + by)
        _move(key.value, start, by)
    for each in place.items:
        _move(each, start, by)


@lru_cache(maxsize=4096)
def _place_of_state(text: bytes) -> tuple[str, _Key]:
    """Return the one key in a text, and its place there."""
    before = b"<plist><dict>"
    root = _places(before + text + b"</dict></plist>")
    _move(root, 0, -len(before))
    [(name, key)] = root.keys.items()
    return name, key


def _places(data: bytes) -> _Place:
    """Return the place of the outermost value."""
    parser = expat.ParserCreate()
    parser.buffer_text = True
    open_: list[_Place] = []
    keys: list[tuple[str, int, int]] = []  # the key before each open value
    words: list[str] = []
    root = _Place("plist", 0)

    def start(tag: str, _: dict[str, str]) -> None:
        open_.append(_Place(tag, parser.CurrentByteIndex))
        words.clear()

    def end(tag: str) -> None:
        place = open_.pop()
        opening_end = data.index(b">", place.start) + 1
        is_empty = data[opening_end - 2 : opening_end] == b"/>"
        place.inside = place.start if is_empty else parser.CurrentByteIndex
        place.end = data.index(b">", place.inside) + 1
        parent = open_[-1] if open_ else root
        if tag == "key":
            keys.append(("".join(words), place.start, place.end))
        elif parent.tag == "dict":
            name, key_start, key_end = keys.pop()
            parent.keys[name] = _Key(key_start, key_end, place)
        else:
            parent.items.append(place)

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = words.append
    parser.Parse(data, True)
    return root.items[0].items[0]  # inside <plist>


def _written(value: Any, depth: int) -> bytes:
    """Return a value as plistlib writes it, indented by so many tabs but for its first line."""
    lines = plistlib.dumps(value, sort_keys=False).split(b"\n")[3:-2]
    return (b"\n" + b"\t" * depth).join(lines)


def _written_key(key: str) -> bytes:
    return _written(key, 0).replace(b"string>", b"key>")
