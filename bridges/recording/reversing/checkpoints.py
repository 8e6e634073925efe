"""The checkpoints of a recording: how many there are, and from which one machines run on.

A checkpoint is a process that waits at a moment, forked from the one in which the machines ran. It
costs the memory pages that were written since, so there are at most `MOST_CHECKPOINTS`. Of more,
the one goes that is missed least: whose neighbours are close to each other for the distance from
the latest one. So they are dense where somebody looks, and sparse far from there.

Breakpoints that count hits are part of a checkpoint: their counts are those of its process.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from typing import Final, NamedTuple

from llfsm.bridges.recording.reversing.processes import SocketLink
from llfsm.bridges.recording.reversing.reverse_debugger import Jump
from llfsm.bridges.recording.reversing.worker import Moment

MOST_CHECKPOINTS: Final = 48


class Checkpoint(NamedTuple):
    """A process that waits at a moment, and the link to it."""

    at: Moment
    link: SocketLink
    process: int


class Checkpoints:
    """The checkpoints in the order of their moments; closing them ends their processes."""

    def __init__(self) -> None:
        self.all: list[Checkpoint] = []
        self._ended: set[int] = set()  # processes that end, but are not known to have ended

    def add(self, checkpoint: Checkpoint) -> None:
        """Add one; if there are too many, drop the one that is missed least."""
        self.all.append(checkpoint)
        self.all.sort(key=lambda each: each.at.number)
        if len(self.all) > MOST_CHECKPOINTS:
            texts = checkpoint.at.breakpoints
            others = [each for each in self.all if not each.at.counts(texts)]
            self.drop(others[0] if others else self._least(checkpoint.at.number))

    def _least(self, now: int) -> Checkpoint:
        def worth(place: int) -> float:
            before, here, after = (each.at.number for each in self.all[place - 1 : place + 2])
            return (after - before) / (1 + abs(now - here))

        return self.all[min(range(1, len(self.all) - 1), key=worth)]

    def drop(self, checkpoint: Checkpoint) -> None:
        """End the process of one."""
        self.all.remove(checkpoint)
        checkpoint.link.close()
        self.end(checkpoint.process)

    def before(self, jump: Jump) -> Iterator[Checkpoint]:
        """Yield those from which machines can run to a moment, the nearest first.

        One at the moment itself is left out: it cannot show why machines are paused there.
        """
        for checkpoint in reversed(self.all):
            at = checkpoint.at
            is_before = (
                at.number < jump.moment if jump.after_ns is None else at.time_ns <= jump.after_ns
            )
            if is_before and at.counts(jump.breakpoints):
                yield checkpoint

    def close(self) -> None:
        """End all processes, and wait until they have ended."""
        for checkpoint in [*self.all]:
            self.drop(checkpoint)
        for process in self._ended:
            with suppress(ChildProcessError):
                os.waitpid(process, 0)
        self._ended.clear()

    def end(self, process: int) -> None:
        """Note that a process ends, and reap all those that have ended."""
        self._ended.add(process)
        for each in [*self._ended]:
            try:
                if os.waitpid(each, os.WNOHANG)[0]:
                    self._ended.discard(each)
            except ChildProcessError:  # it is not a child of this process
                self._ended.discard(each)
