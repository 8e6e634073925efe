"""The testing kit waits, feeds, compares and searches as it says, and its failures tell why."""

from __future__ import annotations

import random
import re
import subprocess
import sys
from enum import Enum

import pytest
from hypothesis import strategies as st

from llfsm.machines import RosBlindTurttleBot, RosPingPong
from llfsm.machines.turtle import CMD_VEL
from llfsm.runtime import (
    Actuator,
    Arrangement,
    ExecutionError,
    Machine,
    ManualClock,
    MonotonicClock,
    OptionError,
    Reason,
    Sensor,
    State,
    Trace,
    UnknownMachineError,
)
from llfsm.runtime.engine.events import Section
from llfsm.runtime.testing import (
    HypothesisMissingError,
    InvariantError,
    NotDeterministicError,
    NotReachedError,
    ScriptError,
    SensorScript,
    StatesError,
    Step,
    assert_states,
    check_invariant,
    play,
    run_until,
    states_of,
)
from llfsm.runtime.testing.search import source_of
from llfsm.whiteboard import Message, Slot, SlotTypeError, Whiteboard
from llfsm.whiteboard.messages import turtlesim


class Door(Message):
    open: bool = False


class Floor(Message):
    number: int = 0


class Motor(Message):
    up: bool = False


DOOR, CALL, MOTOR = Slot("door", Door), Slot("call", Floor, 64), Slot("motor", Motor)


class Lift(Machine):
    """It looks at the door before it starts, but not while it moves: the bug."""

    door = Sensor(DOOR, default=Door())
    call = Sensor(CALL, default=Floor())
    motor = Actuator(MOTOR)

    WAITING = State()
    MOVING = State()

    @WAITING.on_entry
    def _(self) -> None:
        self.motor(Motor(up=False))

    @MOVING.on_entry
    def _(self) -> None:
        self.motor(Motor(up=True))

    @WAITING.to(MOVING)
    def called(self) -> bool:
        return self.call.number > 3 and not self.door.open

    MOVING.to(WAITING, after_ms=1000)


class Settler(Machine):
    A = State()
    B = State()
    A.to(B, after_ms=100)


class Spinner(Machine):
    A = State()
    B = State()
    A.to(B)
    B.to(A)


def door_is_closed_while_moving(arrangement: Arrangement) -> bool:
    lift = arrangement.machine("Lift")
    assert isinstance(lift, Lift)
    return not (lift.state_name == "MOVING" and lift.door.open)


def under_clock(*machines: type[Machine], **options: object) -> Arrangement:
    return Arrangement(
        machines, clock=ManualClock(), whiteboard=Whiteboard.local(), **options  # type: ignore[arg-type]
    )  # fmt: skip


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
        "  Spinner: Suspended for 1500 ms, suspended",
    ]
    assert arrangement.clock.now_ns() == 1_500_000_000


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
    ("condition", "said"),
    [
        ("Spinner.C", "'Spinner.C': Spinner has no state 'C'; it has: A, B, Suspended"),
        ("Spinner", "'Spinner' names no state: it must be \"Machine.STATE\""),
    ],
)
def test_a_state_that_cannot_be_reached(condition: str, said: str):
    with pytest.raises(OptionError) as raised:
        run_until(under_clock(Spinner), condition, within_ms=10)
    assert str(raised.value) == said


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


# Invariants


def found_by_search() -> InvariantError:
    with pytest.raises(InvariantError) as raised:
        check_invariant(
            Lift,
            sensors={
                DOOR: st.builds(Door, st.booleans()),
                CALL: st.builds(Floor, st.integers(0, 9)),
            },
            invariant=door_is_closed_while_moving,
        )
    return raised.value


