"""The drawing of a bundle while it is edited: quick, and also if its code cannot be parsed.

States are where the layout has them. Arrows without a path are drawn without looking for free room,
unlike in `llfsm.runtime.drawing.arrange`, which would take seconds for hundreds of them. A label is
at the first of a few places where it covers no box and no other label; arrows may cross it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

from llfsm.runtime.bundles.code import label_of
from llfsm.runtime.bundles.compiling import cpp_label
from llfsm.runtime.bundles.cpp import without_comments
from llfsm.runtime.bundles.model import CLASS, PYTHON, Bundle, BundleState, BundleTransition
from llfsm.runtime.drawing.automatic_layout import automatic_layout, self_loops
from llfsm.runtime.drawing.curves import Curve, Point, at, straight
from llfsm.runtime.drawing.diagram import (
    Arrow,
    Box,
    Diagram,
    Edge,
    Label,
    cut_sections,
    make_box,
    make_label,
)
from llfsm.runtime.drawing.editor_layout import (
    Grid,
    bowed_curve,
    given_curve,
    label_places,
    overlap,
    place_boxes,
)
from llfsm.runtime.drawing.style import MARGIN
from llfsm.runtime.drawing.typeset import RUNS, SectionText, text_lines
from llfsm.runtime.engine.errors import BundleError
from llfsm.runtime.engine.table import MachineLayout, StateBox, TransitionPath

_IN_PYTHON = (PYTHON, CLASS)
_BOW = 26.0  # between arrows that connect the same states
_ALONG = (0.5, 0.28, 0.72)  # where their labels are
_START = 26.0  # the length of the arrow to the initial state
_BESIDE = (0.0, 14.0, -14.0, 40.0, -40.0)  # the arrow, where labels have room
_LOOP = Label(0, 0, 0, 0, ())
_made_label = lru_cache(maxsize=4096)(make_label)


def sketch(bundle: Bundle) -> Diagram:
    """Draw `bundle` where its layout has it, or else placed automatically."""
    if not is_placed(bundle):
        bundle = replace(bundle, layout=automatic(bundle))
    boxes = placed_boxes(bundle)
    paths = {} if bundle.layout is None else bundle.layout.transitions
    pairs: Counter[frozenset[int]] = Counter()
    taken: Grid[Box | Label] = Grid()
    for box in boxes:
        taken.add(box, box.x, box.y, box.width, box.height)
    edges = []
    for arrow in _arrows(bundle):
        own = paths.get(boxes[arrow.source].state, ())
        path = own[arrow.number] if arrow.number < len(own) else None
        pair = frozenset((arrow.source, arrow.target))
        curve, label = _drawn(
            path, boxes[arrow.source], boxes[arrow.target], pairs[pair], arrow.label
        )
        pairs[pair] += 1
        edges.append(arrow.edge(boxes, curve, _placed(label, curve, taken)))
    first = boxes[0]
    start = straight(Point(first.x, first.top - _START), Point(first.x, first.top))
    return _framed(bundle.name, boxes, edges, start)


def is_placed(bundle: Bundle) -> bool:
    """Check that the bundle's layout has any of its states."""
    layout = bundle.layout
    return layout is not None and any(state.name in layout.states for state in bundle.states)


def automatic(bundle: Bundle) -> MachineLayout:
    """Lay out all states and transitions in layers; sizes and colours are kept."""
    old = bundle.layout.states if bundle.layout else {}
    boxes, edges = automatic_layout(_boxes(bundle), list(_arrows(bundle)))
    states = {}
    for box in boxes:
        before = old.get(box.state, StateBox(0, 0, box.width, box.height))
        states[box.state] = before._replace(x=round(box.x, 1), y=round(box.y, 1))
    paths: dict[str, list[TransitionPath]] = {}
    for edge in sorted(edges, key=lambda edge: edge.number):
        paths.setdefault(edge.source, []).append(_path(edge.curve))
    return MachineLayout(states, {name: tuple(each) for name, each in paths.items()})


def placed_boxes(bundle: Bundle) -> list[Box]:
    """Place the boxes of the states where the layout has them, and others in a row below."""
    return place_boxes(_boxes(bundle), bundle.layout or MachineLayout())


def path_between(source: Box, target: Box) -> TransitionPath:
    """Draw a path for an arrow that has none yet."""
    return _path(_drawn(None, source, target, 0, _LOOP)[0])


