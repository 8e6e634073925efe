"""Any edits leave the machine that they describe, and undo and redo restore every byte."""

from __future__ import annotations

import ast
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from llfsm.runtime.bundles import Bundle, read_bundle
from llfsm.runtime.checking import check_bundle
from llfsm.runtime.editing._document import Document, decode_edits
from llfsm.runtime.editing._draft import Draft
from llfsm.runtime.editing.errors import EditError
from llfsm.runtime.editing.text_edits import TextPlace, text_file
from thoroughness import examples

from .conftest import CONFUSING, DATA, MACHINES, files_in, write

NAMES = ["A", "Done", "Done_Suspending", "Variables", "OnEntry", "Gone", "no name", "", "Ä", "../A"]
TEXTS = ["", "\n", "count > 3\n", "x = (\n", "a\nb\n", "# ünï\n", "true"]
MEMORY = Path("/dev/shm")  # where a file is on disk at once
numbers = st.integers(0, 9)
# What kind of edit, which state, which other state, which transition, where to, a name, a text
steps = st.lists(
    st.tuples(
        st.sampled_from([
            "add state", "rename state", "delete state", "order state", "set suspend state",
            "add transition", "retarget transition", "order transition", "delete transition",
            "set text", "include", "place states", "bend transition", "expand state",
            "resize state", "arrange again", "set final", "set runs",
        ]),
        *(numbers, numbers, numbers, numbers),
        st.sampled_from(NAMES),
        st.sampled_from(TEXTS),
    ),
    max_size=8,
)  # fmt: skip


def model_of(bundle: Bundle) -> list[Any]:
    """Return the machine in plain lists: its suspend state, then its states in their order."""
    states = [
        [
            state.name,
            {key: text.text for key, text in state.sections.items()},
            [[t.target, t.expression.text if t.expression else ""] for t in state.transitions],
            state.final,
        ]
        for state in bundle.states
    ]
    return [bundle.suspend, states]


class Naive:
    """The edits once more, on the plain lists. Each returns False where it is impossible."""

    def __init__(self, bundle: Bundle, files: dict[str, bytes]):
        self.suspend, self.states = model_of(bundle)
        self.files = files

    def find(self, name: str) -> Any:
        return next((state for state in self.states if state[0] == name), None)

    def is_free(self, name: str) -> bool:
        left = any(each.startswith(f"State_{name}_On") for each in self.files)
        return name.isidentifier() and name.isascii() and not self.find(name) and not left

    def add_state(self, edit: Any) -> bool:
        if not self.is_free(edit["state"]):
            return False
        self.states.append([edit["state"], {}, [], True])
        return True

    def rename_state(self, edit: Any) -> bool:
        if not self.is_free(edit["to"]):
            return False
        for state in self.states:
            for transition in state[2]:
                if transition[0] == edit["state"]:
                    transition[0] = edit["to"]
        if self.suspend == edit["state"]:
            self.suspend = edit["to"]
        self.find(edit["state"])[0] = edit["to"]
        return True

    def delete_state(self, edit: Any) -> bool:
        if len(self.states) == 1:
            return False
        self.states.remove(self.find(edit["state"]))
        for state in self.states:
            state[2] = [each for each in state[2] if each[0] != edit["state"]]
        if self.suspend == edit["state"]:
            self.suspend = None
        return True

    def order_state(self, edit: Any) -> bool:
        if edit["to"] >= len(self.states):
            return False
        state = self.find(edit["state"])
        self.states.remove(state)
        self.states.insert(edit["to"], state)
        return True

    def set_suspend_state(self, edit: Any) -> bool:
        self.suspend = edit["state"]
        return True

    def set_final(self, edit: Any) -> bool:
        self.find(edit["state"])[3] = edit["final"]
        return True

    def add_transition(self, edit: Any) -> bool:
        expression = edit["expression"]
        text = expression.rstrip("\n") + "\n" if expression.strip() else ""
        self.find(edit["source"])[2].append([edit["target"], text])
        return True

    def retarget_transition(self, edit: Any) -> bool:
        self.find(edit["source"])[2][edit["number"]][0] = edit["target"]
        return True

    def order_transition(self, edit: Any) -> bool:
        transitions = self.find(edit["source"])[2]
        transitions.insert(edit["to"], transitions.pop(edit["number"]))
        return True

    def delete_transition(self, edit: Any) -> bool:
        del self.find(edit["source"])[2][edit["number"]]
        return True

    def include(self, edit: Any) -> bool:
        try:
            ast.parse(edit["text"])
        except SyntaxError:
            return False
        return True

    def set_text(self, edit: Any) -> bool:
        place, text = edit["place"], edit["text"]
        state = self.find(place["state"])
        if place.get("number") is not None:
            state[2][place["number"]][1] = text if text.strip() else ""
        elif text.strip():
            state[1][place["part"]] = text
        else:
            state[1].pop(place["part"], None)
        return True