def test_the_bug_is_found_with_the_shortest_script_that_replays():
    error = found_by_search()
    assert str(error).split("\n") == [
        "door_is_closed_while_moving does not hold in round 2, at 0 ms, "
        "after the ringlet of Lift in MOVING",
        "  Lift: MOVING for 0 ms",
    ]
    (note,) = error.__notes__
    code = note.removeprefix("To play it again:\n\n")
    assert code.split("\n\n")[1].strip().split("\n") == [
        "play(",
        "    [Lift],",
        "    [",
        "        Step(0, {Slot('call', Floor, 64): Floor(number=4)}),",
        "        Step(0, {Slot('door', Door): Door(open=True)}),",
        "    ],",
        "    invariant=door_is_closed_while_moving,",
        ")",
    ]
    with pytest.raises(InvariantError) as again:
        exec(code, {})
    assert str(again.value) == str(error)


def test_the_search_is_the_same_every_time():
    notes = []
    for _ in range(2):
        with pytest.raises(InvariantError) as raised:
            check_invariant(
                Spinner,
                sensors={CALL: st.builds(Floor, st.integers(0, 10**9))},
                invariant=lambda now: now.rounds < 2,
            )
        notes += raised.value.__notes__
    assert notes[0] == notes[1]


def test_what_holds_passes():
    check_invariant(
        [Lift, Spinner],
        sensors={CALL: st.just(Floor(9))},
        invariant=door_is_closed_while_moving,
        tries=20,
    )
    check_invariant(Settler, invariant=lambda now: now.number_of_machines == 1, tries=20)


def test_time_is_searched_too():
    """After more than 100 ms, and in no less than the two rounds that it takes."""
    with pytest.raises(InvariantError) as raised:
        check_invariant(Settler, invariant=lambda now: now.state_name_of("Settler") != "B")
    assert re.findall(r"Step\(.*\)", raised.value.__notes__[0]) == ["Step(0)", "Step(101)"]
    assert "the invariant does not hold in round 2, at 101 ms" in str(raised.value)


def test_a_failing_machine_is_found_and_its_error_has_the_script():
    class Divider(Machine):
        call = Sensor(CALL, default=Floor(1))
        A = State()

        @A.internal
        def _(self) -> None:
            1 // self.call.number

        B = State()
        A.to(B, after_ms=10_000)

    with pytest.raises(ExecutionError, match="ZeroDivisionError") as raised:
        check_invariant(
            Divider,
            sensors={CALL: st.builds(Floor, st.integers(0, 9))},
            invariant=lambda now: None,
        )
    assert raised.value.__notes__[0].count("Step(") == 1
    assert "    [Divider],\n" in raised.value.__notes__[0]


def test_an_invariant_may_assert_or_raise():
    def silent(now: Arrangement) -> None:
        assert now.rounds < 2, "too many"

    with pytest.raises(
        InvariantError, match=r"^silent does not hold in round 2, .*: too many\n"
    ) as e:
        play(Spinner, [Step()] * 3, invariant=silent)
    assert isinstance(e.value.__cause__, AssertionError)

    def wrong(now: Arrangement) -> None:
        now.machine("Nobody")

    with pytest.raises(UnknownMachineError):
        play(Spinner, [Step()], invariant=wrong)


def test_the_invariant_is_checked_after_every_ringlet():
    checked = []

    def record(now: Arrangement) -> None:
        checked.append((now.rounds, *(machine.state_name for machine in now.machines)))

    play([Spinner, Spinner], [Step(), Step()], invariant=record)
    assert checked == [(1, "B", "A"), (1, "B", "B"), (2, "A", "B"), (2, "A", "A")]


def test_a_play_ends_with_its_machines():
    arrangement = play(Settler, [Step(), Step(101), Step(), Step(), Step()], invariant=lambda _: 1)
    assert arrangement.rounds == 3
    assert arrangement.reason is Reason.CLOSED
    assert arrangement.state_name_of("Settler") == "B"


