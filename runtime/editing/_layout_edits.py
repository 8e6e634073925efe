"""Edits of where a machine is drawn, which C++ bundles and classes have, too.

The layout is an XML property list. Editors write numbers, indentation and the order of keys in ways
of their own, and keep more in it than we know: reading it and writing it again would change every
line. So the place of each value in the text is found, and only the text of what changes is
replaced (`PropertyList`). The text of a state that was read before, as that of most was, is not
read again.

A machine without a layout is placed automatically. Its first edit writes down where everything is
drawn now, so that nothing else moves.
"""

from __future__ import annotations

import math
import plistlib
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias
from xml.parsers import expat

import msgspec

from llfsm.runtime.bundles.model import Bundle
from llfsm.runtime.bundles.plist import described_path, layout_to_plist, read_layout, split_states
from llfsm.runtime.drawing.editor_layout import moved_path
from llfsm.runtime.editing._draft import Draft
from llfsm.runtime.editing.errors import EditError
from llfsm.runtime.editing.sketch import automatic, is_placed, path_between, placed_boxes
from llfsm.runtime.engine.table import MachineLayout, Point, TransitionPath

_UTF_8 = re.compile(rb"(\xef\xbb\xbf)?<\?xml(?![^>]*encoding=(?![\"']utf-8[\"']))[^>]*\?>", re.I)


@dataclass
class _Place:
    """The place of a value, with its tags, in the text; of a dictionary, those of its keys, too."""

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
        """Check that there is a value at a path."""
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
        """List the texts of an array's values; none if there is no such array."""
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
        """Find a place, and the offset from which it and all inside count."""
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
    """Find all places, state by state; None if the states cannot be read one by one."""
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
    """Find the one key in a text, and its place there."""
    before = b"<plist><dict>"
    root = _places(before + text + b"</dict></plist>")
    _move(root, 0, -len(before))
    [(name, key)] = root.keys.items()
    return name, key


def _places(data: bytes) -> _Place:
    """Find the place of the outermost value, with all places inside."""
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
    """Write a value as plistlib does, indented by so many tabs but for its first line."""
    lines = plistlib.dumps(value, sort_keys=False).split(b"\n")[3:-2]
    return (b"\n" + b"\t" * depth).join(lines)


def _written_key(key: str) -> bytes:
    return _written(key, 0).replace(b"string>", b"key>")


LAYOUT = "Layout.plist"
NEW_SIZE = (100.0, 50.0)
"""Width and height of a new state, as MiEditLLFSM makes it."""
_FARTHEST = 1e6
Path: TypeAlias = "bytes | dict[str, Any]"
"""The path of a transition: its text in the file, or the points of a new one."""


def check_numbers(values: Iterable[float]) -> None:
    """Raise `EditError` for coordinates and sizes with which nothing can be drawn."""
    if not all(math.isfinite(value) and abs(value) <= _FARTHEST for value in values):
        raise EditError(f"a drawing has no place farther than {_FARTHEST:g} from its middle")


def layout_text(draft: Draft) -> PropertyList | None:
    """Read the layout; None if the machine is placed automatically, and nothing is to be kept."""
    data = draft.files.get(LAYOUT)
    return PropertyList(data) if data is not None and is_placed(draft.bundle) else None


def made_layout(draft: Draft) -> tuple[PropertyList, Bundle]:
    """Read the layout, or make one of where everything is drawn now; add the bundle with it."""
    bundle = draft.bundle
    if not is_placed(bundle):
        draft.put(LAYOUT, layout_to_plist(automatic(bundle)))
        bundle = replace(bundle, layout=read_layout(draft.files[LAYOUT], draft.folder / LAYOUT))
    return PropertyList(draft.files[LAYOUT]), bundle


def number_paths(text: PropertyList, bundle: Bundle, state: str, number: int) -> list[Path]:
    """List the paths of a state's transitions; those up to `number` that have none get one."""
    paths: list[Path] = [*text.items("States", state, "Transitions")]
    boxes = {box.state: box for box in placed_boxes(bundle)}
    [source] = [each for each in bundle.states if each.name == state]
    for each in source.transitions[len(paths) : number + 1]:
        paths.append(described_path(path_between(boxes[state], boxes[each.target])))
    return paths


def change_paths(draft: Draft, state: str, change: Callable[[list[Path]], None], most: int) -> None:
    """Change the list of the paths of a state's transitions, if it has any.

    Those up to number `most` then have paths.
    """
    text = layout_text(draft)
    if text is None or not text.items("States", state, "Transitions"):
        return
    paths = number_paths(text, draft.bundle, state, most)
    change(paths)
    text.set_items(("States", state, "Transitions"), paths)
    draft.put(LAYOUT, text.data)


