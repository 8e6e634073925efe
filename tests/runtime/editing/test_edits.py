"""Each edit changes the files that it must, in the way in which they are written, and no other."""

from __future__ import annotations

import os
import plistlib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from llfsm.runtime.bundles import BundleState, read_bundle
from llfsm.runtime.bundles.read import Reader
from llfsm.runtime.editing._document import Document, decode_edits
from llfsm.runtime.editing.errors import EditConflictError, EditError
from llfsm.runtime.engine.errors import BundleError

from .conftest import CONFUSING, DATA, files_in, write

TEXT = {"edit": "set text", "text": "", "was": ""}
D0, D1, D2 = (f"State_Done_Transition_{n}" for n in range(3))


def edit(folder: Path, *edits: dict[str, Any]) -> dict[str, bytes | None]:
    """Make edits as the page sends them; return the files that are not as before."""
    before = files_in(folder)
    Document(folder).apply(decode_edits(msgspec.json.encode(edits)))
    after = files_in(folder)
    names = {**before, **after}
    return {n: after.get(n) for n in names if before.get(n) != after.get(n)}


def without_layout(changed: dict[str, bytes | None]) -> dict[str, bytes | None]:
    assert changed.pop("Layout.plist") is not None
    return changed


def test_a_state_is_added(confusing: Path) -> None:
    changed = edit(confusing, {"edit": "add state", "state": "New", "x": 5, "y": 6})
    assert without_layout(changed) == {
        "States": CONFUSING["States"] + b"\r\nNew",
        "State_New_OnEntry.py": b"\n",
    }


def test_a_state_is_renamed_everywhere(confusing: Path) -> None:
    assert edit(confusing, {"edit": "rename state", "state": "Done", "to": "End"}) == {
        "States": b"End\r\nDone_Suspending\r\nVariables\r\nOnEntry",
        f"{D2}.target": None,
        "State_End_Transition_2.target": b"End\n",
        **{name: None for name in CONFUSING if name.startswith(("State_Done_O", "State_Done_T"))},
        **{
            name.replace("_Done_", "_End_"): data
            for name, data in CONFUSING.items()
            if name.startswith(("State_Done_O", "State_Done_T")) and name != f"{D2}.target"
        },
    }


def test_a_state_is_renamed_where_code_has_its_name(confusing: Path) -> None:
    texts = {
        "State_Done_OnEntry.py": (
            b"\xef\xbb\xbfif state_name == 'Done':  # Done\r\n    said = 'Done'\r\n",
            b"\xef\xbb\xbfif state_name == 'End':  # Done\r\n    said = 'Done'\r\n",
        ),
        "State_OnEntry_Transition_0.expr": (
            b' "Done" != state_name and state_name in ("Done", "OnEntry") or name == "Done"\n',
            b' "End" != state_name and state_name in ("End", "OnEntry") or name == "Done"\n',
        ),
        "M_Methods.py": (
            b'def f() -> bool:\n    match state_name:\n        case "OnEntry" | "Done":\n'
            b'            return state_name != "Done_Suspending"\n    return "Done" == count\n',
            b'def f() -> bool:\n    match state_name:\n        case "OnEntry" | "End":\n'
            b'            return state_name != "Done_Suspending"\n    return "Done" == count\n',
        ),
        "State_Gone_OnEntry.py": (b'state_name == "Done"\n', None),
        "State_Variables_Internal.py": (b'state_name == "Done"\nx = (\n', None),
    }
    for name, (text, _) in texts.items():
        (confusing / name).write_bytes(text)
    (confusing / "State_OnEntry_Transition_0.target").write_bytes(b"Done\n")
    before = {path.name: path.read_bytes() for path in confusing.iterdir()}
    document = Document(confusing)
    document.apply(decode_edits('[{"edit": "rename state", "state": "Done", "to": "End"}]'))
    for name, (was, text) in texts.items():
        now = confusing / name.replace("_Done_", "_End_")
        assert now.read_bytes() == (was if text is None else text)
    document.undo()
    assert {path.name: path.read_bytes() for path in confusing.iterdir()} == before


