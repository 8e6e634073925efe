"""Edits of a machine's texts: sections, expressions, variables and slots, includes, functions."""

from __future__ import annotations

import msgspec

from ..bundles.read import PARTS
from .draft import Draft
from .errors import EditConflictError, EditError

__all__ = ["SetText", "TextPlace", "text_file", "text_of"]

_OF_MACHINE = ("Includes", "Variables", "Methods")


class TextPlace(msgspec.Struct, frozen=True):
    """Which text of a machine: a section or declaration of a state, or an expression.

    Without a state, `part` is Includes, Variables (which declare the slots, too) or Methods of the
    machine. With `number`, it is the expression of that transition.
    """

    part: str
    state: str | None = None
    number: int | None = None


class SetText(msgspec.Struct, frozen=True, tag="set text", tag_field="edit"):
    """Set a text. It must still be `was`; else somebody else has changed it, and it is kept."""

    place: TextPlace
    text: str
    was: str

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        name = text_file(draft, self.place)
        if text_of(draft.files.get(name, b"")) != self.was:
            raise EditConflictError(f"not written: {name} has changed meanwhile; look at it first")
        if self.text != self.was:
            draft.put_text(name, self.text)
            if self.place.state is not None:
                draft.keep_a_file(self.place.state)


def text_file(draft: Draft, place: TextPlace) -> str:
    """Return the name of the file that contains a text, whether it exists or not."""
    if place.state is None:
        if place.part not in _OF_MACHINE or place.number is not None:
            raise EditError(f"a machine has no text {place.part!r}")
        return f"{draft.bundle.name}_{place.part}.py"
    draft.state(place.state)
    if place.number is not None:
        draft.transition(place.state, place.number)
        return f"State_{place.state}_Transition_{place.number}.expr"
    if place.part not in PARTS:
        raise EditError(f"a state has no text {place.part!r}")
    return f"State_{place.state}_{place.part}.py"


def text_of(data: bytes) -> str:
    """Return the text of a file, with lines that end in ``\\n``; a blank one is empty."""
    text = data.decode("utf-8-sig", "replace").replace("\r\n", "\n")
    return text if text.strip() else ""
