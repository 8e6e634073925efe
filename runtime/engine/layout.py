"""Where an editor has drawn a machine: the boxes of its states and the curves of its arrows.

Coordinates are the editor's points, x to the right and y downwards. A layout is a hint: it may
lack states and transitions, and running a machine never reads it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

__all__ = ["MachineLayout", "Point", "StateBox", "TransitionPath"]

Point: TypeAlias = tuple[float, float]


@dataclass(frozen=True)
class StateBox:
    """The box of a state: its centre, its size, and whether its sections are shown.

    `more` is what else an editor keeps of it, as colours and the heights of sections, by the names
    in its property list: kept, and never looked at.
    """

    x: float
    y: float
    w: float
    h: float
    expanded: bool = False
    more: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class TransitionPath:
    """The arrow of a transition: a cubic Bézier curve."""

    src: Point
    dst: Point
    control1: Point
    control2: Point


@dataclass(frozen=True)
class MachineLayout:
    """The boxes of states by name, and the paths of each state's transitions, in their order."""

    states: dict[str, StateBox] = field(default_factory=dict)
    transitions: dict[str, tuple[TransitionPath, ...]] = field(default_factory=dict)
