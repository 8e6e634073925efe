"""All that machines learn and do passes their arrangement's environment, whichever it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest

from llfsm.runtime import (
    Actuator,
    Arrangement,
    Machine,
    ManualClock,
    OptionError,
    Sensor,
    State,
    Status,
    Trace,
    UnknownMachineError,
)
from llfsm.runtime.engine.environment import BoardEnvironment, Environment, Post, Read
from llfsm.runtime.journal.entries import Journal
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Board, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

NUMBER = Slot("number", Int32)
SUM = Slot("sum", Int32)
INPUTS = (None, 1, 1, 5, 2, None, 7)


class Adder(Machine):
    """Add up what it senses, until that is more than ten; then ask another machine."""

    number = Sensor(NUMBER, default=Int32(data=-1))
    report = Actuator(SUM, at_end=Int32(data=99))
    total: int = 0

    adding = State()
    asking = State()
    done = State()

    @adding.internal
    def _(self) -> None:
        self.total += self.number.data
        self.report(Int32(data=self.total))

    adding.to(asking, when=lambda m: m.total > 10)

    @asking.on_entry
    def _(self) -> None:
        self.suspend("Elsewhere")

    asking.to(done, after_ms=15, when=lambda m: m.is_suspended("Elsewhere"))


class FakeMachine:
    """A machine of another process that does at once what is requested."""

    def __init__(self) -> None:
        self.state, self.suspended = "RUN", False

    def request(self, action: str) -> Status:
        before = Status.SUSPENDED if self.suspended else Status.RUNNING
        self.suspended = action == "suspend"
        return before


class Elsewhere(Environment):
    """Have one machine of another process in an environment."""

    other: FakeMachine

    def elsewhere(self, name: str, known: Iterable[str]) -> FakeMachine:
        if name != "Elsewhere":
            raise UnknownMachineError(name, known)
        return self.other


class Scripted(Elsewhere):
    """An environment without any board: `now` is what sensors read, `posts` what was posted."""

    def __init__(self, clock: ManualClock):
        super().__init__(clock)
        self.other = FakeMachine()
        self.now: int | None = None
        self.posts: list[int] = []

    def read(self, machine: str, name: str, sensor: Any, slot: Slot[Any]) -> Read:
        assert (machine, name, slot.name) == ("Adder", "number", "number")
        return lambda: None if self.now is None else Int32(data=self.now)

    def post(self, machine: str, name: str, actuator: Any, slot: Slot[Any]) -> Post:
        assert (machine, name, slot.name) == ("Adder", "report", "sum")

        def post(message: Int32) -> int:
            self.posts.append(message.data)
            return len(self.posts)

        return post


class OnBoard(Elsewhere, BoardEnvironment):
    """The same on a board."""

    def __init__(self, board: Board, clock: ManualClock):
        super().__init__(board, clock)
        self.other = FakeMachine()


class OnLiveBoard(Elsewhere, LiveEnvironment):
    """The same on a board that other processes might see."""

    def __init__(self, board: Board, clock: ManualClock):
        super().__init__(board, clock)
        self.other = FakeMachine()


Run = tuple[Trace, list[int]]


def scripted(wrap: Callable[[Environment], Environment]) -> Run:
    clock = ManualClock()
    world = Scripted(clock)

    def feed(value: int | None) -> None:
        world.now = value

    trace = run(wrap(world), clock, feed)
    return trace, world.posts


def on_board(kind: Callable[..., Environment], wrap: Callable[[Environment], Environment]) -> Run:
    clock, board = ManualClock(), Whiteboard.local()
    posts: list[int] = []

    def feed(value: int | None) -> None:
        if value is not None:
            board.add_message(NUMBER, Int32(data=value))

    def look() -> None:  # at most one message is posted between two looks
        latest = board.get_message(SUM)
        if latest is not None and board[SUM].count > len(posts):
            posts.append(latest.data)

    trace = run(wrap(kind(board, clock)), clock, feed, look)
    assert board[SUM].count == len(posts)
    return trace, posts


def run(
    world: Environment,
    clock: ManualClock,
    feed: Callable[[int | None], None],
    look: Callable[[], None] = lambda: None,
) -> Trace:
    trace = Trace()
    with Arrangement([Adder], environment=world, observers=[trace]) as arrangement:
        last: int | None = None
        for value in INPUTS:
            last = value if value is not None else last  # a board keeps its latest message
            feed(last)
            arrangement.round()
            look()
            clock.advance(ms=10)
        while not arrangement.finished:
            arrangement.round()
            clock.advance(ms=10)
    look()
    return trace


def as_it_is(world: Environment) -> Environment:
    return world


def in_a_journal(world: Environment) -> Environment:
    return JournalledEnvironment(world, Journal(lambda _: None))


def in_two_journals(world: Environment) -> Environment:
    return in_a_journal(in_a_journal(world))


@pytest.mark.parametrize("wrap", [as_it_is, in_a_journal, in_two_journals])
def test_machines_do_the_same_in_every_environment(
    wrap: Callable[[Environment], Environment],
) -> None:
    expected = scripted(as_it_is)
    assert expected[1] == [-1, 0, 1, 6, 8, 10, 17, 99]
    assert expected[0].sections()[-1][2:] == ("Internal", "done")
    assert scripted(wrap) == expected
    assert on_board(OnBoard, wrap) == expected
    assert on_board(OnLiveBoard, wrap) == expected


def test_a_journal_forwards_requests_to_the_environment_that_it_wraps() -> None:
    class Noting(Scripted):
        def requested(self, action: str, machine: str) -> None:
            noted.append((action, machine))

        def retire(self, machine: str) -> None:
            noted.append(("retire", machine))

    noted: list[tuple[str, str]] = []
    world = in_two_journals(Noting(ManualClock()))
    with Arrangement([Adder], environment=world) as arrangement:
        arrangement.restart("Adder")
        world.retire("Adder")
    assert noted == [("restart", "Adder"), ("retire", "Adder")]


def test_a_move_leaves_machines_where_they_are_and_connects_them_anew() -> None:
    clock, first, second = ManualClock(), Whiteboard.local(), Whiteboard.local()
    arrangement = Arrangement([Adder], environment=BoardEnvironment(first, clock))
    first.add_message(NUMBER, Int32(data=3))
    second.add_message(NUMBER, Int32(data=4))
    arrangement.round()
    arrangement.kernel.move(BoardEnvironment(second, clock))
    arrangement.round()
    assert first.get_message(SUM) == Int32(data=3)
    assert second.get_message(SUM) == Int32(data=7)
    assert arrangement.whiteboard is second


def test_a_whiteboard_beside_an_environment_is_refused() -> None:
    with pytest.raises(OptionError, match="give an environment, or a whiteboard and a clock"):
        Arrangement(environment=Environment(), whiteboard=Whiteboard.local())
    with pytest.raises(OptionError, match="give an environment, or a whiteboard and a clock"):
        Arrangement(environment=Environment(), clock=ManualClock())


def test_an_arrangement_on_a_whiteboard_can_be_seen_by_others() -> None:
    assert isinstance(Arrangement(whiteboard=Whiteboard.local()).environment, LiveEnvironment)
    assert type(Arrangement().environment) is Environment
