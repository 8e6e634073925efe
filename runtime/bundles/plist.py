"""``Layout.plist``: the layout of a machine as the editors of bundles keep it.

An editor that follows a machine's files reads the layout again after each change. Of a list as
editors write it, the text of each state is therefore read alone and remembered, and only those that
are new are parsed. A list that is written otherwise is read as a whole.
"""

from __future__ import annotations

import plistlib
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers.expat import ExpatError

from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.table import MachineLayout, Point, StateBox, TransitionPath

_SIZE = (90.0, 50.0)  # of a state whose size is not given
_KNOWN = ("x", "y", "w", "h", "expanded", "Transitions")
_WRONG = (
    *(plistlib.InvalidFileException, ExpatError),
    *(ValueError, TypeError, IndexError, RecursionError, OverflowError),
)
_POINTS = ("srcPoint", "dstPoint", "controlPoint1", "controlPoint2")


def read_layout(data: bytes, file: Path) -> MachineLayout:
    """Read the layout in `data`, the contents of `file`, without incomplete parts.

    A state without a position has no box. Paths belong to transitions by position, so they end at
    the first that is incomplete. Raise `BundleError` if it is no property list.
    """
    try:
        states = _split_values(data)
        if states is None:
            states = dict(_values(plistlib.loads(data)))
    except _WRONG as error:
        what = f"not a property list: {error}"
        raise BundleError(f"{what}; delete it, and all is placed anew", file) from error
    boxes = {name: each.box for name, each in states.items() if each.box is not None}
    return MachineLayout(boxes, {name: each.paths for name, each in states.items() if each.paths})


def split_states(data: bytes) -> tuple[bytes, list[bytes], bytes] | None:
    """Split a property list: the text before its states, each state's text, and the rest.

    None if it is not written as editors write it. The first and the last together are a property
    list, and each state's text is a key and a value if it can be read as such.
    """
    if b"<!" in data.replace(b"<!DOCTYPE ", b"", 1) or data.count(b"<?") > 1 or b"&#" in data:
        return None  # a comment, for example, may have the text of a state in it
    if data.count(_STATES) != 1 or _OTHER_CODE.match(data):
        return None
    head, *states = data.split(_STATE)
    if not states or not _BEFORE.search(head):
        return None
    states[-1], end, rest = states[-1].partition(_END)
    return head, [_STATE + each for each in states], end + rest


_OTHER_CODE = re.compile(rb"[^>]*<\?xml[^>]*encoding=(?![\"']utf-8[\"'])", re.I)
_STATES = b"<key>States</key>"
_BEFORE = re.compile(_STATES + rb"\s*<dict>$")
_STATE = b"\n\t\t<key>"
_END = b"\n\t</dict>"


class _State(NamedTuple):
    """The box and the paths of a state in a layout."""

    box: StateBox | None
    paths: tuple[TransitionPath, ...]


def _split_values(data: bytes) -> dict[str, _State] | None:
    """Read each state's text on its own, as most are as they were before; None if that fails."""
    split = split_states(data)
    if split is None:
        return None
    head, texts, rest = split
    try:
        if plistlib.loads(head + rest).get("States") != {}:
            return None
        return dict(map(_read_state, texts))
    except _WRONG:
        return None


@lru_cache(maxsize=4096)
def _read_state(text: bytes) -> tuple[str, _State]:
    [state] = _values({"States": plistlib.loads(b"<plist><dict>" + text + b"</dict></plist>")})
    return state


def _values(found: Any) -> Iterator[tuple[str, _State]]:
    states = found.get("States", {}) if isinstance(found, dict) else {}
    for name, state in states.items() if isinstance(states, dict) else ():
        if not isinstance(state, dict):
            continue
        box = None
        x, y, w, h = (_number(state, key) for key in "xywh")
        if x is not None and y is not None:
            w, h = _SIZE[0] if w is None else w, _SIZE[1] if h is None else h
            more = {key: value for key, value in state.items() if key not in _KNOWN}
            box = StateBox(x, y, w, h, bool(state.get("expanded", False)), more)
        drawn = state.get("Transitions")
        yield name, _State(box, _paths(drawn if isinstance(drawn, list) else []))


def layout_to_plist(layout: MachineLayout) -> bytes:
    """Write the property list that `read_layout` reads as `layout`."""
    states: dict[str, dict[str, Any]] = {}
    for name in {**layout.states, **layout.transitions}:
        states[name] = {
            "Transitions": [described_path(path) for path in layout.transitions.get(name, ())]
        }
        if box := layout.states.get(name):
            states[name] |= dict(box.more) | {
                "x": box.x, "y": box.y, "w": box.w, "h": box.h, "expanded": box.expanded
            }  # fmt: skip
    return plistlib.dumps({"States": states, "Version": "1.3"}, sort_keys=False)


def _paths(drawn: list[Any]) -> tuple[TransitionPath, ...]:
    paths = []
    for path in drawn:
        points = [_point(path, key) for key in _POINTS] if isinstance(path, dict) else [None]
        src, *others = points
        if src is None or None in others:
            break
        paths.append(TransitionPath(src, *(point for point in others if point is not None)))
    return tuple(paths)


def _point(path: Mapping[str, Any], key: str) -> Point | None:
    x, y = _number(path, f"{key}X"), _number(path, f"{key}Y")
    return None if x is None or y is None else (x, y)


def _number(values: Mapping[str, Any], key: str) -> float | None:
    value = values.get(key)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number else None  # type: ignore[arg-type]


def described_path(path: TransitionPath) -> dict[str, float]:
    """Describe a transition's path as property lists do."""
    points = zip(_POINTS, (path.src, path.dst, path.control1, path.control2), strict=True)
    return {
        f"{key}{axis}": value
        for key, point in points
        for axis, value in zip("XY", point, strict=True)
    }
