"""Edits of a machine's states."""

from __future__ import annotations

import msgspec

from .draft import Draft
from .errors import EditError
from .layout_text import LAYOUT, NEW_SIZE, check_numbers, layout_text, made_layout
from .named_states import rename_in_texts
from .transition_edits import DeleteTransition

__all__ = ["AddState", "DeleteState", "OrderState", "RenameState", "SetSuspendState"]


class AddState(msgspec.Struct, frozen=True, tag="add state", tag_field="edit"):
    """Add a state behind the others, with its box around (x, y)."""

    state: str
    x: float
    y: float

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        draft.check_new_state(self.state)
        check_numbers((self.x, self.y))
        text, _ = made_layout(draft)
        w, h = NEW_SIZE
        box = {"x": self.x, "y": self.y, "w": w, "h": h, "expanded": False, "Transitions": []}
        text.set(("States", self.state), box)
        draft.put(LAYOUT, text.data)
        _set_states(draft, [*_names(draft), self.state])
        draft.keep_a_file(self.state)


class RenameState(msgspec.Struct, frozen=True, tag="rename state", tag_field="edit"):
    """Give a state another name: in its files, in targets, in the layout, and where code has it."""

    state: str
    to: str

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        draft.state(self.state)
        draft.check_new_state(self.to)
        own = draft.files_of(self.state)
        rename_in_texts(draft, self.state, self.to)
        for each in draft.bundle.states:
            for number, transition in enumerate(each.transitions):
                if transition.target == self.state:
                    draft.put_name(f"State_{each.name}_Transition_{number}.target", self.to)
        if draft.bundle.suspend == self.state:
            draft.put_name("SuspendState", self.to)
        stem, new = f"State_{self.state}", f"State_{self.to}"
        for name in own:
            draft.put(new + name.removeprefix(stem), draft.files[name])
            draft.put(name, None)
        _set_states(draft, [self.to if name == self.state else name for name in _names(draft)])
        text = layout_text(draft)
        if text is not None and text.has("States", self.state):
            if text.has("States", self.to):
                text.remove("States", self.to)  # left of an earlier state
            text.rename(("States", self.state), self.to)
            draft.put(LAYOUT, text.data)


class DeleteState(msgspec.Struct, frozen=True, tag="delete state", tag_field="edit"):
    """Delete a state with its files, and the transitions that lead to it."""

    state: str

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        draft.state(self.state)
        if len(draft.bundle.states) == 1:
            raise EditError("a machine needs a state")
        for each in draft.bundle.states:
            leading = [n for n, t in enumerate(each.transitions) if t.target == self.state]
            for number in reversed(leading if each.name != self.state else []):
                DeleteTransition(each.name, number).apply(draft)
                draft.reread()
        for name in draft.files_of(self.state):
            draft.put(name, None)
        if draft.bundle.suspend == self.state:
            draft.put("SuspendState", None)
        text = layout_text(draft)
        if text is not None and text.has("States", self.state):
            text.remove("States", self.state)
            draft.put(LAYOUT, text.data)
        _set_states(draft, [name for name in _names(draft) if name != self.state])


class OrderState(msgspec.Struct, frozen=True, tag="order state", tag_field="edit"):
    """Move a state to another place in the list; at place 0 it is the initial state."""

    state: str
    to: int

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        draft.state(self.state)
        names = [name for name in _names(draft) if name != self.state]
        if not 0 <= self.to <= len(names):
            raise EditError(f"there is no place {self.to} in a list of {len(names) + 1} states")
        names.insert(self.to, self.state)
        _set_states(draft, names)


class SetSuspendState(msgspec.Struct, frozen=True, tag="set suspend state", tag_field="edit"):
    """Make a state the suspend state, or let there be none."""

    state: str | None

    def apply(self, draft: Draft) -> None:
        """Make the edit in a draft."""
        draft.require_python()
        if self.state is None:
            draft.put("SuspendState", None)
        else:
            draft.put_name("SuspendState", draft.state(self.state).name)


def _names(draft: Draft) -> list[str]:
    return [state.name for state in draft.bundle.states]


def _set_states(draft: Draft, names: list[str]) -> None:
    """List the states; a missing end of the last line stays missing, and the ends as they are."""
    old = draft.files["States"]
    text = "".join(f"{name}\n" for name in names)
    draft.put_text("States", text if old.rstrip(b" \t").endswith(b"\n") else text[:-1])
