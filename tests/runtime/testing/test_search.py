"""Plays check invariants; the search finds the shortest script that violates one."""

from __future__ import annotations

import random
import re
import subprocess
import sys
from enum import Enum

import pytest
from hypothesis import strategies as st

from llfsm.machines import RosBlindTurttleBot
from llfsm.machines.common import CMD_VEL
from llfsm.runtime import (
    Arrangement,
    ExecutionError,
    Machine,
    Reason,
    Sensor,
    State,
    UnknownMachineError,
)
from llfsm.runtime.testing import (
    HypothesisMissingError,
    InvariantError,
    NotDeterministicError,
    ScriptError,
    Step,
    check_invariant,
    play,
)
from llfsm.runtime.testing.search import source_of
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages import turtlesim

from .lift import (
    CALL,
    DOOR,
    Door,
    Floor,
    Lift,
    Settler,
    Spinner,
    door_is_closed_while_moving,
)


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
    *before, called, opened, end, invariant, last = code.split("\n\n")[1].strip().split("\n")
    assert before == ["play(", "    [Lift],", "    ["]
    # Hypothesis may leave a message in a step that changes nothing.
    assert re.match(r" +Step\(0, .*Slot\('call', Floor, 64\): Floor\(number=4\)", called)
    assert re.match(r" +Step\(0, .*Slot\('door', Door\): Door\(open=True\)", opened)
    assert [end, invariant, last] == ["    ],", "    invariant=door_is_closed_while_moving,", ")"]
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
    check_invariant(Settler, invariant=lambda now: len(now.machines) == 1, tries=20)


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
from llfsm.runtime.testing import HypothesisMissingError, Step, check_invariant
from llfsm.runtime.testing import play
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
