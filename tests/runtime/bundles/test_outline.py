"""Bundles of either language as tables to be drawn, and the pictures made of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

import llfsm.machines
from llfsm.runtime import BundleError
from llfsm.runtime.bundles import load_bundle, outline, read_bundle
from llfsm.runtime.drawing import Diagram, arrange, to_dot, to_mermaid, to_png, to_svg
from llfsm.runtime.engine.source_text import body_of
from llfsm.runtime.engine.table import Table

from .conftest import CppWriter

MACHINES = Path(llfsm.machines.__file__).parent
SHIPPED = sorted(path.stem for path in MACHINES.glob("*.machine"))
HOSTILE = (
    'strcmp(name, "a<b>&c") == 0',
    "a < b && c > d",
    "'x' == c",
    "größe > 3 /* ≥ 日本 */",
    "a\n\t|| b // or so\n\n",
    "// to be written\n",
    '"%%{x}%%" "\\n"',
)


def facts(table: Table) -> list[tuple[object, ...]]:
    """Return what a picture shows of a table."""
    return [
        (
            state.name,
            state is table.suspend,
            {name: body_of(code) for name, code in state.sections.items()},
            [(each.target.name, each.label) for each in state.transitions],
        )
        for state in table.states
    ]


def drawn(folder: Path, *, sections: bool | None = None) -> Diagram:
    """Draw a bundle in every format; return its geometry."""
    bundle = read_bundle(folder)
    table = outline(bundle)
    diagram = arrange(table, title=bundle.name, sections=sections)
    root = ET.fromstring(to_svg(diagram))
    states = [g for g in root if "state" in (g.get("class") or "").split()]
    assert [group.get("data-state") for group in states] == [each.name for each in bundle.states]
    assert to_png(diagram).startswith(b"\x89PNG")
    arrows = sum(len(each.transitions) for each in bundle.states)
    assert len(re.findall(r"^    s\d+ -> s\d+ ", to_dot(table), re.MULTILINE)) == arrows
    assert len(re.findall(r"^    s\d+ --> s\d+", to_mermaid(table), re.MULTILINE)) == arrows
    return diagram


@pytest.mark.parametrize("name", SHIPPED)
def test_a_python_bundle_is_drawn_as_its_class(name: str) -> None:
    folder = MACHINES / f"{name}.machine"
    table, loaded = outline(read_bundle(folder)), load_bundle(folder).table
    assert facts(table) == facts(loaded)
    assert (table.path, table.layout) == (loaded.path, loaded.layout)
    for sections in (None, True):
        assert arrange(table, sections=sections) == arrange(loaded, sections=sections)


def test_code_of_a_bundle_is_not_run(bundle: Callable[..., Path]) -> None:
    folder = bundle(
        Includes="import not_installed_here\nraise SystemExit\n",
        A_OnEntry="not_installed_here.do()\n",
        A_OnExit="# nothing yet\n",
        expr="(not_installed_here.x\n  > 1)  # soon",
    )
    assert facts(outline(read_bundle(folder))) == [
        ("A", False, {"OnEntry": "not_installed_here.do()\n"}, [("B", "not_installed_here.x > 1")]),
        ("B", False, {}, []),
    ]


def test_python_that_cannot_be_parsed_is_named(bundle: Callable[..., Path]) -> None:
    folder = bundle(A_OnEntry="x = 1\nif x\n")
    with pytest.raises(BundleError, match=r"State_A_OnEntry\.py:2: SyntaxError"):
        outline(read_bundle(folder))


def test_a_cpp_bundle(lamp: Path) -> None:
    table = outline(read_bundle(lamp))
    assert table.path == str(lamp.resolve())
    assert table.initial.name == "InitialPseudoState"
    assert table.suspend is not None
    assert table.suspend.name == "Suspend"
    off = next(state for state in table.states if state.name == "Off")
    assert [(each.target.name, each.label) for each in off.transitions] == [
        ("On", "after_ms(500) && !broken"), ("Done", "broken")
    ]  # fmt: skip
    drawn(lamp)


@pytest.mark.parametrize("newer", [False, True])
def test_targets_of_both_generations(cpp_bundle: CppWriter, newer: bool) -> None:
    folder = cpp_bundle(
        [(0, 2, "go"), (0, 1, "!go"), (1, 0, None), (2, 2, "after(1)")],
        ["A", "B", "C"],
        suspend=1,
        newer=newer,
    )
    assert facts(outline(read_bundle(folder))) == [
        ("A", False, {}, [("C", "go"), ("B", "!go")]),
        ("B", True, {}, [("A", "true")]),
        ("C", False, {}, [("C", "after(1)")]),
    ]
    drawn(folder)


def test_sections_without_code_are_left_out_as_of_python(cpp_bundle: CppWriter) -> None:
    files = {
        "State_A_OnEntry.mm": "x = 1; // done\n",
        "State_A_OnExit.mm": "\n",
        "State_A_Internal.mm": "// nothing\n/* really\n   nothing */\n",
        "State_A_OnSuspend.mm": 'log("//");\n',
    }
    folder = cpp_bundle([(0, 1, "true")], files=files)
    (_, _, sections, _), _ = facts(outline(read_bundle(folder)))
    assert sections == {"OnEntry": "x = 1; // done\n", "OnSuspend": 'log("//");\n'}
    box = drawn(folder, sections=True).boxes[0]
    assert [(each.name, each.lines) for each in box.sections] == [
        ("OnEntry", ("x = 1; // done",)),
        ("OnSuspend", ('log("//");',)),
    ]


def test_expressions_of_any_text(cpp_bundle: CppWriter) -> None:
    folder = cpp_bundle([(0, 1, text) for text in HOSTILE])
    [state, _] = outline(read_bundle(folder)).states
    assert [each.label for each in state.transitions] == [
        'strcmp(name, "a<b>&c") == 0', "a < b && c > d", "'x' == c", "größe > 3", "a || b",
        "// to be written", '"%%{x}%%" "\\n"',
    ]  # fmt: skip
    labels = [edge.label.lines for edge in drawn(folder).edges]
    assert labels[0] == ('1: strcmp(name, "a<b>&c") == 0',)
    assert labels[4] == ("5: a || b",)


def box(x: float, y: float, **more: object) -> dict[str, object]:
    return {"x": x, "y": y, "w": 120.0, "h": 60.0} | more


def path(*points: float) -> dict[str, float]:
    names = ("srcPoint", "controlPoint1", "controlPoint2", "dstPoint")
    return dict(zip((f"{name}{axis}" for name in names for axis in "XY"), points, strict=True))


def test_a_layout_is_kept_as_far_as_it_goes(cpp_bundle: CppWriter) -> None:
    """It lacks a state's box and transitions, and has one transition too many."""
    first = path(160.0, 100.0, 200.0, 90.0, 220.0, 90.0, 240.0, 100.0)
    layout = {
        "A": box(100.0, 100.0, Transitions=[first]),
        "B": box(300.0, 100.0, h=90.0, expanded=True, Transitions=[first, first]),
        "Gone": box(0.0, 0.0),
    }
    files = {"State_B_OnEntry.mm": "x = 1;\n"}
    arcs = [(0, 1, "a"), (0, 2, "b"), (2, 0, "c")]
    diagram = drawn(cpp_bundle(arcs, ["A", "B", "C"], layout=layout, files=files))
    a, b, c = diagram.boxes
    assert [(each.x, each.y, each.width, each.height) for each in (a, b)] == [
        (100, 100, 120, 60), (300, 100, 120, 90)
    ]  # fmt: skip
    assert c.top > max(a.bottom, b.bottom)
    assert b.sections[0].lines == ("x = 1;",)
    assert diagram.edges[0].curve == ((160, 100), (200, 90), (220, 90), (240, 100))


def test_without_a_layout_the_initial_state_is_at_the_top(cpp_bundle: CppWriter) -> None:
    diagram = drawn(cpp_bundle([(0, 1, "a"), (1, 2, "b"), (2, 0, "c")], ["A", "B", "C"]))
    assert [each.top for each in diagram.boxes] == sorted(each.top for each in diagram.boxes)
