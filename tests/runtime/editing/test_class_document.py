"""A class is looked at as its file has it; only its layout is written, and can be undone."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from llfsm.machines import wall_turtle
from llfsm.runtime.bundles import load_bundle, read_bundle
from llfsm.runtime.converting.class_process import ClassName
from llfsm.runtime.editing import EditConflictError, EditError, decode_edits
from llfsm.runtime.editing.class_document import ClassDocument
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.machine import Machine

TEXT = """\
from llfsm.runtime import Machine, State

print("imported")

class Patrol(Machine):
    n: int = 0
    A = State()
    B = State(suspend=True)

    @A.on_entry
    def _(self) -> None:
        self.n += 1  # counts

    A.to(B, after_ms=5)
"""
PLACE = decode_edits('[{"edit": "place states", "places": {"A": [50, 60], "B": [250, 60]}}]')


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    file = tmp_path / "patrol.py"
    file.write_text(TEXT)
    return file


def opened(file: Path) -> ClassDocument:
    return ClassDocument(ClassName(file, "patrol", "Patrol"))


def test_its_layout_is_written_beside_it_and_nothing_else(file: Path) -> None:
    document = opened(file)
    a = document.bundle.states[0]
    assert (a.name, a.sections["OnEntry"].text) == ("A", "self.n += 1  # counts")
    assert (a.transitions[0].target, document.bundle.suspend) == ("B", "B")
    assert document.bundle.variables is not None
    assert document.bundle.variables.text == "n: int = 0\n"
    document.apply(PLACE)
    layout = file.with_name("Patrol.layout")
    once = layout.read_bytes()
    assert document.bundle.layout is not None
    assert document.bundle.layout.states["A"].x == 50
    document.apply([*PLACE, *decode_edits('[{"edit": "arrange again"}]')])
    assert layout.read_bytes() != once
    document.undo()
    assert layout.read_bytes() == once
    assert opened(file).bundle.layout == document.bundle.layout
    document.undo()
    assert sorted(each.name for each in file.parent.iterdir() if each.is_file()) == ["patrol.py"]
    assert file.read_text() == TEXT


def test_what_others_write_is_seen(file: Path) -> None:
    document = opened(file)
    assert document.refresh() == []
    file.write_text(TEXT.replace("A.to(B", "B.to(A").replace("self.n += 1", "self.n = m"))
    assert document.refresh() == ["patrol.py"]
    assert document.bundle.states[1].transitions[0].target == "A"
    assert any("'m'" in each.text and each.line == 12 for each in document.findings()[0])
    for text, wrong in [
        ("class Patrol(:", "patrol.py:1: SyntaxError"),
        ("import os; os._exit(0)", "patrol.py: importing patrol has ended its process"),
        (TEXT.replace("A.to(B", "A.to(C"), r"patrol\.py:\d+: NameError: name 'C'"),
        (TEXT.replace("Patrol", "Other"), "patrol.py: AttributeError: module 'patrol' has no"),
    ]:
        file.write_text(text)
        document.refresh()
        with pytest.raises(BundleError, match=wrong):
            _ = document.bundle
        with pytest.raises(BundleError, match=wrong):
            document.apply(PLACE)
    file.unlink()
    document.refresh()
    with pytest.raises(BundleError, match=r"patrol\.py: No such file"):
        _ = document.bundle
    file.write_text(TEXT)
    document.refresh()
    document.apply(PLACE)
    file.with_name("Patrol.layout").write_text("mine")
    with pytest.raises(EditConflictError, match=r"Patrol\.layout was changed"):
        document.undo()
    assert file.with_name("Patrol.layout").read_text() == "mine"


def test_its_code_is_not_edited(file: Path) -> None:
    document = opened(file)
    rename = decode_edits('[{"edit": "rename state", "state": "A", "to": "C"}]')
    with pytest.raises(EditError, match="Patrol is a class, of which only the layout can be"):
        document.apply(rename)
    assert file.read_text() == TEXT


@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
def test_a_bundle_is_made_of_it_as_it_is_now(file: Path) -> None:
    document = opened(file)
    document.apply(PLACE)
    file.write_text(TEXT.replace("after_ms=5", "after_ms=7"))
    made = document.convert()
    assert made == file.with_name("Patrol.machine")
    bundle = read_bundle(made)
    assert bundle.layout is not None
    assert bundle.layout.states["B"].x == 250
    machine: type[Machine] = load_bundle(made)
    assert machine.table.states[0].transitions[0].after_ms == 7
    with pytest.raises(BundleError, match=r"Patrol\.machine: not written: it is there already"):
        document.convert()


def test_nothing_is_written_beside_a_machine_that_ships() -> None:
    document = ClassDocument(
        ClassName(Path(wall_turtle.__file__), wall_turtle.__name__, "RosWallTurttleBot")
    )
    state = document.bundle.states[0].name
    place = decode_edits(f'[{{"edit": "place states", "places": {{"{state}": [50, 60]}}}}]')
    with pytest.raises(EditError, match="llfsm convert RosWallTurttleBot -o FOLDER"):
        document.apply(place)
    with pytest.raises(EditError, match="ships with llfsm"):
        document.convert()
    assert not document.path.with_name("RosWallTurttleBot.layout").exists()
