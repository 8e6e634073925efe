"""Machines to debug, and a thread in which they run."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llfsm.runtime import Actuator, Arrangement, Machine, Sensor, State, Trace
from llfsm.runtime.debugging import Debugger
from llfsm.runtime.engine.events import Turn
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import PATIENCE_S

__all__ = ["DRIVE", "POSE", "Counter", "Driver", "running", "stopped_at"]

POSE, DRIVE = Slot("pose", Int32), Slot("drive", Int32)


class Counter(Machine):
    """Count turns, and change the state at each third."""

    turns: int = 0

    low = State()
    high = State()

    @low.internal
    @high.internal
    def _(self) -> None:
        self.turns += 1

    @low.to(high)
    @high.to(low)
    def is_third(self) -> bool:
        return self.turns % 3 == 2 and self.bump()

    def bump(self) -> bool:
        """Count this turn, too."""
        self.turns += 1
        return True


class Driver(Machine):
    """Drive until something is near, or asked to stop."""

    pose = Sensor(POSE, default=Int32(data=0))
    drive = Actuator(DRIVE, at_suspend=Int32(data=0))
    limit: int = 9

    going = State()
    waiting = State()
    done = State()

    @going.on_entry
    def _(self) -> None:
        self.drive(Int32(data=1))

    @going.to(waiting)
    def near(self) -> bool:
        return self.pose.data > self.limit

    waiting.to(going, when=lambda m: m.pose.data <= m.limit and m.after_ms(20))
    going.to(done, when=lambda m: m.stopping)
    waiting.to(done, when=lambda m: m.stopping)


@contextmanager
def running(arrangement: Arrangement) -> Iterator[Debugger]:
    """Run an arrangement in a thread, paused before its first turn; in the end stop it."""
    debugger = Debugger.of(arrangement)
    debugger.pause()
    thread = threading.Thread(target=arrangement.run, kwargs={"grace_s": 0.0})
    thread.start()
    try:
        debugger.wait(PATIENCE_S)
        yield debugger
    finally:
        arrangement.stop()
        thread.join()


def stopped_at(debugger: Debugger, **step: Any) -> Turn:
    """Make a step, and return the turn before which it ended."""
    debugger.step(**step)
    debugger.wait(PATIENCE_S)
    turn = debugger.turn
    assert turn is not None
    return turn


def turns(trace: Trace) -> list[tuple[int, str]]:
    """Return the round and machine of each turn."""
    return [(event.round, event.machine) for event in trace if isinstance(event, Turn)]