def test_machines_that_cannot_be_made_again():
    with pytest.raises(ScriptError, match=r"Spinner is neither .* play needs new machines"):
        play([Spinner()], [], invariant=lambda _: True)  # type: ignore[list-item]
    with pytest.raises(ScriptError, match="Spinner is neither a machine class"):
        check_invariant(Spinner(), invariant=lambda _: True)  # type: ignore[arg-type]
    with pytest.raises(ScriptError, match="returned 1, which is not a machine"):
        play(lambda: 1, [], invariant=lambda _: True)  # type: ignore[arg-type, return-value]
    with pytest.raises(ScriptError, match="a step waits -1 ms"):
        play(Spinner, [Step(-1)], invariant=lambda _: True)


def test_a_machine_that_is_not_deterministic():
    plays = iter(range(10**9))

    def sometimes(now: Arrangement) -> bool:
        return next(plays) != 3

    with pytest.raises(NotDeterministicError, match="did not fail again"):
        check_invariant(Spinner, invariant=sometimes, tries=20)
    with pytest.raises((NotDeterministicError, InvariantError)):
        check_invariant(Spinner, invariant=lambda _: random.random() < 0.5, tries=20)


class Colour(Enum):
    RED = "red"


class Pose(Message):
    pass


class Everything(Message):
    colour: Colour = Colour.RED
    real: float = 0.0
    some: tuple[Floor, ...] = ()
    pair: tuple[int, float] = (1, 2.0)
    few: frozenset[str] = frozenset()
    text: str = ""
    raw: bytes = b""


EVERYTHING = Slot("everything", Everything)


@pytest.mark.parametrize(
    "message",
    [
        Everything(),
        Everything(real=float("-inf"), few=frozenset("a"), text="'\"\n", raw=b"0"),
        Everything(real=float("nan"), some=(Floor(1), Floor(2))),
    ],
)
def test_any_message_can_be_written_and_read_back(message: Everything):
    seen = []

    def look(now: Arrangement) -> None:
        assert now.whiteboard is not None
        seen.append(repr(now.whiteboard.get_message(EVERYTHING)))

    script = [Step(5, {EVERYTHING: message})]
    play(Spinner, script, invariant=look)
    exec(source_of([Spinner], script, look), {"look": look})
    assert seen == [repr(message)] * 2


def test_types_of_one_name_are_told_apart():
    seen = []

    def look(now: Arrangement) -> None:
        assert now.whiteboard is not None
        seen.append([now.whiteboard.get_message(slot) for slot in script[0].messages])

    theirs, ours = Slot("theirs", turtlesim.Pose), Slot("ours", Pose)
    script = [Step(0, {theirs: turtlesim.Pose(x=1.5), ours: Pose()})]
    play(Spinner, script, invariant=look)
    exec(source_of([Spinner], script, look), {"look": look})
    assert seen == [[turtlesim.Pose(x=1.5), Pose()]] * 2


def test_lambdas_go_by_the_argument_they_were():
    code = source_of([lambda: Spinner()], [], lambda _: True)
    assert "    [machine],\n" in code
    assert "    invariant=invariant,\n" in code


def test_hypothesis_is_imported_for_the_search_only():
    code = """
import sys
sys.modules["hypothesis"] = None
from llfsm.machines import RosPingPong
from llfsm.runtime.testing import HypothesisMissingError, Step, check_invariant, play
play(RosPingPong, [Step()], invariant=lambda _: True)
try:
    check_invariant(RosPingPong, invariant=lambda _: True)
except HypothesisMissingError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True, check=True)
    assert done.stdout == "check_invariant needs hypothesis: pip install hypothesis\n"
    assert issubclass(HypothesisMissingError, ImportError)


def test_a_command_that_is_posted_can_be_looked_at():
    def slow(now: Arrangement) -> bool:
        assert now.whiteboard is not None
        twist = now.whiteboard.get_message(CMD_VEL)
        return twist is None or twist.linear.x <= 1.5

    with pytest.raises(InvariantError, match="slow does not hold"):
        check_invariant(RosBlindTurttleBot, invariant=slow)
