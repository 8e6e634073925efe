"""What is known of one frame: its transforms to its parent in the last seconds, as in tf2."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import NamedTuple

from ..errors import ExtrapolationError
from .quaternions import Quaternion, Vector, slerp

__all__ = ["FrameHistory", "StaticFrame", "Transformation"]


class Transformation(NamedTuple):
    """A frame's place in its parent frame at a time."""

    stamp_ns: int
    parent: str
    offset: Vector
    """Metres."""
    turn: Quaternion


class StaticFrame:
    """A frame that never moves in its parent."""

    def __init__(self) -> None:
        self._only: Transformation | None = None

    @property
    def latest(self) -> tuple[int, str]:
        """The time of the newest transform, 0: any time; and its parent."""
        assert self._only is not None  # none is made without a transform
        return 0, self._only.parent

    def add(self, transform: Transformation) -> bool:
        """Replace the transform."""
        self._only = transform
        return True

    def at(self, stamp_ns: int) -> Transformation:
        """Return the transform, which holds at any time."""
        assert self._only is not None
        return self._only._replace(stamp_ns=stamp_ns)


class FrameHistory:
    """The transforms of the `keep_ns` before the newest, by time."""

    def __init__(self, keep_ns: int) -> None:
        self._keep_ns = keep_ns
        self._stamps: list[int] = []
        self._known: list[Transformation] = []

    @property
    def latest(self) -> tuple[int, str]:
        """The time of the newest transform, and its parent."""
        return self._stamps[-1], self._known[-1].parent

    def add(self, transform: Transformation) -> bool:
        """Add a transform; return False for one that is too old to be kept."""
        stamps, known = self._stamps, self._known
        if stamps:
            oldest = stamps[-1] - self._keep_ns
            gone = bisect_left(stamps, oldest)
            del stamps[:gone], known[:gone]
            if transform.stamp_ns < oldest:
                return False
        place = bisect_right(stamps, transform.stamp_ns)
        if transform not in known[bisect_left(stamps, transform.stamp_ns) : place]:
            stamps.insert(place, transform.stamp_ns)
            known.insert(place, transform)
        return True

    def at(self, stamp_ns: int) -> Transformation:
        """Return the transform at a time between the oldest and the newest.

        Between two of one parent it is interpolated; between two parents it is the older one. Raise
        :class:`.ExtrapolationError`.
        """
        stamps, known = self._stamps, self._known
        if stamp_ns == stamps[-1]:
            return known[-1]
        if stamp_ns == stamps[0]:
            return known[0]
        if len(stamps) == 1:
            raise ExtrapolationError(
                f"Lookup would require extrapolation at time {_text(stamp_ns)}, "
                f"but only time {_text(stamps[0])} is in the buffer"
            )
        if stamp_ns > stamps[-1]:
            raise ExtrapolationError(
                "Lookup would require extrapolation into the future.  Requested time "
                f"{_text(stamp_ns)} but the latest data is at time {_text(stamps[-1])}"
            )
        if stamp_ns < stamps[0]:
            raise ExtrapolationError(
                "Lookup would require extrapolation into the past.  Requested time "
                f"{_text(stamp_ns)} but the earliest data is at time {_text(stamps[0])}"
            )
        place = bisect_right(stamps, stamp_ns)
        before, after = known[place - 1], known[place]
        return before if before.parent != after.parent else _between(before, after, stamp_ns)


def _between(before: Transformation, after: Transformation, stamp_ns: int) -> Transformation:
    ratio = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    x, y, z = (
        (1.0 - ratio) * one + ratio * other
        for one, other in zip(before.offset, after.offset, strict=True)
    )
    return Transformation(stamp_ns, before.parent, (x, y, z), slerp(before.turn, after.turn, ratio))


def _text(ns: int) -> str:
    """Return a time in seconds, as tf2 prints it."""
    return f"{ns // 1_000_000_000 + 1e-9 * (ns % 1_000_000_000):.6f}"
