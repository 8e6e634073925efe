"""Machines that others see and control, a clock to look at them by, and requests for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llfsm.runtime import Machine, ManualClock, State
from llfsm.whiteboard import Board
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    Bell,
    MachineRequest,
    MachineStatus,
    request_slot,
    status_slot,
)


class Steps(Machine):
    """Go round three states, 30 ms in each."""

    first = State()
    second = State()
    third = State()

    first.to(second, after_ms=29)
    second.to(third, after_ms=29)
    third.to(first, after_ms=29)


class Spins(Machine):
    """Fire in every turn, so that rounds never rest."""

    ping = State()
    pong = State()
    ping.to(pong)
    pong.to(ping)


class Idle(Machine):
    """Stay for ever, whatever is asked."""

    saw_stopping: int = 0

    a = State()
    b = State()
    a.to(b, when=lambda m: False)

    @a.internal
    def _(self) -> None:
        self.saw_stopping += self.stopping


class Caller(Machine):
    """Call one that stays for ever."""

    a = State()
    b = State()
    a.to(b, when=lambda m: False)

    @a.on_entry
    def _(self) -> None:
        self.call_machine(Idle, detached=True)


class Obedient(Machine):
    """Accept when asked to stop."""

    a = State()
    b = State()
    a.to(b, when=lambda m: m.stopping)


class Target(Machine):
    """Tell by its sections what was done to it."""

    a = State()
    b = State()
    asleep = State(suspend=True)

    a.to(b, after_ms=25)
    b.to(a, after_ms=25)

    @a.on_entry
    @b.on_entry
    @asleep.on_entry
    def _(self) -> None: ...


class Clock(ManualClock):
    """Do something at each sleep, before time goes on; `look` gets how many there were before."""

    def __init__(self, look: Callable[[int], object] = int) -> None:
        super().__init__()
        self.look = look
        self.sleeps = 0

    def sleep_until_ns(self, deadline_ns: int) -> None:
        self.look(self.sleeps)
        self.sleeps += 1
        super().sleep_until_ns(deadline_ns)


def status_of(board: Board, name: str) -> MachineStatus:
    status = board.get_message(status_slot(name))
    assert status is not None
    return status


def ask(board: Board, name: str, action: Any) -> None:
    """Post a request as another process does."""
    board.add_message(request_slot(name), MachineRequest(action))
    board.add_message(BELL, Bell(name))
