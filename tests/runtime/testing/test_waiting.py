"""Waiting under a manual clock, scripted sensors, the states of a trace."""

from __future__ import annotations

import re

import pytest

from llfsm.machines import RosBlindTurttleBot, RosPingPong
from llfsm.runtime import (
    Arrangement,
    Machine,
    ManualClock,
    MonotonicClock,
    OptionError,
    Reason,
    State,
    Trace,
    UnknownMachineError,
)
from llfsm.runtime.engine.events import Section
from llfsm.runtime.testing import (
    NotReachedError,
    ScriptError,
    SensorScript,
    StatesError,
    assert_states,
    run_until,
    states_of,
)
from llfsm.whiteboard import SlotTypeError, Whiteboard

from .lift import (
    CALL,
    DOOR,
    Door,
    Floor,
    Lift,
    Settler,
    Spinner,
    under_clock,
)

# run_until


def test_waiting_takes_as_long_as_the_machine():
    arrangement = under_clock(RosBlindTurttleBot)
    assert 1000 < run_until(arrangement, "RosBlindTurttleBot.STRAIGHT", within_ms=2000) <= 1010
    assert arrangement.state_name_of("RosBlindTurttleBot") == "STRAIGHT"
    assert 1000 < run_until(arrangement, "RosBlindTurttleBot.TURN_RIGHT", within_ms=1020) <= 1020


@pytest.mark.parametrize("options", [{}, {"idle_us": 3000}, {"period_us": 7000}])
def test_the_clock_moves_as_in_a_run(options: dict[str, int]):
    """The states are entered when they are in `run`, but for the 10 µs of a round that fired."""

    def entries(trace: Trace) -> list[float]:
        sections = [event for event in trace if isinstance(event, Section)]
        return [e.time_ns / 1e6 for e in sections if e.section == "OnEntry"][:20]

    waited, run = Trace(), Trace()
    run_until(
        under_clock(RosPingPong, observers=[waited], **options),
        lambda _: len(entries(waited)) == 20,
        within_ms=2000,
    )
    under_clock(RosPingPong, observers=[run], **options).run(max_rounds=1000)
    assert entries(run)[1] > 1000
    assert entries(waited) == pytest.approx(entries(run), abs=20 * 0.01)


def test_what_is_waited_for_in_vain():
    arrangement = under_clock(RosBlindTurttleBot, start_suspended=[Spinner])
    with pytest.raises(NotReachedError) as raised:
        run_until(arrangement, "RosBlindTurttleBot.END", within_ms=1500)
    assert str(raised.value).split("\n") == [
        "waited for RosBlindTurttleBot.END: not in 1500 ms, 152 rounds",
        "  RosBlindTurttleBot: STRAIGHT for 489.99 ms",
        "    -> TURN_RIGHT  false: 489.99 ms > 1000 ms",
        "    -> END  false: stopping=False",
        "  Spinner: Suspended for 1500 ms, suspended",
    ]
    assert arrangement.clock.now_ns() == 1_500_000_000
    assert raised.traceback.filter(raised)[-1].name == "test_what_is_waited_for_in_vain"


def test_a_condition_is_any_function_and_named_in_the_failure():
    def two_rounds(now: Arrangement) -> bool:
        return now.rounds == 2

    arrangement = under_clock(Spinner)
    assert run_until(arrangement, two_rounds, within_ms=1) == 0.01
    with pytest.raises(NotReachedError, match=r"^waited for two_rounds: not in 1 ms, 101 rounds"):
        run_until(arrangement, two_rounds, within_ms=1)
    with pytest.raises(NotReachedError, match=r"^waited for the condition: "):
        run_until(arrangement, lambda _: False, within_ms=0)


def test_what_is_over_is_not_waited_for():
    with pytest.raises(NotReachedError) as raised:
        run_until(under_clock(Settler), lambda _: False, within_ms=1e6)
    first, line = str(raised.value).split("\n")
    assert re.fullmatch(r"waited for the condition: over after 110\.01 ms, 13 rounds", first)
    assert line == "  Settler: B for 0 ms, unloaded"


