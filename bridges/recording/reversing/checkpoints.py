"""The processes that are kept at moments of a recording: how many, and which one helps."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from typing import Final, NamedTuple

from llfsm.bridges.recording.reversing.processes import ProcessLink
from llfsm.bridges.recording.reversing.reverse_debugger import Jump
from llfsm.bridges.recording.reversing.worker import Moment

MOST_POINTS: Final = 48
"""How many moments are kept. More would take memory: each has the pages that were written since."""


class KeptPoint(NamedTuple):
    """A process that is kept at a moment."""

    at: Moment
    link: ProcessLink
    process: int


class KeptPoints:
    """The moments that are kept, in their order; closing them ends their processes.

    If there are too many, they become the sparser, the farther they are from the latest one.
    """

    def __init__(self) -> None:
        self.points: list[KeptPoint] = []
        self._ended: set[int] = set()

    def add(self, point: KeptPoint) -> None:
        """Add one; if there are too many, end the process of the one that is missed least."""
        self.points.append(point)
        self.points.sort(key=lambda each: each.at.number)
        if len(self.points) > MOST_POINTS:
            texts = point.at.breakpoints
            others = [each for each in self.points if not each.at.counts(texts)]
            self.drop(others[0] if others else self._least(point.at.number))

    def _least(self, now: int) -> KeptPoint:
        def worth(place: int) -> float:
            before, here, after = (each.at.number for each in self.points[place - 1 : place + 2])
            return (after - before) / (1 + abs(now - here))

        return self.points[min(range(1, len(self.points) - 1), key=worth)]

    def drop(self, point: KeptPoint) -> None:
        """End the process of one."""
        self.points.remove(point)
        point.link.close()
        self.end(point.process)

    def usable(self, jump: Jump) -> Iterator[KeptPoint]:
        """Return those from which machines can run to a moment, the nearest first.

        One at the moment itself cannot show why machines are paused there.
        """
        for point in reversed(self.points):
            at = point.at
            is_before = (
                at.number < jump.moment if jump.after_ns is None else at.time_ns <= jump.after_ns
            )
            if is_before and at.counts(jump.breakpoints):
                yield point

    def close(self) -> None:
        """End all processes, and wait for that."""
        for point in [*self.points]:
            self.drop(point)
        for process in self._ended:
            with suppress(ChildProcessError):
                os.waitpid(process, 0)
        self._ended.clear()

    def end(self, process: int) -> None:
        """Note that a process ends, and let go of those that have ended."""
        self._ended.add(process)
        for each in [*self._ended]:
            try:
                if os.waitpid(each, os.WNOHANG)[0]:
                    self._ended.discard(each)
            except ChildProcessError:  # it is not a child of this process
                self._ended.discard(each)
