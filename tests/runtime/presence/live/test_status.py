"""The status of each machine on the whiteboard: what is in it, and when it is published."""

from __future__ import annotations

import os
from itertools import pairwise

import pytest

from llfsm.runtime import Arrangement, Machine, ManualClock, State
from llfsm.runtime.engine.events import Event, RoundEnd
from llfsm.runtime.engine.seat import Arrival, Seat
from llfsm.runtime.presence.status_publisher import StatusPublisher
from llfsm.whiteboard import Board
from llfsm.whiteboard.liveness import born, host_name
from llfsm.whiteboard.messages.llfsm import status_slot

from .machines import Caller, Clock, Idle, Spins, Steps, ask, status_of


def test_whenever_the_arrangement_sleeps_the_board_reports_how_each_machine_is(board: Board):
    seen = []

    def look(sleeps: int) -> None:
        assert status_of(board, "Steps").state == arrangement.state_name_of("Steps")
        assert status_of(board, "Idle").suspended == arrangement.is_suspended("Idle")
        status = status_of(board, "Steps")
        seen.append((status.state, round(status.in_state_s * 1e3)))
        if sleeps == 5:
            arrangement.suspend("Idle")

    clock = Clock(look)
    arrangement = Arrangement([Steps, Idle], whiteboard=board, clock=clock)
    arrangement.run(max_rounds=20)
    assert status_of(board, "Idle").suspended is False  # as it is gone
    states = [state for state, _ in seen]
    assert states[:9] == ["first"] * 3 + ["second"] * 3 + ["third"] * 3
    assert {ms for _, ms in seen} == {0}  # published when it changed, and no beat was due


def test_who_called_a_machine_is_published_as_long_as_that_is_loaded(board: Board):
    seen = []

    def look(sleeps: int) -> None:
        assert arrangement.roster.find("Idle.0").called_by == status_of(board, "Idle.0").caller
        callers = [status_of(board, name).caller for name in ("Idle", "Idle.0")]
        if not seen or callers != seen[-1]:
            seen.append(callers)
        if sleeps == 3:
            arrangement.unload("Caller")
        if sleeps == 5:  # another machine of this name has not called it
            arrangement.load(Caller)
        if sleeps == 7:
            assert (
                arrangement.roster.find("Idle.1").called_by
                == status_of(board, "Idle.1").caller
                == "Caller"
            )

    arrangement = Arrangement([Caller], whiteboard=board, clock=Clock(look))
    arrangement.call_machine(Idle)
    arrangement.run(max_rounds=9)
    assert seen == [["", "Caller"], ["", ""]]


def test_what_is_reported_a_machine(board: Board):
    seen = []

    def look(sleeps: int) -> None:
        if sleeps == 40:
            seen.append(status_of(board, "Idle"))

    Arrangement([Idle], whiteboard=board, clock=Clock(look)).run(max_rounds=45)
    (status,) = seen
    assert (status.state, status.suspended, status.loaded, status.pending) == ("a", False, True, "")
    assert (status.pid, status.born, status.host) == (os.getpid(), born(os.getpid()), host_name())
    assert 25 <= status.ringlets <= 26  # at the beat after 250 ms
    assert status.overruns == 0
    assert status.in_state_s == 0.25


def test_a_status_that_holds_is_reported_four_times_a_second(board: Board):
    times_ms: list[float] = []
    slot = board[status_slot("Idle")]

    def look(_: int) -> None:
        if len(times_ms) < slot.count:
            times_ms.append(clock.now_ns() / 1e6)

    clock = Clock(look)
    Arrangement([Idle], whiteboard=board, clock=clock, idle_us=7_000).run(max_rounds=300)
    assert slot.count == len(times_ms) + 1  # and its end
    entered, *times_ms = times_ms[1:]  # after the one from before the first turn
    assert entered < 20
    gaps_ms = [after - before for before, after in pairwise(times_ms)]
    assert len(gaps_ms) == 7
    assert all(250 <= gap_ms < 250 + 7 for gap_ms in gaps_ms)