def test_an_arrangement_that_a_machine_ends_is_over():
    arrangement = under_clock(Spinner)
    arrangement.attach(lambda event: arrangement.end(Reason.CLOSED) if event.round == 3 else None)
    with pytest.raises(NotReachedError, match=r"over after 0\.02 ms, 3 rounds"):
        run_until(arrangement, lambda _: False, within_ms=10)


@pytest.mark.parametrize(
    ("condition", "printed"),
    [
        ("Spinner.C", "'Spinner.C': Spinner has no state 'C'; it has: A, B, Suspended"),
        ("Spinner", "'Spinner' names no state: it must be \"Machine.STATE\""),
    ],
)
def test_a_state_that_cannot_be_reached(condition: str, printed: str):
    with pytest.raises(OptionError) as raised:
        run_until(under_clock(Spinner), condition, within_ms=10)
    assert str(raised.value) == printed


def test_a_machine_still_to_be_loaded_can_be_waited_for():
    class Loader(Machine):
        A = State()
        B = State()
        A.to(B, after_ms=50)

        @B.on_entry
        def _(self) -> None:
            self.load(Spinner)

    assert 50 < run_until(under_clock(Loader), "Spinner.B", within_ms=100) < 70


def test_only_a_manual_clock_is_moved():
    with pytest.raises(OptionError, match="MonotonicClock: give the Arrangement clock=ManualClo"):
        run_until(Arrangement([Spinner], clock=MonotonicClock()), "Spinner.A", within_ms=1)


# SensorScript


def test_a_script_is_there_for_the_first_round_at_its_time():
    arrangement = under_clock(Lift)
    board, clock = arrangement.whiteboard, arrangement.clock
    assert board is not None
    assert isinstance(clock, ManualClock)
    clock.advance(ms=77)  # times count from the first round
    script = SensorScript(board, [(20, CALL, Floor(5)), (0, DOOR, Door(True)), (30, DOOR, Door())])
    arrangement.attach(script)
    seen = []
    for _ in range(4):
        arrangement.round()
        lift = arrangement.machine("Lift")
        assert isinstance(lift, Lift)
        seen.append((lift.door.open, lift.call.number, lift.state_name, script.finished))
        clock.advance(ms=10)
    assert seen == [
        (True, 0, "WAITING", False),
        (True, 0, "WAITING", False),
        (True, 5, "WAITING", False),
        (False, 5, "MOVING", True),
    ]


def test_scripts_that_cannot_be_played():
    board = Whiteboard.local()
    with pytest.raises(ScriptError, match="door at -1 ms: a script begins at 0 ms"):
        SensorScript(board, [(-1, DOOR, Door())])
    with pytest.raises(SlotTypeError, match="door"):
        SensorScript(board, [(0, DOOR, Floor())])


# Traces


def test_the_states_of_a_trace():
    trace = Trace()
    arrangement = under_clock(Spinner, Settler, observers=[trace])
    for _ in range(3):
        arrangement.round()
    assert states_of(trace, "Spinner") == ["A", "B", "A"]
    assert states_of(trace, "Settler") == ["A"]
    assert_states(trace, "Spinner", ["A", "B", "A"])
    with pytest.raises(UnknownMachineError, match="no machine 'Lift'; traced: Spinner, Settler"):
        states_of(trace, "Lift")


def test_the_difference_between_states():
    trace = Trace()
    run_until(
        under_clock(RosBlindTurttleBot, observers=[trace]),
        lambda now: now.clock.now_ns() > 2_500_000_000,
        within_ms=3000,
    )
    with pytest.raises(StatesError) as raised:
        assert_states(trace, "RosBlindTurttleBot", ["INITIAL", "END", "TURN_RIGHT", "STRAIGHT"])
    assert str(raised.value).split("\n") == [
        "RosBlindTurttleBot did not enter the states expected (- missing, + unexpected):",
        "    INITIAL  at 0 ms",
        "  - END",
        "  + STRAIGHT  at 1010.01 ms",
        "    TURN_RIGHT  at 2020.02 ms",
        "  - STRAIGHT",
    ]
