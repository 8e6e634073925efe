"""Machines that do everything by which a run can depend on its world."""

from __future__ import annotations

from llfsm.runtime import Actuator, Machine, Sensor, State, Submachine, UnknownMachineError
from llfsm.whiteboard import Message, Slot


class Number(Message):
    value: int = 0


COMMAND = Slot("command", Number)
SEEN = Slot("seen", Number)


class Follower(Machine):
    """Go where the command says; count the posts by what the whiteboard returns."""

    command = Sensor(COMMAND, default=Number(0))
    again = Sensor(COMMAND)
    fresh = Sensor(COMMAND, max_age_ms=40)
    new = Sensor(COMMAND, since_start=True)
    seen = Actuator(SEEN, at_end=Number(-1))
    posts: int = 0
    limit: int = 5

    low = State()
    high = State()
    done = State()

    @low.on_entry
    def _(self) -> None:
        self.posts = self.seen(Number(self.command.value))

    @low.internal
    def _(self) -> None:
        if self.again is not None and self.again.value % 7 == 3:
            self.seen(self.again)
        if self.fresh is not None and self.fresh.value % 7 == 4:
            self.seen(Number(round(self.age_ms("fresh") or 0)))
        if self.new is not None and self.new.value % 7 == 5:
            self.seen(Number(round(self.age_ms("again") or 0)))

    @high.on_entry
    def _(self) -> None:
        self.seen(Number(self.posts))

    @low.to(high, after_ms=15)
    def above(self) -> bool:
        return self.command.value > self.limit

    high.to(low, when=lambda m: m.after_ms(25) and m.command.value <= m.limit)
    low.to(done, when=lambda m: m.stopping)
    high.to(done, when=lambda m: m.stopping)


class Helper(Machine):
    """Wait for a while and be done."""

    wait = State()
    over = State()
    wait.to(over, after_ms=30)


class Keeper(Machine):
    """Suspend, resume, restart and abandon others, call submachines, ask for machines elsewhere."""

    command = Sensor(COMMAND, default=Number(0))
    sub: Submachine[Helper] | None = None
    known: int = 0

    watch = State()
    call = State()
    ask = State()
    rest = State(suspend=True)

    @watch.internal
    def _(self) -> None:
        try:
            match self.command.value % 8:
                case 1:
                    self.suspend("Follower")
                case 2:
                    self.resume("Follower")
                case 3:
                    self.restart("Follower")
                case 4 if self.is_running("Follower"):
                    self.abandon("Follower")
        except UnknownMachineError:
            self.known -= 1

    watch.to(call, when=lambda m: m.command.value % 8 == 5)
    watch.to(ask, when=lambda m: m.command.value % 8 == 6)

    @call.on_entry
    def _(self) -> None:
        self.sub = self.call_machine(Helper)

    call.to(watch, when=lambda m: m.sub is not None and m.sub.done)

    @ask.on_entry
    def _(self) -> None:
        try:
            self.known += self.is_suspended("Elsewhere")
            if self.state_name_of("Elsewhere") == "low":
                self.suspend("Elsewhere")
        except UnknownMachineError:
            self.known -= 1

    ask.to(watch)


class Failing(Machine):
    """Raise as soon as the command is a multiple of eleven."""

    command = Sensor(COMMAND, default=Number(1))

    good = State()
    better = State()

    @good.internal
    def _(self) -> None:
        if self.command.value % 11 == 0:
            raise ValueError(f"{self.command.value} is too much")

    good.to(better, when=lambda m: False)