def test_the_suspend_state_is_renamed(confusing: Path) -> None:
    changed = edit(confusing, {"edit": "rename state", "state": "Done_Suspending", "to": "Rest"})
    assert changed["SuspendState"] == b"Rest\n"
    assert changed[f"{D1}.target"] == b"Rest"


def test_a_state_is_deleted_with_the_transitions_to_it(confusing: Path) -> None:
    assert edit(confusing, {"edit": "delete state", "state": "Variables"}) == {
        "States": b"Done\r\nDone_Suspending\r\nOnEntry",
        "State_Variables_Variables.py": None,
        "State_Variables_Transition_0.target": None,
        f"{D0}.target": CONFUSING[f"{D1}.target"],
        f"{D0}.expr": None,
        f"{D1}.target": CONFUSING[f"{D2}.target"],
        f"{D1}.expr": CONFUSING[f"{D2}.expr"],
        f"{D2}.target": None,
        f"{D2}.expr": None,
    }


def test_the_suspend_state_is_deleted(confusing: Path) -> None:
    assert (
        edit(confusing, {"edit": "delete state", "state": "Done_Suspending"})["SuspendState"]
        is None
    )


def test_another_state_is_initial(confusing: Path) -> None:
    assert edit(confusing, {"edit": "order state", "state": "Variables", "to": 0}) == {
        "States": b"Variables\r\nDone\r\nDone_Suspending\r\nOnEntry"
    }


def test_the_suspend_state_is_set_and_unset(confusing: Path) -> None:
    one = {"edit": "set suspend state", "state": "OnEntry"}
    assert edit(confusing, one) == {"SuspendState": b"OnEntry\n"}
    assert edit(confusing, one | {"state": None}) == {"SuspendState": None}
    assert edit(confusing, one) == {"SuspendState": b"OnEntry\n"}


def test_a_transition_is_added(confusing: Path) -> None:
    new = {"edit": "add transition", "source": "Done", "target": "OnEntry"}
    stem = "State_Done_Transition_3"
    assert edit(confusing, new) == {f"{stem}.target": b"OnEntry\n"}
    new["expression"] = "count < 3"
    stem = "State_Done_Transition_4"
    assert edit(confusing, new) == {f"{stem}.target": b"OnEntry\n", f"{stem}.expr": b"count < 3\n"}


def test_a_transition_leads_to_another_state(confusing: Path) -> None:
    new = {"edit": "retarget transition", "source": "Done", "number": 0, "target": "OnEntry"}
    assert edit(confusing, new) == {f"{D0}.target": b"  OnEntry \r\n"}


def test_transitions_get_another_order(confusing: Path) -> None:
    new = {"edit": "order transition", "source": "Done", "number": 2, "to": 0}
    files = CONFUSING
    assert edit(confusing, new) == {
        f"{D0}.target": files[f"{D2}.target"],
        f"{D0}.expr": files[f"{D2}.expr"],
        f"{D1}.target": files[f"{D0}.target"],
        f"{D1}.expr": files[f"{D0}.expr"],
        f"{D2}.target": files[f"{D1}.target"],
        f"{D2}.expr": None,
    }


def test_a_state_that_loses_its_last_file_keeps_an_empty_one(confusing: Path) -> None:
    place = {"part": "OnExit", "state": "Done_Suspending"}
    assert edit(confusing, {"edit": "set text", "place": place, "text": "", "was": "pass"}) == {
        "State_Done_Suspending_OnExit.py": None,
        "State_Done_Suspending_OnEntry.py": b"\n",
    }


