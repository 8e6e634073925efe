"""Why a machine is in its state is what its transitions were when they were evaluated."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Arrangement, Machine, ManualClock, State
from llfsm.runtime.debugging import Debugger
from llfsm.runtime.debugging.obeying import why_of
from llfsm.runtime.engine.errors import ExecutionError
from llfsm.runtime.journal.entries import Journal, entries_of
from llfsm.runtime.journal.journalled import JournalledEnvironment
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import VIEWER, MachineWhy, Viewer, why_slot
from waiting import PATIENCE_S, wait_for

from .machines import running, stopped_at


class Counts(Machine):
    """Count in each turn, after the guards."""

    n: int = 0
    seen: list[int] = []  # noqa: RUF012  a machine has a copy

    low = State()
    high = State()

    @low.internal
    def _(self) -> None:
        self.n += 1
        self.seen.append(self.n)

    @low.to(high)
    def is_third(self) -> bool:
        return self.n == 3 and len(self.seen) == 3

    @low.to(high)
    def is_long(self) -> bool:
        number = self.n * 100
        return number > 1000

    low.to(high, after_ms=100)
    high.to(low, after_ms=50)


class Fails(Machine):
    """Raise in its second guard."""

    n: int = 0

    a = State()
    b = State()
    a.to(b, when=lambda m: m.n > 5)
    a.to(b, when=lambda m: 1 / m.n > 5)
    a.to(b, when=lambda m: m.n < 0)


def seen(debugger: Debugger, machine: str = "Counts") -> list[tuple[object, str]]:
    return [(cause.value, cause.seen) for cause in debugger.why(machine)]


def test_after_a_step_values_are_those_that_were_evaluated() -> None:
    with running(Arrangement([Counts], clock=ManualClock())) as debugger:
        assert seen(debugger)[1:] == [
            (None, "is_long: more than one expression"),
            (None, "elapsed > 100 ms"),
        ]
        for n in range(3):
            stopped_at(debugger)
            assert seen(debugger) == [
                (False, f"n={n} == 3 and len(seen)={n} == 3"),  # though it is one more now
                (False, "is_long: more than one expression"),
                (False, f"{n * 10} ms > 100 ms"),
            ]


def test_a_step_to_a_transition_shows_it() -> None:
    with running(Arrangement([Counts, Fails], clock=ManualClock(), on_error="suspend")) as debugger:
        turn = stopped_at(debugger, until="transition")
        assert (debugger.machine, turn.machine) == ("Counts", "Fails")
        found = why_of(debugger.arrangement, "Counts", debugger.now_ns)
        assert (found.state, found.source, found.failed) == ("high", "low", False)
        assert [(each.value, each.seen) for each in found.before] == [
            (True, "n=3 == 3 and len(seen)=3 == 3"),
            (None, "not evaluated"),
            (None, "not evaluated"),
        ]
        assert [each.value for each in found.transitions] == [None]
        turn = stopped_at(debugger, until="leave", machine="Counts")
        assert (debugger.machine, turn.machine) == ("Counts", "Fails")


def test_at_a_breakpoint_the_elapsed_time_is_known() -> None:
    arrangement = Arrangement([Counts], clock=ManualClock())
    with running(arrangement) as debugger:
        debugger.break_at("Counts:low")
        debugger.proceed()
        debugger.wait(PATIENCE_S)  # in the first state, after OnEntry
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Counts:low"
        assert debugger.fired is not None
        (cause,) = debugger.fired.causes
        assert cause.value is True
        assert cause.seen.endswith("0 ms > 50 ms")


def test_at_a_failure_the_operands_of_the_guard_are_shown() -> None:
    arrangement = Arrangement([Fails, Counts], clock=ManualClock(), on_error="suspend")
    with running(arrangement) as debugger:
        debugger.break_at("Fails!")
        debugger.proceed()
        assert debugger.wait(PATIENCE_S) == "breakpoint Fails!"
        found = why_of(debugger.arrangement, "Fails", debugger.now_ns)
        assert (found.state, found.source, found.failed) == ("Suspended", "a", True)
        assert [(each.value, each.seen) for each in found.before] == [
            (False, "n=0 > 5"),
            (None, "1 / n=0 > 5"),
            (None, "not evaluated"),
        ]
        stopped_at(debugger, until="round")
        assert why_of(debugger.arrangement, "Fails", debugger.now_ns).source == ""


class FailsLater(Machine):
    """Raise in the first guard, in the second turn."""

    n: int = 1

    a = State()
    b = State()
    a.to(b, when=lambda m: 1 / m.n > 5)
    a.to(b, when=lambda m: m.n < 0)

    @a.internal
    def _(self) -> None:
        self.n -= 1


@pytest.mark.parametrize(
    ("machine", "found"),
    [
        (Fails, [(False, "n=0 > 5"), (None, "1 / n=0 > 5"), (None, "not evaluated")]),
        (FailsLater, [(None, "1 / n=0 > 5"), (None, "not evaluated")]),
    ],
)
def test_a_guard_that_has_ended_all_was_evaluated(
    machine: type[Machine], found: list[tuple[object, str]]
) -> None:
    """Also where no breakpoint is at failures, and the turn before is known."""
    arrangement = Arrangement([machine], clock=ManualClock())
    debugger = Debugger(arrangement)
    arrangement.attach(debugger)
    with pytest.raises(ExecutionError):
        arrangement.run()
    sight = debugger.sight(machine.__name__, debugger.now_ns)
    assert sight.evaluated_ns is not None
    assert [(cause.value, cause.seen) for cause in sight.causes] == found


class Looks(Machine):
    """Be watched, and never leave."""

    n: int = 0
    only = State()

    @only.to(only)
    def is_odd(self) -> bool:
        half = self.n / 2
        return half == -1

    @only.internal
    def _(self) -> None:
        self.n += 1


def watched(board: Any) -> MachineWhy:
    """Return what is published first after somebody has asked."""
    slot = board[why_slot("Looks")]
    before = slot.count
    board.add_message(VIEWER, Viewer(1, why=True))
    wait_for(lambda: slot.count > before)
    found = slot.get()
    assert found is not None
    return found


@pytest.mark.parametrize("is_journalled", [False, True])
def test_of_a_machine_that_runs_a_round_is_seen_now_and_then(is_journalled: bool) -> None:
    board, written = Whiteboard.local(), []
    environment: Any = LiveEnvironment(board)
    if is_journalled:
        environment = JournalledEnvironment(environment, Journal(written.append))
    arrangement = Arrangement([Looks], environment=environment)
    with running(arrangement) as debugger:
        assert watched(board).transitions[0].value is None, "no round was seen"
        debugger.proceed()
        wait_for(lambda: not debugger.paused)
        found = watched(board)
        assert found.transitions[0].value is False
        assert found.evaluated_s is not None
        assert 0 <= found.evaluated_s < PATIENCE_S
        wait_for(lambda: all(isinstance(each, Journal) for each in arrangement.kernel.observers))
    if is_journalled:
        kinds = {entry["event"] for data in written for entry in entries_of(data)}
        assert "Eval" in kinds