def _path(curve: Curve) -> TransitionPath:
    """Simplify a curve to one piece, as editors keep it."""
    a, b, c, d = (curve[0], curve[1], curve[-2], curve[-1])
    points = [(round(point.x, 1), round(point.y, 1)) for point in (a, d, b, c)]
    return TransitionPath(*points)


def _arrows(bundle: Bundle) -> Iterable[Arrow]:
    index = {state.name: i for i, state in enumerate(bundle.states)}
    for i, state in enumerate(bundle.states):
        numbered = len(state.transitions) > 1
        for number, transition in enumerate(state.transitions):
            label = _label(transition, python=bundle.language in _IN_PYTHON)
            text = f"{number + 1}: {label}" if numbered else label
            yield Arrow(i, number, index[transition.target], _made_label(text))


def _label(transition: BundleTransition, *, python: bool) -> str:
    if transition.expression is None:
        return "true"
    if not python:
        return cpp_label(transition.expression)
    try:
        return label_of(transition.expression)
    except BundleError:
        return " ".join(transition.expression.text.split())


def _boxes(bundle: Bundle) -> list[Box]:
    given = bundle.layout.states if bundle.layout else {}
    python = bundle.language in _IN_PYTHON
    boxes = []
    for state in bundle.states:
        place = given.get(state.name, StateBox(0, 0, 0, 0))
        runs = (SectionText(RUNS, state.runs),) if state.runs else ()
        shown = runs + (_sections(state, python=python) if place.expanded else ())
        kinds = {
            "initial": state is bundle.states[0],
            "accepting": state.accepting,
            "suspend": state.name == bundle.suspend,
        }
        boxes.append(_made_box(state.name, shown, place.w, place.h, **kinds))
    return boxes


@lru_cache(maxsize=4096)
def _made_box(
    name: str, sections: tuple[SectionText, ...], width: float, height: float, **kinds: bool
) -> Box:
    cut = cut_sections(name, sections, width, height)
    return make_box(name, cut, width=width, height=height, **kinds)


def _sections(state: BundleState, *, python: bool) -> tuple[SectionText, ...]:
    texts = ((key, fragment.text) for key, fragment in state.sections.items())
    return tuple(
        SectionText(key, text_lines(text))
        for key, text in texts
        if python or without_comments(text).strip()
    )


@lru_cache(maxsize=4096)
def _drawn(
    path: TransitionPath | None, source: Box, target: Box, beside: int, label: Label
) -> tuple[Curve, Label]:
    """Draw an arrow and its label; `beside` others before it connect the same states."""
    curve = None if path is None else given_curve(path, source, target)
    if curve is None and source.state == target.state:
        loops = self_loops(source, [label] * (beside + 1))
        return loops[-1]
    if curve is None:
        curve = bowed_curve(source, target, _BOW * beside)
    middle = at(curve, _ALONG[beside % len(_ALONG)])[0]
    return curve, replace(label, x=middle.x, y=middle.y)


def _placed(label: Label, curve: Curve, taken: Grid[Box | Label]) -> Label:
    """Add a label where it covers nothing, else where it is."""
    width, height = label.width, label.height
    for each in _label_places(label, curve):
        near = taken.near(each.x, each.y, width, height)
        if not any(overlap(each, other) for other in near):
            label = each
            break
    taken.add(label, label.x, label.y, width, height)
    return label


@lru_cache(maxsize=4096)
def _label_places(label: Label, curve: Curve) -> tuple[Label, ...]:
    """List places for a label: where it is, along its arrow and beside it."""
    others = label_places(label, curve, _BESIDE, _ALONG)
    return (label, *(replace(label, x=x, y=y) for x, y in others))


def _framed(title: str, boxes: Sequence[Box], edges: Sequence[Edge], start: Curve) -> Diagram:
    points = [*start, *(point for edge in edges for point in edge.curve)]
    x = [point.x for point in points] + [side for box in boxes for side in (box.left, box.right)]
    y = [point.y for point in points] + [side for box in boxes for side in (box.top, box.bottom)]
    left, top = min(x) - MARGIN, min(y) - MARGIN
    width, height = max(x) + MARGIN - left, max(y) + MARGIN - top
    return Diagram(title, left, top, width, height, tuple(boxes), tuple(edges), start)
