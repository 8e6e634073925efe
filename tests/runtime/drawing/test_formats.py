"""What pictures and texts say, whatever states and transitions are called."""

from __future__ import annotations

import re
import sys
from html import unescape
from io import BytesIO
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given, settings
from PIL import Image

from llfsm.machines import RosPingPong
from llfsm.runtime import DrawingError, Machine
from llfsm.runtime.drawing import arrange, to_dot, to_mermaid, to_png, to_svg
from llfsm.runtime.drawing.typeset import numbered_labels, printable, wrap
from llfsm.runtime.engine.table import MachineLayout, StateBox
from thoroughness import examples

from .conftest import machine, machines

SVG = "{http://www.w3.org/2000/svg}"
few = settings(max_examples=examples(25), deadline=None)


def expected(drawn: type[Machine]) -> tuple[list[str], list[tuple[int, int, str]]]:
    """Return the names of states, and each transition as source, target and label."""
    states = drawn.table.states
    return [printable(state.name) for state in states], [
        (states.index(state), states.index(transition.target), printable(label))
        for state in states
        for transition, label in zip(state.transitions, numbered_labels(state), strict=True)
    ]


# Graphviz: a reader of the part of the language that we write

QUOTED = r'"((?:[^"\\]|\\.)*)"'


def graphviz_text(quoted: str) -> str:
    """Return what Graphviz shows for the inside of a quoted string."""
    assert "\n" not in quoted
    shown = re.sub(r"\\(.)", lambda m: {"n": "\n", "l": "\n"}.get(m[1], m[1]), quoted)
    assert not re.search(r"\\[NGELTHr]", re.sub(r"\\\\", "", quoted))
    return unescape(shown)


@few
@given(machines())
def test_dot_says_it_all(drawn: type[Machine]) -> None:
    text = to_dot(drawn.table)
    names, transitions = expected(drawn)
    head, *lines, last = text.removesuffix("\n").split("\n")
    assert re.fullmatch(rf"digraph {QUOTED} {{", head)
    assert last == "}"
    nodes, edges, initial = [], [], []
    for line in lines:
        if node := re.fullmatch(rf"    s\d+ \[label={QUOTED}(.*)\]", line):
            nodes.append(graphviz_text(node[1]))
            marks = node[2]
            state = drawn.table.states[len(nodes) - 1]
            assert ("peripheries=2" in marks) == (not state.transitions)
            assert ("dashed" in marks) == (state is drawn.table.suspend)
        elif edge := re.fullmatch(rf"    s(\d+) -> s(\d+) \[label={QUOTED}\]", line):
            edges.append((int(edge[1]), int(edge[2]), graphviz_text(edge[3])))
        elif start := re.fullmatch(r"    start -> (s\d+)", line):
            initial.append(start[1])
        else:
            assert re.match(r"    (node|edge|start) \[", line), line
    assert nodes == names
    assert edges == transitions
    assert initial == ["s0"]
    assert to_dot(drawn.table) == text


# Mermaid: nothing but letters and its own signs is left to be misread


def mermaid_text(text: str) -> str:
    assert not set(re.sub(r"#\d+;|<br/>", "", text)) & set("\"':;#<>{}[]%\\`*$&\n"), text
    with_lines = text.replace("<br/>", "\n")
    return re.sub(r"#(\d+);", lambda m: chr(int(m[1])), with_lines).replace("\xa0", " ")


@few
@given(machines())
def test_mermaid_says_it_all(drawn: type[Machine]) -> None:
    text = to_mermaid(drawn.table)
    names, transitions = expected(drawn)
    lines = text.removesuffix("\n").split("\n")
    assert lines[0] == lines[2] == "---"
    assert lines[3] == "stateDiagram-v2"
    states, edges, ends = [], [], []
    for line in lines[4:]:
        if state := re.fullmatch(r'    state "(.*)" as s(\d+)', line):
            assert int(state[2]) == len(states)
            states.append(mermaid_text(state[1]))
        elif edge := re.fullmatch(r"    s(\d+) --> s(\d+)(?: : (.*))?", line):
            edges.append((int(edge[1]), int(edge[2]), mermaid_text(edge[3] or "")))
        elif end := re.fullmatch(r"    s(\d+) --> \[\*\]", line):
            ends.append(int(end[1]))
        else:
            assert re.fullmatch(r"    (\[\*\] --> s0|class.*)", line), line
    plain = [(source, target, label.replace("\xa0", " ")) for source, target, label in transitions]
    assert states == [name.replace("\xa0", " ") for name in names]
    assert edges == plain
    assert ends == [i for i, state in enumerate(drawn.table.states) if not state.transitions]
    suspend = drawn.table.suspend
    marked = [line for line in lines if line.startswith("    class s")]
    assert marked == (
        [f"    class s{drawn.table.states.index(suspend)} suspend"] if suspend else []
    )


