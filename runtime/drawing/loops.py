"""Transitions from a state to itself: loops at a side of its box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from .diagram import Box, Label
from .shapes import Curve, PicturePoint

__all__ = ["loop_room", "self_loops"]

_HEIGHT = 32.0
_END = 8.0  # from a loop's middle to its ends
_SWING = 2.2  # how much wider a loop is than at its ends
_REACH = 28.0
_GAP = 3.0


def loop_room(labels: Sequence[Label]) -> tuple[float, float]:
    """Return the width that loops take beside their box, and the height of box that they need."""
    width = max((_REACH + _GAP + label.width for label in labels), default=0)
    return width, len(labels) * _pitch(labels)


def self_loops(box: Box, labels: Sequence[Label], side: int = 1) -> list[tuple[Curve, Label]]:
    """Return loops at the right of a box, or the left if `side` is -1, the first at the top.

    Their labels are in their places.
    """
    pitch = min(_pitch(labels), box.height / max(len(labels), 1))  # an editor's box may be small
    end = min(_END, 0.4 * pitch)
    y = box.y - (len(labels) - 1) / 2 * pitch
    border = box.right if side > 0 else box.left
    reach = side * _REACH / 0.75  # a curve goes three quarters of the way to its control points
    loops: list[tuple[Curve, Label]] = []
    for label in labels:
        curve = (
            PicturePoint(border, y - end),
            PicturePoint(border + reach, y - _SWING * end),
            PicturePoint(border + reach, y + _SWING * end),
            PicturePoint(border, y + end),
        )
        beside = replace(label, x=border + side * (_REACH + _GAP + label.width / 2), y=y)
        loops.append((curve, beside))
        y += pitch
    return loops


def _pitch(labels: Sequence[Label]) -> float:
    return max((_HEIGHT, *(label.height + 4 for label in labels)))