def test_a_text_keeps_its_mark_and_the_ends_of_its_lines(confusing: Path) -> None:
    was = "count: int = 0  # how many\n"
    new = {"edit": "set text", "place": {"part": "Variables"}, "text": was + "n: int = 1\n"}
    assert edit(confusing, new | {"was": was}) == {
        "M_Variables.py": CONFUSING["M_Variables.py"] + b"n: int = 1\r\n"
    }


def test_a_text_that_has_changed_meanwhile_is_kept(confusing: Path) -> None:
    new = {"edit": "set text", "place": {"part": "Variables"}, "text": "x", "was": "y"}
    with pytest.raises(EditConflictError, match=r"M_Variables\.py has changed meanwhile"):
        edit(confusing, new)
    assert files_in(confusing) == CONFUSING


def point(x: float, y: float, *others: float) -> dict[str, float]:
    keys = [
        f"{p}{a}" for p in ("srcPoint", "dstPoint", "controlPoint1", "controlPoint2") for a in "XY"
    ]
    return dict(zip(keys, (x, y, *others), strict=True))


def drawn(folder: Path) -> Any:
    return plistlib.loads((folder / "Layout.plist").read_bytes())["States"]


@pytest.fixture
def placed(confusing: Path) -> Path:
    """A bundle with a layout as an editor writes it, with colours and odd spaces."""
    paths = [point(*[10.0 * n + i for i in range(8)]) for n in (1, 2)]
    box = {"x": 100, "y": 50.0, "w": 90, "h": 50, "bgColour": {"red": 0.5}, "onEntryHeight": 31}
    states = {
        "Done": box | {"Transitions": paths},
        "Variables": box | {"x": 300},
        "End": {"x": 1, "y": 2},
    }
    text = plistlib.dumps({"Version": "1.3", "States": states}).replace(
        b"<real>10.0<", b"<real> 10 <"
    )
    (confusing / "Layout.plist").write_bytes(text)
    return confusing


def test_only_the_numbers_of_what_is_moved_change(placed: Path) -> None:
    old = (placed / "Layout.plist").read_bytes().split(b"\n")
    changed = edit(placed, {"edit": "place states", "places": {"Variables": [310, 55.5]}})
    new = (changed.pop("Layout.plist") or b"").split(b"\n")
    assert changed == {}
    assert len(new) == len(old)
    lines = [line for line, was in zip(new, old, strict=True) if line != was]
    # The box, and the half of the first path that ends at it: by 10 and 5.5.
    assert [line.strip()[6:-7] for line in lines] == [
        *(b"26.0", b"22.5", b"22.0", b"18.5"), *(b"310.0", b"55.5")
    ]  # fmt: skip
    assert drawn(placed)["Variables"]["bgColour"] == {"red": 0.5}


def test_what_is_arranged_again_keeps_all_but_its_places(placed: Path) -> None:
    before = drawn(placed)
    old = (placed / "Layout.plist").read_bytes()
    edit(placed, {"edit": "arrange again"})
    after = drawn(placed)
    assert after["End"] == before["End"]  # of a state that is not there
    for name in ("Done", "Variables"):
        assert list(after[name])[: len(before[name])] == list(before[name])
        kept = before[name].keys() - {"x", "y", "Transitions"}
        assert {key: after[name][key] for key in kept} == {key: before[name][key] for key in kept}
    assert len(after["Done"]["Transitions"]) == 3
    assert {"x", "y", "w", "h"} <= after["OnEntry"].keys()

    once = (placed / "Layout.plist").read_bytes()
    assert once.split(b"<key>States</key>")[0] == old.split(b"<key>States</key>")[0]
    edit(placed, {"edit": "arrange again"})
    assert (placed / "Layout.plist").read_bytes() == once