class PlaceStates(msgspec.Struct, frozen=True, tag="place states", tag_field="edit"):
    """Move states, with the ends of their arrows: the centres of their boxes, by name."""

    places: dict[str, Point]

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        check_numbers(value for place in self.places.values() for value in place)
        text, bundle = made_layout(draft)
        boxes = {box.state: box for box in placed_boxes(bundle)}
        moves = {}
        for name, (x, y) in self.places.items():
            box = boxes[draft.state(name).name]
            moves[name] = (x - box.x, y - box.y)
            if not text.has("States", name):
                text.set(("States", name), {"Transitions": []})
            if not text.has("States", name, "w"):
                text.set(("States", name, "w"), box.width)
                text.set(("States", name, "h"), box.height)
            text.set(("States", name, "x"), x)
            text.set(("States", name, "y"), y)
        paths = bundle.layout.transitions if bundle.layout else {}
        for state in bundle.states:
            targets = [each.target for each in state.transitions]
            drawn = zip(paths.get(state.name, ()), targets, strict=False)
            for number, (path, target) in enumerate(drawn):
                ends = moves.get(state.name, (0.0, 0.0)), moves.get(target, (0.0, 0.0))
                _set_path(text, state.name, number, path, moved_path(path, *ends))
        draft.put(LAYOUT, text.data)


class ResizeState(msgspec.Struct, frozen=True, tag="resize state", tag_field="edit"):
    """Set the width and height of a state's box."""

    state: str
    w: float
    h: float

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        check_numbers((self.w, self.h))
        if min(self.w, self.h) < 1:
            raise EditError("a box needs a width and a height")
        _set(draft, self.state, {"w": self.w, "h": self.h})


class ExpandState(msgspec.Struct, frozen=True, tag="expand state", tag_field="edit"):
    """Show a state's sections in its box, or hide them."""

    state: str
    expanded: bool

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        _set(draft, self.state, {"expanded": self.expanded})


class BendTransition(msgspec.Struct, frozen=True, tag="bend transition", tag_field="edit"):
    """Set the curve of a transition: its ends, then its control points."""

    source: str
    number: int
    path: tuple[Point, Point, Point, Point]

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        check_numbers(value for point in self.path for value in point)
        draft.transition(self.source, self.number)
        text, bundle = made_layout(draft)
        if not text.has("States", self.source):
            text.set(("States", self.source), {"Transitions": []})
        paths = number_paths(text, bundle, self.source, self.number)
        paths[self.number] = described_path(TransitionPath(*self.path))
        text.set_items(("States", self.source, "Transitions"), paths)
        draft.put(LAYOUT, text.data)


class ArrangeAgain(msgspec.Struct, frozen=True, tag="arrange again", tag_field="edit"):
    """Place all states and transitions automatically; sizes and colours are kept."""

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        layout, text = automatic(draft.bundle), layout_text(draft)
        if text is None:
            draft.put(LAYOUT, layout_to_plist(layout))
            return
        old = draft.bundle.layout or MachineLayout()
        for name, box in layout.states.items():
            if name not in old.states:
                described = {"x": box.x, "y": box.y, "w": box.w, "h": box.h, "Transitions": []}
                text.set(("States", name), described)
            else:
                text.set(("States", name, "x"), box.x)
                text.set(("States", name, "y"), box.y)
            paths, before = layout.transitions.get(name, ()), old.transitions.get(name, ())
            if len(paths) == len(before) == len(text.items("States", name, "Transitions")):
                for number, (path, was) in enumerate(zip(paths, before, strict=True)):
                    _set_path(text, name, number, was, path)
            else:
                described_paths = [described_path(path) for path in paths]
                text.set_items(("States", name, "Transitions"), described_paths)
        draft.put(LAYOUT, text.data)


LayoutEdit: TypeAlias = ArrangeAgain | BendTransition | ExpandState | PlaceStates | ResizeState


def _set(draft: Draft, state: str, values: dict[str, float | bool]) -> None:
    draft.state(state)
    text, bundle = made_layout(draft)
    if not text.has("States", state, "x"):
        [box] = [each for each in placed_boxes(bundle) if each.state == state]
        PlaceStates({state: (box.x, box.y)}).apply(draft)
        text = layout_text(draft) or text
    for key, value in values.items():
        text.set(("States", state, key), value)
    draft.put(LAYOUT, text.data)


def _set_path(
    text: PropertyList, state: str, number: int, old: TransitionPath, new: TransitionPath
) -> None:
    before = described_path(old)
    for key, value in described_path(new).items():
        if value != before[key]:
            text.set(("States", state, "Transitions", number, key), round(value, 2))
