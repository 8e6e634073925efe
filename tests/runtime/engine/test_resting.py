"""Rounds that change nothing cost little, and nothing else about them is different.

An arrangement that is observed takes each round by itself: so it shows what the others must do.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from definition import BUILT, Defined
from llfsm.runtime import Actuator, Arrangement, Machine, ManualClock, Reason, Sensor, State
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.runtime.presence.status_publisher import StatusPublisher
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

A, B = (Slot(name, Int32) for name in "ab")
KINDS = [Arrangement, Defined] if BUILT else [Arrangement]


class Waits(Machine):
    """Call `look` at each turn that changes nothing."""

    a = Sensor(A)
    b = Actuator(B, at_suspend=Int32(-1))
    look: Callable[[Any], object] = repr
    turns: int = 0

    waiting = State()
    late = State()
    done = State()
    waiting.to(done, when=lambda m: m.stopping)
    waiting.to(late, after_ms=400)
    late.to(done, when=lambda m: m.stopping or m.a is not None)

    @waiting.internal
    def _(self) -> None:
        self.turns += 1
        self.look(self)

    @late.internal
    def _(self) -> None:
        self.turns += 1
        self.look(self)


class Stays(Waits):
    """Wait in another place of the order."""


DEEDS: dict[str, Callable[[Any, Arrangement], object]] = {
    "nothing": lambda machine, arrangement: None,
    "suspend": lambda machine, arrangement: machine.suspend("Stays"),
    "abandon": lambda machine, arrangement: machine.abandon("Stays"),
    "restart": lambda machine, arrangement: machine.restart("Stays"),
    "resume": lambda machine, arrangement: machine.resume("Stays"),
    "unload": lambda machine, arrangement: machine.unload("Stays"),
    "load": lambda machine, arrangement: machine.load("More"),
    "stop one": lambda machine, arrangement: arrangement.stop_machine("Stays"),
    "stop": lambda machine, arrangement: arrangement.stop(),
    "post": lambda machine, arrangement: arrangement.whiteboard[A].add(Int32(1)),  # type: ignore
    "raise": lambda machine, arrangement: 1 // 0,
}


def run(kind: type[Arrangement], deed: str, at: int, *, observed: bool) -> list[object]:
    """Return all that machines see in eighty rounds, and how they stand at the end."""
    seen: list[object] = []
    board, clock = Whiteboard.local(), ManualClock()

    def look(machine: Any) -> None:
        seen.append((machine.name, machine.state_name, arrangement.rounds, clock.now_ns()))
        seen.append(machine.a)
        if machine is first and machine.turns == at:
            DEEDS[deed](machine, arrangement)

    first = Waits(look=look)
    arrangement = kind(
        [first, Stays(look=look)],
        whiteboard=board,
        clock=clock,
        on_error="suspend",
        library={"More": lambda: Stays(look=look)},
        observers=[lambda event: None] if observed else [],
    )
    reason = arrangement.run(max_rounds=80)
    assert first.turns >= at
    seen += [reason, arrangement.rounds, clock.now_ns(), arrangement.roster.standings()]
    return [*seen, board[B].count]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("deed", DEEDS)
@pytest.mark.parametrize("at", [1, 2, 3, 30])
def test_what_is_not_observed_is_the_same(kind: type[Arrangement], deed: str, at: int) -> None:
    assert run(kind, deed, at, observed=False) == run(kind, deed, at, observed=True)


@pytest.mark.parametrize("kind", KINDS)
def test_others_are_looked_after_only_when_something_is_due(
    kind: type[Arrangement], monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: list[bool] = []
    look = StatusPublisher.look
    monkeypatch.setattr(
        StatusPublisher, "look", lambda self, *, idle: [looks.append(idle), look(self, idle=idle)]
    )
    arrangement = kind([Waits()], whiteboard=Whiteboard.local(), clock=ManualClock())
    arrangement.run(max_rounds=35)  # 350 ms: one status that still holds is posted again
    assert len(looks) < 15


@pytest.mark.parametrize("kind", KINDS)
def test_no_python_runs_between_rounds_of_machines_that_wait(
    kind: type[Arrangement], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """On a board of several processes; what happens there does, and is looked after."""
    dozes: list[int] = []

    class Counting(LiveEnvironment):
        def doze(
            self, duration_ns: int, until_ns: int, otherwise: Callable[[int], bool]
        ) -> Callable[[], bool]:
            def counted(deadline_ns: int) -> bool:
                dozes.append(deadline_ns)
                return otherwise(deadline_ns)

            return super().doze(duration_ns, until_ns, counted)

    monkeypatch.setattr(StatusPublisher, "due_ns", 2**63 - 1)

    def look(machine: Any) -> None:
        if machine.turns == 30:
            Whiteboard("board", directory=tmp_path).add_message(A, Int32(1))
        if machine.turns == 60:
            arrangement.stop()

    with Whiteboard("board", directory=tmp_path) as board:
        waits = Waits(look=look)
        arrangement = kind([waits], environment=Counting(board), idle_us=100)
        arrangement.run()
    assert waits.turns >= 60
    first, *_ = dozes
    assert first > 0  # for the message, which has ended a sleep
    assert len(dozes) < 10


@pytest.mark.parametrize("kind", KINDS)
def test_the_end_of_the_board_ends_it(kind: type[Arrangement], tmp_path: Path) -> None:
    board = Whiteboard("board", directory=tmp_path)
    waits = Waits()
    arrangement = kind([waits], whiteboard=board, idle_us=1_000)
    thread = threading.Thread(target=arrangement.run, daemon=True)
    thread.start()
    wait_for(lambda: waits.turns > 20, "it waits")
    Whiteboard("board", directory=tmp_path).remove()
    thread.join()
    assert arrangement.stop_cause == "the whiteboard was closed or removed"
    assert arrangement.reason is Reason.ACCEPTING
    board.close()


@pytest.mark.parametrize("kind", KINDS)
def test_no_machine_has_a_turn_after_the_end(kind: type[Arrangement]) -> None:
    waits = Waits()
    arrangement = kind([waits], clock=ManualClock(), whiteboard=Whiteboard.local())

    def sleep() -> bool:
        arrangement.end()
        return True

    arrangement.round()
    turns = waits.turns
    with pytest.raises(Exception, match="this arrangement has ended"):
        arrangement.kernel.rest(sleep)
    assert waits.turns == turns + 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("deed", ["suspend", "abandon", "restart", "unload", "load", "raise"])
@pytest.mark.parametrize("order", [1, -1])
def test_nobody_sleeps_after_a_change(kind: type[Arrangement], deed: str, order: int) -> None:
    slept: list[int] = []

    def look(machine: Any) -> None:
        if machine.turns == 3:
            DEEDS[deed](machine, arrangement)

    def sleep() -> bool:
        slept.append(arrangement.rounds)
        clock.advance(ms=10)
        return arrangement.rounds < 5

    clock = ManualClock()
    arrangement = kind(
        [Waits(look=look), Stays()][::order],
        whiteboard=Whiteboard.local(),
        clock=clock,
        on_error="suspend",
        library={"More": Stays},
    )
    arrangement.round()
    arrangement.kernel.rest(sleep)
    assert slept == [2]  # in the third round it was done, and a restart left Stays where it was


@pytest.mark.parametrize("kind", KINDS)
def test_an_observer_that_comes_observes_whole_rounds(kind: type[Arrangement]) -> None:
    events: list[str] = []

    def look(machine: Any) -> None:
        if machine.turns == 3:
            arrangement.attach(lambda event: events.append(type(event).__name__))

    arrangement = kind([Waits(look=look)], whiteboard=Whiteboard.local(), clock=ManualClock())
    arrangement.run(max_rounds=6)
    rounds = [event for event in events if event.startswith("Round")]
    assert rounds[rounds.index("RoundBegin") :] == 3 * ["RoundBegin", "RoundEnd"]