def test_the_layout_follows_what_is_renamed_reordered_and_deleted(placed: Path) -> None:
    before = drawn(placed)
    first, second = before["Done"]["Transitions"]
    edit(placed, {"edit": "rename state", "state": "Done", "to": "End"})
    assert drawn(placed) == {"End": before["Done"], "Variables": before["Variables"]}
    order = {"edit": "order transition", "source": "End"}
    edit(placed, order | {"number": 0, "to": 1})
    assert drawn(placed)["End"]["Transitions"] == [second, first]
    # The third has no path yet; to be before others, it needs one.
    edit(placed, order | {"number": 2, "to": 0})
    assert drawn(placed)["End"]["Transitions"][1:] == [second, first]
    edit(placed, {"edit": "delete transition", "source": "End", "number": 1})
    assert drawn(placed)["End"]["Transitions"][1:] == [first]
    edit(placed, {"edit": "delete state", "state": "Variables"})
    assert drawn(placed).keys() == {"End"}
    assert len(drawn(placed)["End"]["Transitions"]) == 1


def test_a_path_is_bent_and_straight_again_where_it_leads_elsewhere(placed: Path) -> None:
    bend = {"edit": "bend transition", "source": "Done", "number": 1}
    edit(placed, bend | {"path": [[1, 2], [3, 4], [5, 6], [7, 8]]})
    assert drawn(placed)["Done"]["Transitions"][1] == point(1, 2, 3, 4, 5, 6, 7, 8)
    again = {"edit": "retarget transition", "source": "Done", "number": 1, "target": "Variables"}
    edit(placed, again)
    path = drawn(placed)["Done"]["Transitions"][1]
    assert (path["srcPointY"], path["dstPointY"]) == (50, 50)
    assert path["srcPointX"] < path["dstPointX"]


def test_a_box_is_resized_and_shows_its_sections(placed: Path) -> None:
    edit(placed, {"edit": "resize state", "state": "Done", "w": 200, "h": 120})
    edit(placed, {"edit": "expand state", "state": "OnEntry", "expanded": True})
    assert (drawn(placed)["Done"]["w"], drawn(placed)["Done"]["h"]) == (200, 120)
    assert drawn(placed)["OnEntry"]["expanded"] is True
    assert {"x", "y", "w", "h"} <= drawn(placed)["OnEntry"].keys()


def test_several_edits_are_one_step(confusing: Path) -> None:
    document = Document(confusing)
    pasted = [
        {"edit": "add state", "state": "Copy", "x": 0, "y": 0},
        {"edit": "add transition", "source": "Copy", "target": "Done"},
        {"edit": "set text", "place": {"part": "OnEntry", "state": "Copy"}, "text": "a", "was": ""},
    ]
    document.apply(decode_edits(msgspec.json.encode(pasted)))
    assert read_bundle(confusing).states[-1].sections["OnEntry"].text == "a"
    document.undo()
    assert files_in(confusing) == CONFUSING
    with pytest.raises(EditError, match="nothing to undo"):
        document.undo()
    with pytest.raises(EditError, match="no state 'X'"):
        document.apply(decode_edits(msgspec.json.encode([pasted[0], pasted[1] | {"target": "X"}])))
    assert files_in(confusing) == CONFUSING


