"""A second Ctrl-C, whenever it comes: every safe value is posted, once."""

from __future__ import annotations

import _weakrefset
import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import FrameType
from typing import Any

import pytest

from llfsm.runtime import Actuator, Arrangement, ExecutionError, Machine, ManualClock, State
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64

_TRIES = 60  # calls at which it comes, of a thousand: all of them take ten seconds
SLOTS = [Slot(f"wheel{n}", Int64) for n in range(3)]


@pytest.fixture(autouse=True)
def _untraced() -> Iterator[None]:
    """Collect no garbage meanwhile: Python drops what a callback of the collector raises."""
    gc.disable()
    yield
    sys.settrace(None)
    gc.enable()


class Wheels(Machine):
    """Has safe values for two wheels, and never ends by itself."""

    left = Actuator(SLOTS[0], at_end=Int64(1))
    right = Actuator(SLOTS[1], at_end=Int64(2))

    rolling = State()
    there = State()
    rolling.to(there, when=lambda self: False)


class Accepting(Wheels):
    """Accepts when it is asked to stop, so it is unloaded before the others."""

    over = State()
    Wheels.rolling.to(over, when=lambda self: self.stopping)


class Failing(Wheels):
    """Fails when it is asked to stop."""

    @Wheels.there.on_entry
    def _(self) -> None:
        raise ValueError("bang")

    Wheels.rolling.to(Wheels.there, when=lambda self: self.stopping)


class Third(Machine):
    """Has one for another wheel."""

    wheel = Actuator(SLOTS[2], at_end=Int64(3))

    rolling = State()
    there = State()
    rolling.to(there, when=lambda self: False)


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)


class Interrupting(ManualClock):
    """Sends the first SIGINT in the second sleep."""

    sleeps = 0

    def sleep_until_ns(self, deadline_ns: int) -> None:
        super().sleep_until_ns(deadline_ns)
        self.sleeps += 1
        if self.sleeps == 2:
            interrupt()


def run(machine: type[Machine], at_call: Callable[[int], None]) -> list[int]:
    """Run until the end; return the messages' values.

    Calls and returns from them count from the stop on: this is where Python runs handlers. Those of
    a `WeakSet` do not: Python drops what the callback of a weak reference raises.
    """
    board, number = Whiteboard.local(), 0
    arrangement = Arrangement([machine, Third], whiteboard=board, clock=Interrupting())

    def trace(frame: FrameType, event: str, _: object) -> Any:
        nonlocal number
        frame.f_trace_lines = False
        if arrangement.stopping and frame.f_code.co_filename != _weakrefset.__file__:
            number += 1
            at_call(number)
        return trace

    def traced() -> None:
        sys.settrace(trace)
        try:
            arrangement.run(grace_s=0.01)
        finally:
            sys.settrace(None)

    with suppress(KeyboardInterrupt, ExecutionError):
        traced()
    assert all(board[slot].count == 1 for slot in SLOTS)
    return [message.data for slot in SLOTS if (message := board.get_message(slot)) is not None]


@pytest.mark.parametrize("machine", [Wheels, Accepting, Failing])
def test_it_keeps_no_safe_value_from_being_posted(machine: type[Machine]) -> None:
    calls = 0

    def count(number: int) -> None:
        nonlocal calls
        calls = number

    assert run(machine, count) == [1, 2, 3]
    assert calls >= _TRIES
    for call in range(1, calls + 1, calls // _TRIES):

        def second(number: int, call: int = call) -> None:
            if number == call:
                sys.settrace(None)
                interrupt()

        assert run(machine, second) == [1, 2, 3], f"at call {call}"
