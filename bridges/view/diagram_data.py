"""The diagram of a machine as plain data, from which the page draws it."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, Literal

from llfsm.runtime.drawing import Diagram, arrange
from llfsm.runtime.drawing.diagram import Box, Edge, arrow_head
from llfsm.runtime.drawing.shapes import Text
from llfsm.runtime.drawing.typeset import box_lines, label_lines
from llfsm.runtime.engine.errors import DefinitionError
from llfsm.runtime.presence.description import table_of
from llfsm.whiteboard.messages.llfsm import MachineDefinition

from .errors import RequestError

__all__ = ["SECTIONS", "Sections", "diagram_data", "plain_diagram"]

Sections = Literal["auto", "shown", "hidden"]

SECTIONS: dict[str, bool | None] = {"auto": None, "shown": True, "hidden": False}


@lru_cache(maxsize=256)
def diagram_data(
    definition: MachineDefinition, title: str, sections: bool | None
) -> dict[str, Any]:
    """Return what `llfsm draw` draws: boxes, curves and lines of text with their positions.

    Raise `RequestError` if the definition cannot be drawn.
    """
    try:
        diagram = arrange(table_of(definition), title=title, sections=sections)
    except DefinitionError as error:
        raise RequestError(f"{title} cannot be drawn: {error}") from error
    return plain_diagram(diagram)


def plain_diagram(diagram: Diagram) -> dict[str, Any]:
    """Return a diagram as the page draws it; an overview has no start."""
    return {
        "title": diagram.title,
        "frame": (diagram.left, diagram.top, diagram.width, diagram.height),
        "start": {"curve": diagram.start, "head": arrow_head(diagram.start)}
        if diagram.start
        else None,
        "boxes": [_plain_box(box) for box in diagram.boxes],
        "edges": [_plain_edge(edge) for edge in diagram.edges],
    }


@lru_cache(maxsize=4096)
def _plain_box(box: Box) -> dict[str, Any]:
    return {
        "state": box.state,
        "frame": (box.left, box.top, box.width, box.height),
        "initial": box.initial,
        "accepting": box.accepting,
        "suspend": box.suspend,
        "slot": box.slot,
        "lines": _lines(box_lines(box)),
    }


@lru_cache(maxsize=4096)
def _plain_edge(edge: Edge) -> dict[str, Any]:
    label = edge.label
    return {
        "source": edge.source,
        "number": edge.number,
        "target": edge.target,
        "curve": edge.curve,
        "head": arrow_head(edge.curve),
        "label": {
            "frame": (
                label.x - label.width / 2, label.y - label.height / 2, label.width, label.height
            ),
            "lines": _lines(label_lines(label)),
        },
    }  # fmt: skip


def _lines(lines: Iterable[Text]) -> list[tuple[float, float, str, float, str, bool]]:
    return [(line.x, line.y, line.text, line.size, line.face, line.centred) for line in lines]