def test_a_hundred_steps_are_undone_and_made_again(
    confusing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", lambda _: None)  # a disk would take seconds
    document, seen, was = Document(confusing), [files_in(confusing)], "pass"
    for number in range(100):
        new = TEXT | {"place": {"part": "OnExit", "state": "Done_Suspending"}, "was": was}
        was = f"count = {number}\n"
        document.apply(decode_edits(msgspec.json.encode([new | {"text": was}])))
        seen.append(files_in(confusing))
    for before in reversed(seen[:-1]):
        document.undo()
        assert files_in(confusing) == before
    for after in seen[1:]:
        document.redo()
        assert files_in(confusing) == after


@pytest.mark.parametrize(
    ("wrong", "printed"),
    [
        ({"edit": "add state", "state": "Gone", "x": 0, "y": 0}, "State_Gone_OnEntry.py is left"),
        ({"edit": "add state", "state": "Done", "x": 0, "y": 0}, "there is a state 'Done' already"),
        ({"edit": "add state", "state": "../x", "x": 0, "y": 0}, "cannot name a state"),
        ({"edit": "add state", "state": "New", "x": 1e9, "y": 0}, "no place farther than"),
        ({"edit": "rename state", "state": "Done", "to": "a b"}, "cannot name a state"),
        ({"edit": "delete state", "state": "X"}, "no state 'X'"),
        ({"edit": "order state", "state": "Done", "to": 4}, "no place 4 in a list of 4"),
        ({"edit": "delete transition", "source": "Done", "number": 3}, "has no transition 3"),
        (TEXT | {"place": {"part": "States"}}, "a machine has no text 'States'"),
        (TEXT | {"place": {"part": "X/../../y", "state": "Done"}}, "a state has no text 'X/"),
        ({"edit": "resize state", "state": "Done", "w": 0, "h": 9}, "needs a width"),
        ({"edit": "unknown"}, "invalid edits"),
    ],
)  # fmt: skip
def test_what_is_impossible_changes_nothing(
    confusing: Path, wrong: dict[str, Any], printed: str
) -> None:
    with pytest.raises(EditError, match=printed):
        edit(confusing, wrong)
    assert files_in(confusing) == CONFUSING


def test_a_machine_keeps_its_last_state(tmp_path: Path) -> None:
    folder = write(
        tmp_path / "M.machine",
        {"States": b"A", "Language": b"python", "State_A_OnEntry.py": b"\n"},
    )
    with pytest.raises(EditError, match="a machine needs a state"):
        edit(folder, {"edit": "delete state", "state": "A"})


def test_only_the_layout_of_a_cpp_bundle_is_edited(tmp_path: Path) -> None:
    folder = write(tmp_path / "Lamp.machine", files_in(DATA / "Lamp.machine"))
    with pytest.raises(EditError, match="a C\\+\\+ bundle, of which only the layout"):
        edit(folder, {"edit": "rename state", "state": "On", "to": "Bright"})
    assert edit(folder, {"edit": "arrange again"}).keys() == {"Layout.plist"}


def test_what_cannot_be_read_is_not_edited(confusing: Path) -> None:
    (confusing / f"{D0}.target").write_text("Nowhere\n")
    document = Document(confusing)
    with pytest.raises(BundleError, match="'Nowhere' is not a state"):
        document.apply(decode_edits('[{"edit": "arrange again"}]'))


def test_only_what_changes_is_read_again(confusing: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    document = Document(confusing)
    before = document.bundle
    read: list[str] = []
    state = Reader.state

    def reading(reader: Reader, name: str, names: list[str]) -> BundleState:
        read.append(name)
        return state(reader, name, names)

    monkeypatch.setattr(Reader, "state", reading)
    place = {"part": "OnExit", "state": "Done_Suspending"}
    text = {"edit": "set text", "place": place, "text": "x = 1\n", "was": "pass"}
    document.apply(decode_edits(msgspec.json.encode([text])))
    assert document.bundle.states[1].sections["OnExit"].text == "x = 1\n"
    assert read == ["Done", "Done_Suspending"]  # files of one could be the other's
    assert document.bundle.states[2] is before.states[2]


def test_all_names_that_code_can_use_are_offered(confusing: Path) -> None:
    declared = "motor = Actuator(MOTOR, at_end=STOP)\n"
    methods = "def far(x: float) -> bool:\n    return x > 1\n"
    (confusing / "M_Variables.py").write_text(declared)
    (confusing / "M_Methods.py").write_text(methods)
    includes = "from llfsm.whiteboard.messages.geometry_msgs import Twist as Speed\n"
    (confusing / "M_Includes.py").write_text(includes)
    state = Document(confusing).bundle.states[0].name
    (confusing / f"State_{state}_Variables.py").write_text("own: int = 0\n")
    _, names = Document(confusing).findings()
    assert {"motor", "far", "after_ms", "Speed"} <= set(names[""])
    assert names[state] == ["own"]
