"""``Layout.plist``: the layout of a machine as the editors of bundles keep it."""

from __future__ import annotations

import plistlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

from ..engine.errors import BundleError
from ..engine.layout import MachineLayout, Point, StateBox, TransitionPath
from .files import read_file

__all__ = ["layout_to_plist", "read_layout"]

_SIZE = (90.0, 50.0)  # of a state whose size is not given
_KNOWN = ("x", "y", "w", "h", "expanded", "Transitions")
_WRONG = (
    *(plistlib.InvalidFileException, ExpatError),
    *(ValueError, TypeError, IndexError, RecursionError, OverflowError),
)
_POINTS = ("srcPoint", "dstPoint", "controlPoint1", "controlPoint2")


def read_layout(file: Path) -> MachineLayout | None:
    """Return the layout in `file`, without incomplete parts; None without a file.

    Raise `BundleError`.

    A state without a position has no box. Paths belong to transitions by position, so they end at
    the first that is incomplete.
    """
    data = read_file(file)
    if data is None:
        return None
    try:
        found = plistlib.loads(data)
    except _WRONG as error:
        raise BundleError(f"not a property list: {error}", file) from error
    boxes: dict[str, StateBox] = {}
    paths: dict[str, tuple[TransitionPath, ...]] = {}
    states = found.get("States", {}) if isinstance(found, dict) else {}
    for name, state in states.items() if isinstance(states, dict) else ():
        if not isinstance(state, dict):
            continue
        x, y, w, h = (_number(state, key) for key in "xywh")
        if x is not None and y is not None:
            w, h = _SIZE[0] if w is None else w, _SIZE[1] if h is None else h
            more = {key: value for key, value in state.items() if key not in _KNOWN}
            boxes[name] = StateBox(x, y, w, h, bool(state.get("expanded", False)), more)
        drawn = state.get("Transitions")
        if path := _paths(drawn if isinstance(drawn, list) else []):
            paths[name] = path
    return MachineLayout(boxes, paths)


def layout_to_plist(layout: MachineLayout) -> bytes:
    """Return the property list that `read_layout` reads as `layout`."""
    states: dict[str, dict[str, Any]] = {}
    for name in {**layout.states, **layout.transitions}:
        states[name] = {
            "Transitions": [_described(path) for path in layout.transitions.get(name, ())]
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


def _described(path: TransitionPath) -> dict[str, float]:
    points = zip(_POINTS, (path.src, path.dst, path.control1, path.control2), strict=True)
    return {
        f"{key}{axis}": value
        for key, point in points
        for axis, value in zip("XY", point, strict=True)
    }