@pytest.mark.parametrize("busy_ms", [1, 3, 7, 19, 21])
def test_while_rounds_never_rest_a_status_is_reported_at_most_fifty_times_a_second(
    board: Board, busy_ms: int
):
    clock = ManualClock()
    arrangement = Arrangement([Spins, Idle], whiteboard=board, clock=clock)
    arrangement.attach(lambda event: isinstance(event, RoundEnd) and clock.advance(ms=busy_ms))
    arrangement.run(max_rounds=3_000 // busy_ms)
    spins, idle = (board[status_slot(name)].count for name in ("Spins", "Idle"))
    beats = 3_000 // (250 + 20 + busy_ms)
    assert beats <= spins <= 3 * 50 + 2  # and the first and the last
    assert beats <= idle <= 3 * 4 + 2


@pytest.mark.parametrize("timed", [False, True])
def test_at_each_beat_the_ringlets_so_far_are_reported(board: Board, timed: bool):
    ringlets = []

    def look(sleeps: int) -> None:
        ringlets.append(status_of(board, "Idle").ringlets)

    arrangement = Arrangement([Idle], whiteboard=board, clock=Clock(look), timed=timed)
    arrangement.run(max_rounds=100)  # 10 ms each
    so_far = range(1, 100)
    assert all(done - 26 <= of <= done for of, done in zip(ringlets, so_far, strict=True))
    assert len(set(ringlets)) == 4


def test_overruns_are_reported(board: Board):
    clock, seen = ManualClock(), []

    class Late(Machine):
        a = State()
        b = State()
        a.to(b, when=lambda m: False)

        @a.internal
        def _(self) -> None:
            clock.advance(ms=7)
            seen.append(status_of(board, "Late"))

    arrangement = Arrangement([Late], whiteboard=board, clock=clock, period_us=5_000)
    arrangement.run(max_rounds=100)
    assert seen[-1].overruns == seen[-1].ringlets >= 100 - 2 * 250 / 7


@pytest.mark.parametrize("suspended", [False, True])
def test_a_machine_loaded_meanwhile_is_reported_before_the_next_sleep(
    board: Board, suspended: bool
):
    def look(sleeps: int) -> None:
        if sleeps == 3:
            load = arrangement.load_suspended if suspended else arrangement.load
            load(Idle, name="Late")
        if sleeps == 4:
            assert status_of(board, "Late").suspended is suspended

    arrangement = Arrangement([Idle], whiteboard=board, clock=Clock(look))
    arrangement.run(max_rounds=8)
    assert status_of(board, "Late").loaded is False


def test_a_machine_that_is_unloaded_is_gone_from_the_board_while_others_go_on(board: Board):
    def look(sleeps: int) -> None:
        assert status_of(board, "Idle").loaded is (sleeps < 3)
        assert status_of(board, "Steps").loaded
        if sleeps == 2:
            arrangement.unload("Idle")

    arrangement = Arrangement([Steps, Idle], whiteboard=board, clock=Clock(look))
    arrangement.run(max_rounds=8)


def test_a_machine_whose_standing_holds_is_not_described_again(
    board: Board, monkeypatch: pytest.MonkeyPatch
):
    described, arrival = [], Seat.arrival

    def count(seat: Seat) -> Arrival:
        described.append(seat.name)
        return arrival(seat)

    monkeypatch.setattr(Seat, "arrival", count)
    clock = ManualClock()
    arrangement = Arrangement([Idle] * 5, whiteboard=board, clock=clock, idle_us=1_000)
    arrangement.run(max_rounds=100)
    at_load_and_when_entered = 2 * 5
    assert len(described) == at_load_and_when_entered

    described.clear()
    arrangement = Arrangement([Idle] * 5, whiteboard=board, clock=clock, idle_us=1_000)
    arrangement.attach(lambda event: arrangement.suspend("Idle.3") if clock_is_at(event) else None)
    arrangement.run(max_rounds=100)
    assert [described.count(name) for name in ("Idle.2", "Idle.3")] == [2, 2 + 2]
    # when the request has come, and when it has taken effect


def clock_is_at(event: Event) -> bool:
    return isinstance(event, RoundEnd) and event.round == 50


def test_each_request_is_counted_although_it_asks_for_the_same(board: Board):
    arrangement = Arrangement([Idle], whiteboard=board, clock=ManualClock())
    presence = StatusPublisher(arrangement, board)
    for obeyed in (1, 2, 3):
        ask(board, "Idle", "suspend")
        presence.look(idle=True)
        assert status_of(board, "Idle").obeyed == obeyed


def test_a_machine_that_hangs_no_more_is_published_at_once(board: Board):
    arrangement = Arrangement([Idle], whiteboard=board, clock=ManualClock())
    presence = StatusPublisher(arrangement, board)
    arrangement.roster.find("Idle").hang = "in a loop"
    presence.publish_hang("Idle")
    assert status_of(board, "Idle").hung
    arrangement.roster.find("Idle").hang = ""
    presence.look(idle=True)
    assert not status_of(board, "Idle").hung
