"""Edits of a machine's transitions; their numbers, which are their order, are in file names."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from ..bundles.plist import described_path
from .draft import Draft
from .layout_text import Path, change_paths
from .sketch import path_between, placed_boxes

__all__ = ["AddTransition", "DeleteTransition", "OrderTransition", "RetargetTransition"]

_ENDINGS = ("target", "expr")


class AddTransition(msgspec.Struct, frozen=True, tag="add transition", tag_field="edit"):
    """Add a transition behind the others of its state; without an expression it always fires."""

    source: str
    target: str
    expression: str = ""

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        number = len(draft.state(self.source).transitions)
        stem = f"State_{self.source}_Transition_{number}"
        draft.put_name(f"{stem}.target", draft.state(self.target).name)
        if self.expression.strip():
            draft.put_text(f"{stem}.expr", self.expression.rstrip("\n") + "\n")


class RetargetTransition(msgspec.Struct, frozen=True, tag="retarget transition", tag_field="edit"):
    """Let a transition lead to another state."""

    source: str
    number: int
    target: str

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        draft.transition(self.source, self.number)
        target = draft.state(self.target).name
        draft.put_name(f"State_{self.source}_Transition_{self.number}.target", target)

        def redraw(paths: list[Path]) -> None:
            if self.number < len(paths):
                boxes = {box.state: box for box in placed_boxes(draft.bundle)}
                paths[self.number] = described_path(path_between(boxes[self.source], boxes[target]))

        change_paths(draft, self.source, redraw, -1)


class OrderTransition(msgspec.Struct, frozen=True, tag="order transition", tag_field="edit"):
    """Evaluate a transition at another place among those of its state."""

    source: str
    number: int
    to: int

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        draft.transition(self.source, self.number)
        draft.transition(self.source, self.to)
        order = list(range(len(draft.state(self.source).transitions)))
        order.insert(self.to, order.pop(self.number))
        _renumber(draft, self.source, order)
        change_paths(
            draft,
            self.source,
            lambda paths: paths.insert(self.to, paths.pop(self.number)),
            max(self.number, self.to),
        )


class DeleteTransition(msgspec.Struct, frozen=True, tag="delete transition", tag_field="edit"):
    """Delete a transition; those behind it move up."""

    source: str
    number: int

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        draft.transition(self.source, self.number)
        numbers = range(len(draft.state(self.source).transitions))
        _renumber(draft, self.source, [number for number in numbers if number != self.number])
        change_paths(draft, self.source, lambda paths: _delete(paths, self.number), -1)
        draft.keep_a_file(self.source)


def _delete(paths: list[Path], number: int) -> None:
    del paths[number : number + 1]


def _renumber(draft: Draft, state: str, order: Sequence[int]) -> None:
    """Give the transitions' files new numbers: the first number of `order` becomes 0."""
    stem = f"State_{state}_Transition_"
    count = len(draft.state(state).transitions)
    old = {(n, end): draft.files.get(f"{stem}{n}.{end}") for n in range(count) for end in _ENDINGS}
    for new in range(count):
        for end in _ENDINGS:
            data = old[order[new], end] if new < len(order) else None
            draft.put(f"{stem}{new}.{end}", data)
