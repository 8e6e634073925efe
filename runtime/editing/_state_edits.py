"""Edits of a machine's states and transitions: of their files, and of all that names them.

A state's name is in the names of its files, in targets, in the layout, and in code that compares
`state_name` with it. A transition's number, which is its order, is in the names of its files and in
the layout's list of paths. An edit changes all of these, so that each leaves a bundle that can be
read.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Sequence
from operator import delitem
from typing import TypeAlias

from llfsm.runtime.bundles.code import parse_run
from llfsm.runtime.bundles.model import RUNS, Fragment
from llfsm.runtime.bundles.plist import described_path
from llfsm.runtime.bundles.read import HISTORY, NOT_FINAL
from llfsm.runtime.converting.edited_text import EditedText
from llfsm.runtime.editing._draft import CodeEdit, Draft
from llfsm.runtime.editing._layout_edits import (
    LAYOUT,
    NEW_SIZE,
    Path,
    change_paths,
    check_numbers,
    layout_text,
    made_layout,
)
from llfsm.runtime.editing.errors import EditError
from llfsm.runtime.editing.sketch import path_between, placed_boxes
from llfsm.runtime.editing.text_edits import text_of
from llfsm.runtime.engine.errors import BundleError

_VARIABLE = "state_name"


def rename_in_texts(draft: Draft, old: str, new: str) -> None:
    """Let the texts of a machine compare `state_name` with another name; all else stays."""
    found = [name for name, data in draft.files.items() if _may_name(name, data, old)]
    if not found:
        return
    own = {f"{draft.bundle.name}_Methods.py"}.union(
        *(draft.files_of(state.name) for state in draft.bundle.states)
    )
    for name in own.intersection(found):
        draft.put_text(name, _renamed(text_of(draft.files[name]), old, new))


def _may_name(file: str, data: bytes, state: str) -> bool:
    return file.endswith((".py", ".expr")) and _VARIABLE.encode() in data and state.encode() in data


def _renamed(text: str, old: str, new: str) -> str:
    shift = len(text) - len(text.lstrip(" \t"))  # of an expression
    try:
        tree = ast.parse(text[shift:])
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return text
    edited = EditedText(text[shift:])
    for node in _compared(tree):
        if node.value == old:
            start, end = edited.start(node), edited.end(node)
            written = edited.text(start, end)
            if written[1:-1] == old:
                edited.replace(start, end, f"{written[0]}{new}{written[-1]}")
    return text[:shift] + edited.text()


def _compared(tree: ast.AST) -> Iterator[ast.Constant]:
    """Give the constants with which the name of the state is compared."""
    for node in ast.walk(tree):
        match node:
            case ast.Compare(ast.Name(name), comparators=others) if name == _VARIABLE:
                yield from _constants(others)
            case ast.Compare(ast.Constant() as one, comparators=[ast.Name(name)]):
                if name == _VARIABLE:
                    yield one
            case ast.Match(ast.Name(name), cases) if name == _VARIABLE:
                yield from _constants(each.pattern for each in cases)


def _constants(nodes: Iterable[ast.AST]) -> Iterator[ast.Constant]:
    """Give the constants in nodes, and in the tuples and patterns that these are."""
    for each in nodes:
        if isinstance(each, ast.Constant):
            yield each
        elif isinstance(each, ast.Tuple | ast.List | ast.Set | ast.MatchValue | ast.MatchOr):
            yield from _constants(ast.iter_child_nodes(each))


_ENDINGS = ("target", "expr")


class AddTransition(CodeEdit, frozen=True, tag="add transition"):
    """Add a transition behind the others of its state; without an expression it always fires."""

    source: str
    target: str
    expression: str = ""

    def _change(self, draft: Draft) -> None:
        number = len(draft.state(self.source).transitions)
        stem = f"State_{self.source}_Transition_{number}"
        draft.put_name(f"{stem}.target", draft.state(self.target).name)
        if self.expression.strip():
            draft.put_text(f"{stem}.expr", self.expression.rstrip("\n") + "\n")


class RetargetTransition(CodeEdit, frozen=True, tag="retarget transition"):
    """Let a transition lead to another state."""

    source: str
    number: int
    target: str

    def _change(self, draft: Draft) -> None:
        draft.transition(self.source, self.number)
        target = draft.state(self.target).name
        draft.put_name(f"State_{self.source}_Transition_{self.number}.target", target)

        def redraw(paths: list[Path]) -> None:
            if self.number < len(paths):
                boxes = {box.state: box for box in placed_boxes(draft.bundle)}
                paths[self.number] = described_path(path_between(boxes[self.source], boxes[target]))

        change_paths(draft, self.source, redraw, -1)


class OrderTransition(CodeEdit, frozen=True, tag="order transition"):
    """Evaluate a transition at another place among those of its state."""

    source: str
    number: int
    to: int

    def _change(self, draft: Draft) -> None:
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


class DeleteTransition(CodeEdit, frozen=True, tag="delete transition"):
    """Delete a transition; those behind it move up."""

    source: str
    number: int

    def _change(self, draft: Draft) -> None:
        draft.transition(self.source, self.number)
        numbers = range(len(draft.state(self.source).transitions))
        _renumber(draft, self.source, [number for number in numbers if number != self.number])
        place = slice(self.number, self.number + 1)  # which has a path, perhaps
        change_paths(draft, self.source, lambda paths: delitem(paths, place), -1)
        draft.keep_a_file(self.source)


def _renumber(draft: Draft, state: str, order: Sequence[int]) -> None:
    """Give the transitions' files new numbers: the first number of `order` becomes 0."""
    stem = f"State_{state}_Transition_"
    count = len(draft.state(state).transitions)
    old = {(n, end): draft.files.get(f"{stem}{n}.{end}") for n in range(count) for end in _ENDINGS}
    for new in range(count):
        for end in _ENDINGS:
            data = old[order[new], end] if new < len(order) else None
            draft.put(f"{stem}{new}.{end}", data)


