"""Machines that call others, and machines to call."""

from __future__ import annotations

from typing import Any

from llfsm.runtime import Actuator, Machine, State
from llfsm.whiteboard import Message, Slot


class Number(Message):
    value: int = 0


SAID = Slot("said", Number)


class Says(Machine):
    """Say a number, for ever."""

    what: int = 1

    say = Actuator(SAID, at_end=Number(-7))

    saying = State()
    never = State()
    saying.to(never, when=lambda m: False)

    @saying.internal
    def _(self) -> None:
        self.say(Number(self.what))


class Square(Machine):
    """Take a few turns to square a number."""

    number: int = 0
    result: int | None = None
    patience: int = 3

    thinking = State()
    ready = State()

    @thinking.internal
    def _(self) -> None:
        self.patience -= 1

    @thinking.to(ready)
    def thought(self) -> bool:
        return self.patience == 0

    @ready.on_entry
    def _(self) -> None:
        self.result = self.number * self.number


class Stuck(Machine):
    a = State()
    b = State()
    a.to(b, when=lambda m: False)


class Breaks(Machine):
    """Raise in its second turn."""

    turns: int = 0
    a = State()
    b = State()
    a.to(b, when=lambda m: False)

    @a.internal
    def _(self) -> None:
        self.turns += 1
        if self.turns == 2:
            raise ValueError("bang")


class Sums(Machine):
    """Sum squares that another machine computes, one call after another."""

    upto: int = 3
    next: int = 1
    total: int = 0
    called: Any = None
    library_name: str = ""

    calling = State()
    adding = State()
    done = State()

    @calling.on_entry
    def _(self) -> None:
        what = self.library_name or Square
        self.called = self.call_machine(what, variables={"number": self.next})

    calling.to(adding, when=lambda self: self.called.done)

    @adding.on_entry
    def _(self) -> None:
        self.total += self.called.machine.result
        self.next += 1

    adding.to(done, when=lambda self: self.next > self.upto)
    adding.to(calling)


class Calls(Machine):
    """Call a machine and do as one likes with it."""

    what: Any = None
    called: Any = None
    detached: bool = False
    a = State()
    b = State()
    a.to(b, when=lambda m: False)

    @a.on_entry
    def _(self) -> None:
        self.called = self.call_machine(self.what, detached=self.detached)


class Counts(Machine):
    rounds: int = 0
    a = State()
    b = State()
    a.to(b, when=lambda m: False)

    @a.internal
    def _(self) -> None:
        self.rounds += 1