def made(step: Any, document: Document) -> dict[str, Any] | None:
    """Return the edit of a step as the page sends it; None where there is nothing to edit."""
    kind, i, j, k, to, name, text = step
    states = document.bundle.states
    state, other = states[i % len(states)], states[j % len(states)]
    if kind.endswith("transition") and kind != "add transition" and not state.transitions:
        return None
    count = max(len(state.transitions), 1)
    x, y = 10.0 * i, 20.0 * j
    number = {"source": state.name, "number": k % count}
    fields: dict[str, dict[str, Any]] = {
        "add state": {"state": name, "x": x, "y": y},
        "rename state": {"state": state.name, "to": name},
        "delete state": {"state": state.name},
        "order state": {"state": state.name, "to": to},
        "set suspend state": {"state": state.name if k else None},
        "set final": {"state": state.name, "final": bool(k % 2)},
        "set runs": {"state": state.name, "runs": ["Inner"] * (k % 3), "history": bool(k % 2)},
        "add transition": {"source": state.name, "target": other.name, "expression": text},
        "retarget transition": {**number, "target": other.name},
        "order transition": {**number, "to": to % count},
        "delete transition": number,
        "set text": {"text": text},
        "include": {"text": text},
        "place states": {"places": {state.name: [x, y], other.name: [y, x]}},
        "bend transition": {**number, "path": [[x, y], [y, x], [0, 1], [2, 3]]},
        "expand state": {"state": state.name, "expanded": bool(k % 2)},
        "resize state": {"state": state.name, "w": 50 + x, "h": 40 + y},
        "arrange again": {},
    }
    edit = {"edit": kind, **fields[kind]}
    if kind == "set text":
        expression = state.transitions and k % 2
        old = (
            state.transitions[j % count].expression if expression else state.sections.get("OnExit")
        )
        place = {"part": "OnExit", "state": state.name}
        edit["place"] = place | ({"number": j % count} if expression else {})
        edit["was"] = old.text if old else ""
    return edit


@pytest.mark.parametrize("start", ["confusing", "RosBlindTurttleBot"])
@settings(max_examples=examples(8), deadline=None)
@given(steps=steps)
def test_random_edits(start: str, steps: list[Any]) -> None:
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as beside:
        folder = Path(beside, "M.machine")
        if start == "confusing":
            write(folder, CONFUSING)
        else:
            folder = Path(beside, f"{start}.machine")
            shutil.copytree(MACHINES / folder.name, folder)
        document = Document(folder)
        seen = [files_in(folder)]
        for step in steps:
            edit = made(step, document)
            if edit is None:
                continue
            naive = Naive(document.bundle, seen[-1])
            act: Callable[[Any], bool] = getattr(
                naive, edit["edit"].replace(" ", "_"), lambda _: True
            )
            wanted = act(edit)
            edits = decode_edits(msgspec.json.encode([edit]))
            if not wanted:
                with pytest.raises(EditError):
                    document.apply(edits)
                assert files_in(folder) == seen[-1]
                continue
            document.apply(edits)
            assert read_bundle(folder) == document.bundle
            assert model_of(document.bundle) == [naive.suspend, naive.states]
            if files_in(folder) != seen[-1]:
                seen.append(files_in(folder))
        for finding in check_bundle(folder, load=False):  # it can be checked, whatever is wrong
            assert Path(finding.file).parent == folder.resolve()
        for before in reversed(seen[:-1]):
            document.undo()
            assert files_in(folder) == before
        assert not document.can_undo
        for after in seen[1:]:
            document.redo()
            assert files_in(folder) == after


@pytest.mark.parametrize(
    "folder", [*sorted(MACHINES.glob("*.machine")), DATA / "Lamp.machine"], ids=lambda p: p.name
)
def test_what_is_opened_keeps_every_byte_and_every_edit_of_its_layout_the_rest(
    folder: Path, tmp_path: Path
) -> None:
    copy = Path(shutil.copytree(folder, tmp_path / folder.name))
    before = files_in(copy)
    document = Document(copy)
    assert document.refresh() == []
    assert files_in(copy) == before
    state = document.bundle.states[0].name
    place = {"edit": "place states", "places": {state: [1000.5, 2000.5]}}
    assert document.apply(decode_edits(msgspec.json.encode([place]))) == ["Layout.plist"]
    layout, old = document.bundle.layout, Document(folder).bundle.layout
    assert layout is not None
    assert (layout.states[state].x, layout.states[state].y) == (1000.5, 2000.5)
    if old is not None:
        others = layout.states.keys() - {state}
        assert {name: layout.states[name] for name in others} == {
            name: old.states[name] for name in old.states.keys() - {state}
        }
        assert layout.states[state].more == old.states[state].more
    document.undo()
    assert files_in(copy) == before


def test_the_file_of_a_text_is_the_one_that_is_read(confusing: Path) -> None:
    document = Document(confusing)
    draft = Draft(document.folder.path, document.files)
    for place, text in (
        (TextPlace("Variables"), document.bundle.variables),
        (TextPlace("Variables", "Variables"), document.bundle.states[2].variables),
        (TextPlace("", "Done", 2), document.bundle.states[0].transitions[2].expression),
    ):
        assert text is not None
        assert text.file is not None
        assert text_file(draft, place) == text.file.name