class AddState(CodeEdit, frozen=True, tag="add state"):
    """Add a state behind the others, with its box around (x, y)."""

    state: str
    x: float
    y: float

    def _change(self, draft: Draft) -> None:
        draft.check_new_state(self.state)
        check_numbers((self.x, self.y))
        text, _ = made_layout(draft)
        w, h = NEW_SIZE
        box = {"x": self.x, "y": self.y, "w": w, "h": h, "expanded": False, "Transitions": []}
        text.set(("States", self.state), box)
        draft.put(LAYOUT, text.data)
        _set_states(draft, [*_names(draft), self.state])
        draft.keep_a_file(self.state)


class RenameState(CodeEdit, frozen=True, tag="rename state"):
    """Give a state another name: in its files, in targets, in the layout, and where code has it."""

    state: str
    to: str

    def _change(self, draft: Draft) -> None:
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


class DeleteState(CodeEdit, frozen=True, tag="delete state"):
    """Delete a state with its files, and the transitions that lead to it."""

    state: str

    def _change(self, draft: Draft) -> None:
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


class OrderState(CodeEdit, frozen=True, tag="order state"):
    """Move a state to another place in the list; at place 0 it is the initial state."""

    state: str
    to: int

    def _change(self, draft: Draft) -> None:
        draft.state(self.state)
        names = [name for name in _names(draft) if name != self.state]
        if not 0 <= self.to <= len(names):
            raise EditError(f"there is no place {self.to} in a list of {len(names) + 1} states")
        names.insert(self.to, self.state)
        _set_states(draft, names)


class SetSuspendState(CodeEdit, frozen=True, tag="set suspend state"):
    """Make a state the suspend state, or let there be none."""

    state: str | None

    def _change(self, draft: Draft) -> None:
        if self.state is None:
            draft.put("SuspendState", None)
        else:
            draft.put_name("SuspendState", draft.state(self.state).name)


class SetFinal(CodeEdit, frozen=True, tag="set final"):
    """Let a machine end in a state that has no transitions, or go on there."""

    state: str
    final: bool

    def _change(self, draft: Draft) -> None:
        name = f"State_{draft.state(self.state).name}_{NOT_FINAL}"
        draft.put(name, None if self.final else b"\n")


class SetRuns(CodeEdit, frozen=True, tag="set runs"):
    """Let a state run machines, by the names of their bundles, or none."""

    state: str
    runs: tuple[str, ...]
    history: bool = False

    def _change(self, draft: Draft) -> None:
        for name in self.runs:
            try:
                parse_run(Fragment(name))
            except BundleError as error:
                raise EditError(str(error)) from None
        stem = f"State_{draft.state(self.state).name}"
        text = "".join(f"{name}\n" for name in self.runs)
        draft.put(f"{stem}_{RUNS}", text.encode() or None)
        draft.put(f"{stem}_{HISTORY}", b"\n" if self.runs and self.history else None)


StateEdit: TypeAlias = (
    AddState | DeleteState | OrderState | RenameState | SetFinal | SetRuns | SetSuspendState
    | AddTransition | DeleteTransition | OrderTransition | RetargetTransition
)  # fmt: skip


def _names(draft: Draft) -> list[str]:
    return [state.name for state in draft.bundle.states]


def _set_states(draft: Draft, names: list[str]) -> None:
    """List the states; a missing end of the last line stays missing, and the ends as they are."""
    old = draft.files["States"]
    text = "".join(f"{name}\n" for name in names)
    draft.put_text("States", text if old.rstrip(b" \t").endswith(b"\n") else text[:-1])