# SVG


@few
@given(machines())
def test_svg_says_it_all(drawn: type[Machine]) -> None:
    text = to_svg(arrange(drawn.table, title="<T & \x00>"))
    root = ET.fromstring(text)
    assert root.findtext(f"{SVG}title") == "<T & \ufffd>"
    groups = root.findall(f"{SVG}g")
    states = [g for g in groups if "state" in g.get("class").split()]
    names, transitions = expected(drawn)

    def same(a: str, b: str) -> bool:  # XML makes a space of an attribute's newline
        return a.split() == b.split()

    for group, name, state in zip(states, names, drawn.table.states, strict=True):
        assert same(group.get("data-state"), name)
        assert [t.text or "" for t in group.findall(f"{SVG}text")] == list(wrap(state.name))
        kinds = group.get("class").split()
        assert ("initial" in kinds) == (state is drawn.table.initial)
        assert ("accepting" in kinds) == (not state.transitions)
        assert ("suspend" in kinds) == (state is drawn.table.suspend)
        assert len(group.findall(f"{SVG}rect")) == 1 + (not state.transitions)
    marks = [g for g in groups if g.get("class") == "transition"]
    written = [g for g in marks if g.find(f"{SVG}text") is not None]
    numbers = [number for state in drawn.table.states for number in range(len(state.transitions))]
    assert len(marks) == 2 * len(written) == 2 * len(transitions)
    for group, (source, target, label), number in zip(written, transitions, numbers, strict=True):
        assert same(group.get("data-transition"), f"{names[source]}:{number}")
        assert same(group.get("data-target"), names[target])
        assert [t.text or "" for t in group.findall(f"{SVG}text")] == list(wrap(label))
    assert to_svg(arrange(drawn.table, title="<T & \x00>")) == text


def test_numbers_give_the_order_where_there_is_one() -> None:
    two = machine([(0, 1, "first"), (0, 0, "second"), (1, 0, "only")], ["A", "B"])
    printed = to_dot(two.table)
    assert '"1: first"' in printed
    assert '"2: second"' in printed
    assert '"only"' in printed


@pytest.mark.parametrize("write", [to_dot, to_mermaid])
def test_sections_are_written_on_request(write) -> None:
    printed = write(RosPingPong.table, sections=True)
    assert "OnEntry" in printed
    assert "self.count = 0" in printed
    assert "OnEntry" not in write(RosPingPong.table)


# PNG


@settings(max_examples=examples(4), deadline=None)
@given(machines())
def test_png_opens_and_fits(drawn: type[Machine]) -> None:
    diagram = arrange(drawn.table)
    data = to_png(diagram)
    with Image.open(BytesIO(data)) as image:
        assert image.format == "PNG"
        assert image.width == pytest.approx(2 * diagram.width, abs=2)
        assert image.height == pytest.approx(2 * diagram.height, abs=2)
    assert to_png(diagram) == data


def test_every_box_is_on_the_png() -> None:
    diagram = arrange(machine([(0, 1, "a")], ["A", "B", "C"], suspend=2).table)
    image = Image.open(BytesIO(to_png(diagram)))
    ground = image.getpixel((1, 1))
    for box in diagram.boxes:
        x, y = 2 * (box.left - diagram.left), 2 * (box.y - diagram.top)
        assert image.getpixel((round(x + 12), round(y))) == (255, 255, 255)
        border = [image.getpixel((round(x), round(y) + dy)) for dy in range(-12, 12)]
        assert min(sum(pixel) for pixel in border) < sum(ground) / 2


def test_without_pillow_the_error_names_the_extra(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(DrawingError, match=r"pip install 'llfsm\[draw\]'.*draw an SVG"):
        to_png(arrange(RosPingPong.table))


def test_a_png_beyond_memory_is_refused() -> None:
    far = machine([(0, 1, "a")], ["A", "B"])
    far.table.layout = MachineLayout({"A": StateBox(0, 0, 9, 9), "B": StateBox(1e6, 1e6, 9, 9)})
    diagram = arrange(far.table)
    assert ET.fromstring(to_svg(diagram)) is not None
    with pytest.raises(DrawingError, match="too large: draw an SVG"):
        to_png(diagram)
