"""The layout of a draft as text, and what edits of the machine change in it.

The property list keeps the text of everything else: other states, colours, heights of sections.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, TypeAlias

from ..bundles.model import Bundle
from ..bundles.plist import described_path, layout_to_plist, read_layout
from .draft import Draft
from .errors import EditError
from .property_list import PropertyList
from .sketch import automatic, is_placed, path_between, placed_boxes

__all__ = [
    "LAYOUT", "NEW_SIZE", "Path", "change_paths", "check_numbers", "layout_text", "made_layout",
    "number_paths",
]  # fmt: skip

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
    """Return the layout; None if the machine is placed automatically, and nothing is to be kept."""
    data = draft.files.get(LAYOUT)
    return PropertyList(data) if data is not None and is_placed(draft.bundle) else None


def made_layout(draft: Draft) -> tuple[PropertyList, Bundle]:
    """Return the layout and the bundle with it; a new one is of where everything is drawn now."""
    bundle = draft.bundle
    if not is_placed(bundle):
        draft.put(LAYOUT, layout_to_plist(automatic(bundle)))
        bundle = replace(bundle, layout=read_layout(draft.files[LAYOUT], draft.folder / LAYOUT))
    return PropertyList(draft.files[LAYOUT]), bundle


def number_paths(text: PropertyList, bundle: Bundle, state: str, number: int) -> list[Path]:
    """Return the paths of a state's transitions; those up to `number` that have none get one."""
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
