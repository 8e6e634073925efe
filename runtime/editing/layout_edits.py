"""Edits of where a machine is drawn; a C++ bundle has these, too."""

from __future__ import annotations

from dataclasses import replace

import msgspec

from ..bundles.plist import described_path, layout_to_plist
from ..engine.layout import MachineLayout, Point, TransitionPath
from .draft import Draft
from .errors import EditError
from .layout_text import LAYOUT, check_numbers, layout_text, made_layout, number_paths
from .property_list import PropertyList
from .sketch import automatic, placed_boxes

__all__ = ["ArrangeAgain", "BendTransition", "ExpandState", "PlaceStates", "ResizeState"]


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
            for number, (path, target) in enumerate(
                zip(paths.get(state.name, ()), targets, strict=False)
            ):
                moved = _moved(path, moves.get(state.name), moves.get(target))
                if moved != path:
                    _set_path(text, state.name, number, path, moved)
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
            text.set(("States", state, "Transitions", number, key), value)


def _moved(path: TransitionPath, source: Point | None, target: Point | None) -> TransitionPath:
    """Move the two halves of a path as its boxes are moved."""

    def by(point: Point, move: Point | None) -> Point:
        return (
            point if move is None else (round(point[0] + move[0], 2), round(point[1] + move[1], 2))
        )

    return replace(
        path,
        src=by(path.src, source),
        control1=by(path.control1, source),
        dst=by(path.dst, target),
        control2=by(path.control2, target),
    )
