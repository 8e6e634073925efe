"""An arrangement's machines on its whiteboard: how they are, and what is asked of them there."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from llfsm.runtime import (
    Arrangement,
    ArrangementEndedError,
    ExecutionError,
    Machine,
    ManualClock,
    Reason,
    State,
    Status,
    TimeSlot,
    Timetable,
    Trace,
)
from llfsm.runtime.engine.events import Accepting, RoundEnd, Section
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import Board, BoundSlot, Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name
from llfsm.whiteboard.local import LocalBoard
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


@pytest.fixture(params=["local", "shared"])
def board(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Board]:
    if request.param == "local":
        yield Whiteboard.local()
    else:
        with Whiteboard("board", directory=tmp_path) as shared:
            yield shared


def told(board: Board, name: str) -> MachineStatus:
    status = board.get_message(status_slot(name))
    assert status is not None
    return status


def ask(board: Board, name: str, action: Any) -> None:
    """Post a request as another process does."""
    board.add_message(request_slot(name), MachineRequest(action))
    board.add_message(BELL, Bell(name))


# What is told


def test_whenever_the_arrangement_sleeps_the_board_tells_how_each_machine_is(board: Board):
    seen = []

    def look(sleeps: int) -> None:
        assert told(board, "Steps").state == arrangement.state_name_of("Steps")
        assert told(board, "Idle").suspended == arrangement.is_suspended("Idle")
        status = told(board, "Steps")
        seen.append((status.state, round(status.in_state_s * 1e3)))
        if sleeps == 5:
            arrangement.suspend("Idle")

    clock = Clock(look)
    arrangement = Arrangement([Steps, Idle], whiteboard=board, clock=clock)
    arrangement.run(max_rounds=20)
    assert told(board, "Idle").suspended is False  # as it is gone
    states = [state for state, _ in seen]
    assert states[:9] == ["first"] * 3 + ["second"] * 3 + ["third"] * 3
    assert {ms for _, ms in seen} == {0}  # told when it changed, and no beat was due


def test_what_is_told_of_a_machine(board: Board):
    seen = []

    def look(sleeps: int) -> None:
        if sleeps == 40:
            seen.append(told(board, "Idle"))

    Arrangement([Idle], whiteboard=board, clock=Clock(look)).run(max_rounds=45)
    (status,) = seen
    assert (status.state, status.suspended, status.loaded, status.pending) == ("a", False, True, "")
    assert (status.pid, status.born, status.host) == (os.getpid(), born(os.getpid()), host_name())
    assert 25 <= status.ringlets <= 26  # at the beat after 250 ms
    assert status.overruns == 0
    assert status.in_state_s == 0.25


def test_a_status_that_holds_is_told_four_times_a_second(board: Board):
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
def test_while_rounds_never_rest_a_status_is_told_at_most_fifty_times_a_second(
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
def test_at_each_beat_the_ringlets_so_far_are_told(board: Board, timed: bool):
    ringlets = []

    def look(sleeps: int) -> None:
        ringlets.append(told(board, "Idle").ringlets)

    arrangement = Arrangement([Idle], whiteboard=board, clock=Clock(look), timed=timed)
    arrangement.run(max_rounds=100)  # 10 ms each
    so_far = range(1, 100)
    assert all(done - 26 <= of <= done for of, done in zip(ringlets, so_far, strict=True))
    assert len(set(ringlets)) == 4


def test_overruns_are_told(board: Board):
    clock, seen = ManualClock(), []

    class Late(Machine):
        a = State()
        b = State()
        a.to(b, when=lambda m: False)

        @a.internal
        def _(self) -> None:
            clock.advance(ms=7)
            seen.append(told(board, "Late"))

    arrangement = Arrangement([Late], whiteboard=board, clock=clock, period_us=5_000)
    arrangement.run(max_rounds=100)
    assert seen[-1].overruns == seen[-1].ringlets >= 100 - 2 * 250 / 7


@pytest.mark.parametrize("suspended", [False, True])
def test_a_machine_loaded_meanwhile_is_told_of_before_the_next_sleep(board: Board, suspended: bool):
    def look(sleeps: int) -> None:
        if sleeps == 3:
            load = arrangement.load_suspended if suspended else arrangement.load
            load(Idle, name="Late")
        if sleeps == 4:
            assert told(board, "Late").suspended is suspended

    arrangement = Arrangement([Idle], whiteboard=board, clock=Clock(look))
    arrangement.run(max_rounds=8)
    assert told(board, "Late").loaded is False


def test_a_machine_that_is_unloaded_is_gone_from_the_board_while_others_go_on(board: Board):
    def look(sleeps: int) -> None:
        assert told(board, "Idle").loaded is (sleeps < 3)
        assert told(board, "Steps").loaded
        if sleeps == 2:
            arrangement.unload("Idle")

    arrangement = Arrangement([Steps, Idle], whiteboard=board, clock=Clock(look))
    arrangement.run(max_rounds=8)


# The end


def test_no_machine_is_loaded_after_a_run_that_ended_by_itself(board: Board):
    arrangement = Arrangement([Idle, Steps], whiteboard=board, clock=ManualClock())
    arrangement.suspend("Idle")
    arrangement.suspend("Steps")
    assert arrangement.run() is Reason.ACCEPTING
    assert [told(board, name).loaded for name in ("Idle", "Steps")] == [False, False]


@pytest.mark.parametrize("idle", [False, True])
def test_no_machine_is_loaded_after_an_end_in_a_round(board: Board, idle: bool):
    arrangement = Arrangement([Idle if idle else Spins], whiteboard=board, clock=ManualClock())
    arrangement.attach(lambda event: arrangement.rounds == 3 and arrangement.end())
    assert arrangement.run() is Reason.CLOSED
    assert told(board, "Idle" if idle else "Spins").loaded is False


def test_no_machine_is_loaded_after_an_interruption(board: Board):
    def look(sleeps: int) -> None:
        if sleeps == 3:
            raise KeyboardInterrupt

    arrangement = Arrangement([Idle], whiteboard=board, clock=Clock(look))
    with pytest.raises(KeyboardInterrupt):
        arrangement.run()
    assert told(board, "Idle").loaded is False


def test_no_machine_is_loaded_after_code_of_one_raised(board: Board):
    class Fails(Machine):
        a = State()
        b = State()
        a.to(b, after_ms=50)

        @b.on_entry
        def _(self) -> None:
            raise ValueError("bang")

    arrangement = Arrangement([Fails, Idle], whiteboard=board, clock=ManualClock())
    with pytest.raises(ExecutionError):
        arrangement.run()
    assert [told(board, name).loaded for name in ("Fails", "Idle")] == [False, False]


def test_a_run_that_is_refused_tells_of_no_machine(board: Board):
    arrangement = Arrangement([Idle], whiteboard=board, clock=ManualClock())
    arrangement.run(max_rounds=2)
    with pytest.raises(ArrangementEndedError):
        arrangement.run()
    assert told(board, "Idle").loaded is False


@pytest.mark.parametrize("schedule", [{}, {"period_us": 20_000}])
def test_a_board_that_is_closed_meanwhile_stops_the_run(board: Board, schedule: dict[str, Any]):
    clock = Clock(lambda sleeps: board.close() if sleeps == 3 else None)
    arrangement = Arrangement([Obedient], whiteboard=board, clock=clock, **schedule)
    assert arrangement.run() is Reason.ACCEPTING
    assert arrangement.stop_cause == "the whiteboard was closed or removed"


# Names


def test_a_second_arrangement_with_the_same_machine_gets_another_name_there(board: Board):
    def look(sleeps: int) -> None:
        if sleeps == 3:
            second = Arrangement([Idle], whiteboard=board, clock=Clock(look_at_both))
            second.run(max_rounds=8)
            assert second.machines[0].name == "Idle"  # the name on the board only is another
        if sleeps == 4:
            assert not told(board, "Idle.0").loaded

    def look_at_both(sleeps: int) -> None:
        for name in ("Idle", "Idle.0"):
            assert told(board, name).loaded
        assert told(board, "Idle.0").suspended is (sleeps > 2)
        assert told(board, "Idle").suspended is False
        if sleeps == 2:
            ask(board, "Idle.0", "suspend")

    first = Arrangement([Idle], whiteboard=board, clock=Clock(look))
    first.run(max_rounds=8)
    assert first.machines[0].name == "Idle"
    assert not told(board, "Idle").loaded
    assert not first.is_suspended("Idle")


def test_a_name_that_was_left_is_taken_again(board: Board):
    for _ in range(2):
        Arrangement([Idle], whiteboard=board, clock=ManualClock()).run(max_rounds=2)
    assert board.get_message(status_slot("Idle.0")) is None


def test_the_name_of_a_dead_process_is_taken(board: Board):
    dead = MachineStatus("a", pid=2**22 + 1, born=1, host=host_name())  # beyond all pids
    board.add_message(status_slot("Idle"), dead)
    Arrangement([Idle], whiteboard=board, clock=ManualClock()).run(max_rounds=2)
    assert told(board, "Idle").loaded is False
    assert board.get_message(status_slot("Idle.0")) is None


def test_of_two_that_took_a_name_at_the_same_time_one_gives_way(board: Board):
    parent = os.getppid()
    other = MachineStatus("z", pid=parent, born=born(parent), host=host_name())

    def look(sleeps: int) -> None:
        if sleeps == 3:
            board.add_message(status_slot("Steps"), other)
        if sleeps > 6:  # it has changed meanwhile
            assert told(board, "Steps") == other
            assert told(board, "Steps.0").state == arrangement.state_name_of("Steps")

    arrangement = Arrangement([Steps], whiteboard=board, clock=Clock(look))
    arrangement.run(max_rounds=20)
    assert told(board, "Steps") == other
    assert told(board, "Steps.0").loaded is False


def test_under_its_new_name_a_machine_has_obeyed_nothing_yet(board: Board):
    parent = os.getppid()
    other = MachineStatus("z", pid=parent, born=born(parent), host=host_name())
    obeyed = []

    def look(sleeps: int) -> None:
        if sleeps == 1:
            ask(board, "Steps", "restart")
        if sleeps == 3:
            assert told(board, "Steps").obeyed == 1
            board.add_message(status_slot("Steps"), other)
        status = board.get_message(status_slot("Steps.0"))
        if status is not None:
            obeyed.append(status.obeyed)

    Arrangement([Steps], whiteboard=board, clock=Clock(look)).run(max_rounds=20)
    assert obeyed
    assert set(obeyed) == {0}


def test_white_space_in_a_name_is_no_obstacle(board: Board):
    arrangement = Arrangement(whiteboard=board, clock=ManualClock())
    arrangement.load(Idle, name="two words")
    arrangement.run(max_rounds=2)
    assert told(board, "two words") == told(board, "two_words")


@pytest.mark.parametrize("names", [("a b", "a_b"), ("x" * 300, "x" * 301), ("\x01", "\x02")])
def test_machines_whose_names_look_alike_there_are_told_of_apart(names: tuple[str, str]):
    class FiniteBoard(LocalBoard):
        """Refuse to be asked for ever."""

        asked = 0

        def __getitem__(self, slot: Slot[Any]) -> BoundSlot[Any]:
            self.asked += 1
            assert self.asked < 1_000
            return super().__getitem__(slot)

    def look(sleeps: int) -> None:
        machines = Directory(board).machines()
        assert sorted(machine.suspended for machine in machines) == [False, True]

    board = FiniteBoard()
    arrangement = Arrangement(whiteboard=board, clock=Clock(look))
    arrangement.load(Idle, name=names[0])
    arrangement.load_suspended(Idle, name=names[1])
    arrangement.run(max_rounds=3)


# What is asked for

requests = st.lists(
    st.tuples(st.integers(0, 12), st.sampled_from(["suspend", "resume", "restart"])), max_size=8
)


def traced(
    requested: list[tuple[int, Any]], board: Board | None, **how: Any
) -> tuple[Trace, list[Status]]:
    """Run a machine of which something is requested at some sleeps, there or here."""
    trace, answers = Trace(), []

    def look(sleeps: int) -> None:
        for at, action in requested:
            if at == sleeps:
                if board is None:
                    answers.append(getattr(arrangement, action)("Target"))
                else:
                    answers.append(Directory(board).find("Target").request(action))

    clock = Clock(look)
    arrangement = Arrangement(
        [Idle, Target], whiteboard=board, clock=clock, observers=[trace], **how
    )
    arrangement.run(max_rounds=25)
    return trace, answers


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(requests, st.sampled_from([{}, {"period_us": 10_000}]))
def test_what_is_asked_through_the_board_is_done_as_if_asked_here(
    requested: list[tuple[int, str]], schedule: dict[str, Any]
):
    here = traced(requested, None, **schedule)
    there = traced(requested, Whiteboard.local(), **schedule)
    assert there == here


def test_a_request_takes_effect_at_the_next_turn(board: Board):
    trace, answers = traced([(2, "suspend"), (6, "resume"), (8, "restart")], board)
    assert answers == [Status.RUNNING, Status.SUSPENDED, Status.RUNNING]
    sections = [s for s in trace.sections() if s[1] == "Target" and s[2] != "Internal"]
    assert sections[:3] == [
        (1, "Target", "OnEntry", "a"),
        (4, "Target", "OnSuspend", "a"),
        (4, "Target", "OnEntry", "asleep"),
    ]


def test_the_last_request_wins(board: Board):
    trace, answers = traced([(2, "restart"), (2, "suspend")], board)
    assert answers == [Status.RUNNING, Status.RUNNING]
    turns = [event for event in trace if isinstance(event, Section) and event.machine == "Target"]
    assert turns[-1].state == "asleep"


def test_a_resume_after_a_pending_restart_is_refused_and_the_restart_stays(board: Board):
    _, answers = traced([(2, "suspend"), (4, "restart"), (4, "resume"), (5, "resume")], board)
    assert answers == [Status.RUNNING, Status.SUSPENDED, Status.ERROR, Status.RUNNING]


def test_a_pending_request_is_told(board: Board):
    seen = []

    def look(sleeps: int) -> None:
        if sleeps == 0:
            arrangement.suspend("Idle")
        elif sleeps < 5:
            seen.append((told(board, "Idle").pending, told(board, "Idle").suspended))

    arrangement = Arrangement([Idle, Obedient], whiteboard=board, clock=Clock(look), idle_us=50_000)
    arrangement.run(max_rounds=3)
    assert seen == [("suspend", False), ("suspend", False), ("", True), ("", True)]


def test_requests_from_before_the_start_are_ignored(board: Board):
    ask(board, "Idle", "suspend")
    ask(board, "Steps", "stop")

    def look(sleeps: int) -> None:
        assert not arrangement.is_suspended("Idle")
        if sleeps == 3:
            ask(board, "Other", "stop")  # whereupon everybody looks

    arrangement = Arrangement([Idle, Steps], whiteboard=board, clock=Clock(look))
    arrangement.run(max_rounds=200)
    assert len(arrangement.machines) == 2


def test_a_request_to_somebody_else_changes_nothing(board: Board):
    clock = Clock(lambda sleeps: ask(board, "Other", "suspend") if sleeps == 1 else None)
    arrangement = Arrangement([Idle], whiteboard=board, clock=clock)
    arrangement.run(max_rounds=5)
    assert not arrangement.is_suspended("Idle")
    assert told(board, "Idle").obeyed == 0


def test_rounds_that_never_rest_obey_too(board: Board):
    trace = Trace()
    arrangement = Arrangement([Spins, Idle], whiteboard=board, clock=ManualClock())
    arrangement.attach(trace)
    arrangement.attach(
        lambda event: (
            isinstance(event, RoundEnd)
            and arrangement.rounds == 10
            and ask(board, "Idle", "suspend")
        )
    )
    arrangement.run(max_rounds=12)
    assert [s for s in trace.sections() if s[1] == "Idle" and s[2] == "OnSuspend"] == [
        (11, "Idle", "OnSuspend", "a")
    ]


def test_a_machine_suspended_from_outside_keeps_its_process_for_the_resume(board: Board):
    def look(sleeps: int) -> None:
        if sleeps == 2:
            ask(board, "Idle", "suspend")
        if sleeps == 500:
            assert arrangement.is_suspended("Idle")
            ask(board, "Idle", "resume")
        if sleeps == 510:
            assert not arrangement.is_suspended("Idle")
            arrangement.suspend("Idle")  # from inside: nobody else would resume it

    arrangement = Arrangement([Idle], whiteboard=board, clock=Clock(look))
    assert arrangement.run(max_rounds=1_000) is Reason.ACCEPTING
    assert arrangement.rounds < 520


def test_a_stop_ends_an_arrangement_whose_machine_is_suspended_from_outside(board: Board):
    def look(sleeps: int) -> None:
        if sleeps == 2:
            ask(board, "Idle", "suspend")
        if sleeps == 10:
            arrangement.stop()

    arrangement = Arrangement([Idle], whiteboard=board, clock=Clock(look))
    assert arrangement.run(max_rounds=1_000) is Reason.ACCEPTING
    assert arrangement.rounds < 20


# A stop of one machine

SCHEDULES: dict[str, dict[str, Any]] = {
    "round robin": {},
    "period": {"period_us": 10_000},
    "timetable": {
        "timetable": Timetable([TimeSlot(name, 0, 9) for name in ("M", "Steps")], 10_000)
    },
}


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("there", [False, True])
def test_a_machine_that_does_not_stop_is_unloaded_after_the_grace_period(
    board: Board, schedule: str, there: bool
):
    gone_ms = []

    def look(sleeps: int) -> None:
        if sleeps == 10:
            if there:
                ask(board, "M", "stop")
            else:
                arrangement.stop_machine("M")
        if len(arrangement.machines) == 1:
            gone_ms.append(clock.now_ns() / 1e6)

    clock, idle = Clock(look), Idle()
    arrangement = Arrangement(whiteboard=board, clock=clock, **SCHEDULES[schedule])
    arrangement.load(idle, name="M")
    arrangement.load(Steps)
    assert arrangement.run(grace_s=0.5, max_rounds=120) is Reason.MAX_ROUNDS
    assert idle.saw_stopping > 10
    assert gone_ms[0] == pytest.approx(600, abs=15)
    assert [machine.name for machine in arrangement.machines] == ["Steps"]
    assert arrangement.stopping is False
    assert told(board, "M").loaded is False


def test_a_machine_that_stops_accepts_and_others_see_nothing(board: Board):
    idle, trace = Idle(), Trace()
    clock = Clock(lambda sleeps: ask(board, "Obedient", "stop") if sleeps == 3 else None)
    arrangement = Arrangement([Obedient, idle], whiteboard=board, clock=clock, observers=[trace])
    arrangement.run(max_rounds=200)
    (accepted,) = (event for event in trace if isinstance(event, Accepting))
    assert (accepted.round, accepted.machine, accepted.action) == (6, "Obedient", "unloaded")
    assert idle.saw_stopping == 0
    assert told(board, "Obedient").loaded is False


def test_a_suspended_machine_that_is_asked_to_stop_is_unloaded_too(board: Board):
    def look(sleeps: int) -> None:
        if sleeps == 2:
            ask(board, "Obedient", "suspend")
        if sleeps == 4:
            ask(board, "Obedient", "stop")

    arrangement = Arrangement([Obedient, Steps], whiteboard=board, clock=Clock(look))
    arrangement.run(max_rounds=200, grace_s=0.3)
    assert [machine.name for machine in arrangement.machines] == ["Steps"]


def test_when_the_last_machine_was_stopped_the_run_ends(board: Board):
    clock = Clock(lambda sleeps: ask(board, "Idle", "stop") if sleeps == 3 else None)
    arrangement = Arrangement([Idle], whiteboard=board, clock=clock)
    assert arrangement.run(grace_s=0.2) is Reason.ACCEPTING
    assert clock.now_ns() / 1e6 == pytest.approx(240, abs=25)
