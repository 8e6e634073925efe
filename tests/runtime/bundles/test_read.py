"""Bundles are read whatever wrote them; what cannot be read is printed with its file and line."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from llfsm.runtime import BundleError
from llfsm.runtime.bundles import Bundle, read_bundle
from llfsm.runtime.bundles.plist import layout_to_plist, read_layout
from llfsm.runtime.engine.table import StateBox, TransitionPath


def targets(bundle: Bundle) -> dict[str, list[tuple[str, str]]]:
    return {
        state.name: [
            (t.target, t.expression.text if t.expression else "") for t in state.transitions
        ]
        for state in bundle.states
    }


LAMP = {
    "InitialPseudoState": [("Off", "true")],
    "Off": [("On", "after_ms(500) && !broken"), ("Done", "broken")],
    "On": [("Off", "after(0.5)"), ("Done", "count >= limit - 1 || broken")],
    "Suspend": [],
    "Done": [],
    "Done_Suspending": [("Done", "lamp_status.get().isOff()")],
}


def test_cpp(lamp: Path) -> None:
    bundle = read_bundle(lamp)
    assert (bundle.name, bundle.language, bundle.suspend) == ("Lamp", "objc++", "Suspend")
    assert targets(bundle) == LAMP
    assert bundle.include_paths == ("$HOME/include", ".")
    off = bundle.states[1]
    assert {name: each.text for name, each in off.sections.items()} == {
        "OnEntry": "count = 0;\nlamp(false);\n",
        "OnResume": "lamp(false);\n",
    }
    assert off.sections["OnEntry"].file == lamp / "State_Off_OnEntry.mm"
    assert bundle.variables is not None
    assert "int\tlimit = 3;" in bundle.variables.text
    assert bundle.methods is None


def test_layout(lamp: Path) -> None:
    layout = read_bundle(lamp).layout
    assert layout is not None
    assert layout.states["On"] == StateBox(600.0, 80.0, 180.0, 90.0, True)
    [path] = layout.transitions["Off"]
    assert path == TransitionPath((440.0, 80.0), (510.0, 80.0), (460.0, 70.0), (490.0, 70.0))
    (lamp / "Layout.plist").unlink()
    assert read_bundle(lamp).layout is None


def plist(inside: str) -> str:
    return f'<plist version="1.0"><dict><key>States</key><dict>{inside}</dict></dict></plist>'


def test_a_layout_may_lack_anything(lamp: Path) -> None:
    (lamp / "Layout.plist").write_text(
        plist(
            "<key>On</key><dict><key>x</key><real>1</real><key>y</key><integer>2</integer></dict>"
            "<key>Off</key><dict><key>x</key><string>1</string><key>Transitions</key>"
            "<array><dict><key>srcPointX</key><real>1</real></dict></array></dict>"
            "<key>Done</key><string>no</string>"
        )
    )
    layout = read_bundle(lamp).layout
    assert layout is not None
    assert layout.states == {"On": StateBox(1.0, 2.0, 90.0, 50.0)}
    assert layout.transitions == {}


def test_what_else_an_editor_keeps_of_a_state_is_kept(lamp: Path, tmp_path: Path) -> None:
    (lamp / "Layout.plist").write_text(
        plist(
            "<key>On</key><dict><key>x</key><real>1</real><key>y</key><integer>2</integer>"
            "<key>onEntryHeight</key><real>31</real><key>bgColour</key>"
            "<dict><key>red</key><real>0.5</real></dict></dict>"
        )
    )
    layout = read_bundle(lamp).layout
    assert layout is not None
    assert layout.states["On"].more == {"onEntryHeight": 31.0, "bgColour": {"red": 0.5}}
    assert read_layout(layout_to_plist(layout), tmp_path) == layout


@pytest.mark.parametrize("content", [b"", b"no plist", b"<plist><dict><key>", b"bplist00\xff"])
def test_a_broken_layout(lamp: Path, content: bytes) -> None:
    (lamp / "Layout.plist").write_bytes(content)
    with pytest.raises(BundleError, match=r"Layout\.plist: not a property list: .*; delete it"):
        read_bundle(lamp)


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def test_targets_may_stand_where_transitions_are_made(lamp: Path) -> None:
    edit(lamp / "State_Off.mm", "new Transition_0()", "new Transition_0( 5 )")
    edit(lamp / "State_Off.h", "int toState = 4", "int toState")
    edit(lamp / "State_Off.mm", "new Transition_1()", "new Off::Transition_1{4}")
    assert [target for target, _ in targets(read_bundle(lamp))["Off"]] == [
        "Done_Suspending",
        "Done",
    ]


def test_comments_are_no_code(lamp: Path) -> None:
    edit(lamp / "State_Off.mm", "new Transition_0();", "new Transition_0(); // new Transition_0(5)")
    edit(lamp / "Lamp.mm", "setSuspendState(_states[3]);", "/* setSuspendState(_states[3]); */")
    edit(lamp / "State_On.h", "class On", "// numberOfTransitions() { return 9; }\nclass On")
    bundle = read_bundle(lamp)
    assert targets(bundle) == LAMP
    assert bundle.suspend is None


def test_white_space_and_line_ends_are_free(lamp: Path) -> None:
    for file in lamp.iterdir():
        if file.suffix != ".plist":
            text = re.sub(r"toState = (\d)", r"toState=\1", file.read_text())
            text = text.replace("numberOfTransitions()", "numberOfTransitions ( void )")
            text = text.replace("{ return", "\n{\treturn")
            file.write_bytes(text.replace("\n", "\r\n").encode())
    bundle = read_bundle(lamp)
    assert targets(bundle) == LAMP
    assert bundle.states[1].sections["OnEntry"].text == "count = 0;\nlamp(false);\n"


@pytest.mark.parametrize(
    ("argument", "suspend"),
    [
        ("4", "Done"),
        ("_states [ 1 ]", "Off"),
        ("Done_Suspending", "Done_Suspending"),
        ("new FSMLamp::State::Done()", "Done"),
        ("NULL", None),
        ("nullptr", None),
    ],
)
def test_suspend_state(lamp: Path, argument: str, suspend: str | None) -> None:
    edit(lamp / "Lamp.mm", "_states[3])", f"{argument})")
    assert read_bundle(lamp).suspend == suspend


def test_a_state_may_be_called_variables(lamp: Path) -> None:
    edit(lamp / "States", "Done_Suspending", "Variables")
    for suffix in (".h", ".mm", "_Transition_0.expr"):
        (lamp / f"State_Done_Suspending{suffix}").rename(lamp / f"State_Variables{suffix}")
    bundle = read_bundle(lamp)
    assert bundle.states[-1].name == "Variables"
    assert bundle.states[-1].transitions[0].target == "Done"


def test_a_missing_expression_is_true(lamp: Path) -> None:
    (lamp / "State_Off_Transition_1.expr").unlink()
    assert read_bundle(lamp).states[1].transitions[1].expression is None


def test_other_endings(lamp: Path) -> None:
    for file in lamp.glob("*.mm"):
        file.rename(file.with_suffix(".cpp"))
    (lamp / "Language").write_text("C++\n")
    assert targets(read_bundle(lamp)) == LAMP


DAMAGES: list[tuple[Callable[[Path], object], str]] = [
    (lambda p: (p / "State_On.h").unlink(), r"State_On\.h: it is missing.*'On', which States"),
    (lambda p: (p / "States").unlink(), "no file States"),
    (lambda p: (p / "States").write_text("\n \n"), "States: it lists no states"),
    (lambda p: (p / "States").write_text("A\nB\nA"), "States:3: state 'A' is listed twice"),
    (lambda p: (p / "States").write_text("A\n2 B"), "States:2: '2 B' cannot name a state"),
    (lambda p: (p / "States").write_text("A\n__proto__"), "States:2: .__proto__. cannot name"),
    (lambda p: (p / "States").write_text("A" * 201), "States:1: 'A{20}…' cannot name a state"),
    (lambda p: (p / "States").write_bytes(b"A\n\xff"), "States:2: not UTF-8 text"),
    (lambda p: (p / "Language").write_text("swift"), "Language: the language 'swift' is unknown"),
    (lambda p: (p / "Lamp.mm").unlink(), r"Lamp\.mm: it is missing; was the folder renamed"),
    (
        lambda p: edit(p / "State_On.h", "return 2", "return n"),
        "not give the number of transitions",
    ),
    (lambda p: edit(p / "State_On.h", "return 2", "return 3"), "transition 2 of state 'On' no tar"),
    (
        lambda p: edit(p / "State_On.h", "toState = 4", "toState = 6"),
        r"State_On\.h:\d+: transition 1 of state 'On' leads to state number 6, but there are 6",
    ),
    (lambda p: edit(p / "Lamp.mm", "[3]);", "[6]);"), r"Lamp\.mm:17: setSuspendState is given"),
    (lambda p: edit(p / "Lamp.mm", "_states[3]);", "x);"), "given 'x', which is not a state"),
    (lambda p: (p / "State_On_Transition_0.expr").write_text(" \n"), r"_0\.expr: it is empty"),
    (lambda p: ((p / "Lamp_Variables.h").unlink(), (p / "Lamp_Variables.h").mkdir()), "Is a dir"),
]


@pytest.mark.parametrize(("damage", "printed"), DAMAGES, ids=[printed for _, printed in DAMAGES])
def test_damage(lamp: Path, damage: Callable[[Path], object], printed: str) -> None:
    damage(lamp)
    with pytest.raises(BundleError, match=printed) as caught:
        read_bundle(lamp)
    assert caught.value.file is not None


def test_folders_that_are_no_bundles(tmp_path: Path, lamp: Path) -> None:
    with pytest.raises(BundleError, match=r"X\.machine: folder not found"):
        read_bundle(tmp_path / "X.machine")
    with pytest.raises(BundleError, match="its name has more than 200 bytes; rename it"):
        read_bundle(lamp.rename(tmp_path / f"{'X' * 201}.machine"))
    lamp = lamp.parent / f"{'X' * 200}.machine"
    (tmp_path / f"{'X' * 201}.machine").rename(lamp)
    for file in lamp.iterdir():
        if file.name != "Layout.plist":
            file.unlink()
    with pytest.raises(BundleError, match="not a bundle: there is no file States"):
        read_bundle(lamp)


# Python


def test_python(bundle: Callable[..., Path]) -> None:
    folder = bundle(
        {"SuspendState": "B\n", "IncludePath": "lib\n\n"}, Variables="n: int = 0", A_OnExit="n = 1"
    )
    found = read_bundle(folder)
    assert (found.name, found.language, found.suspend) == ("M", "python", "B")
    assert targets(found) == {"A": [("B", "stopping")], "B": []}
    assert found.include_paths == ("lib",)
    assert found.states[0].sections["OnExit"].text == "n = 1"


@pytest.mark.parametrize(
    ("files", "printed"),
    [
        (
            {"State_A_Transition_0.target": "C"},
            r"_0\.target:1: 'C' is not a state; the states are: A",
        ),
        ({"State_A_Transition_1.expr": "True"}, r"_1\.target: it is missing"),
        ({"State_A_Transition_2.target": "B"}, r"_1\.target: it is missing"),
        ({"SuspendState": "C"}, "SuspendState:1: 'C' is not a state"),
        ({"States": "A\nB\nC"}, "States:3: state 'C' has no files"),
        ({"State_A_Transition_0.expr": ""}, r"_0\.expr: it is empty"),
    ],
)
def test_python_damage(bundle: Callable[..., Path], files: dict[str, str], printed: str) -> None:
    with pytest.raises(BundleError, match=printed):
        read_bundle(bundle(files))
