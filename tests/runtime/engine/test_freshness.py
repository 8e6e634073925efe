"""A message that is too old is not acted upon, by the arrangement's clock at the snapshot."""

from __future__ import annotations

import math
import subprocess
import sys
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import (
    Arrangement,
    DefinitionError,
    Machine,
    ManualClock,
    Sensor,
    SensorNameError,
    State,
)
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32
from own_boards import own_board

POSE = Slot("pose", Int32)
NONE = Int32(data=-1)


def machine(**options: Any) -> Any:
    class Looker(Machine):
        pose = Sensor(POSE, **options)
        seen: tuple[tuple[int | None, float | None], ...] = ()
        asks: bool = True

        here = State()

        @here.internal
        def _(self) -> None:
            found = None if self.pose is None else self.pose.data
            self.seen += ((found, self.age_ms("pose") if self.asks else None),)

    return Looker()


class World:
    def __init__(self, clock: ManualClock | None = None, **options: Any):
        self.clock = clock or ManualClock()
        self.board = Whiteboard.local()
        self.machine = machine(**options)
        self.options = {"clock": self.clock, "unload_accepting": False}
        self.arrangement: Arrangement | None = None

    def start(self) -> None:
        self.arrangement = Arrangement([self.machine], whiteboard=self.board, **self.options)

    def post(self, number: int) -> None:
        self.board.add_message(POSE, Int32(data=number))

    def look(self) -> tuple[int | None, float | None]:
        assert self.arrangement is not None
        self.arrangement.round()
        latest: tuple[int | None, float | None] = self.machine.seen[-1]
        return latest


@given(
    limit_ms=st.integers(1, 50),
    steps=st.lists(st.one_of(st.just("post"), st.integers(0, 60)), max_size=30),
)
def test_under_a_manual_clock_it_is_exact(limit_ms: int, steps: list[Any]) -> None:
    world = World(max_age_ms=limit_ms)
    world.start()
    added_ms, number, now_ms = None, 0, 0
    for step in steps:
        if step == "post":
            number += 1
            added_ms = now_ms
            world.post(number)
        else:
            now_ms += step
            world.clock.advance(ms=step)
            age = None if added_ms is None else now_ms - added_ms
            fresh = age is not None and age <= limit_ms
            assert world.look() == (number if fresh else None, age)


def test_an_old_message_reads_as_the_default() -> None:
    world = World(max_age_ms=10, default=NONE)
    world.start()
    world.post(5)
    assert world.look()[0] == 5
    world.clock.advance(ms=10)
    assert world.look() == (5, 10.0)
    world.clock.advance(us=1)
    assert world.look() == (-1, 10.001)


def test_what_was_there_before_the_machine_can_be_refused() -> None:
    world = World(since_start=True)
    world.post(1)
    world.start()
    assert world.look()[0] is None
    world.post(1)  # though it is equal
    assert world.look()[0] == 1
    plain = World()
    plain.post(1)
    plain.start()
    assert plain.look()[0] == 1


def test_the_age_of_any_sensor_can_be_asked_and_is_that_of_the_snapshot() -> None:
    world = World(max_age_ms=math.inf)
    world.start()
    assert world.look() == (None, None)
    world.post(1)
    world.clock.advance(ms=3)
    assert world.look() == (1, 3.0)
    plain = World()
    plain.start()
    assert plain.look() == (None, None)
    plain.post(7)
    plain.clock.advance(ms=4)
    assert plain.look() == (7, 4.0)
    plain.machine.asks = False
    plain.clock.advance(ms=1)
    plain.look()
    plain.post(8)
    plain.clock.advance(ms=1)
    assert plain.machine.age_ms("pose") == 6.0  # of 7, which the machine has seen


def test_a_real_clock_compares_stamps_of_another_process(tmp_path: Any) -> None:
    name = f"fresh-{tmp_path.name}"
    with Whiteboard(name) as board:
        code = (
            "from llfsm.whiteboard import Slot, Whiteboard\n"
            "from llfsm.whiteboard.messages.std_msgs import Int32\n"
            f"Whiteboard({name!r}).add_message(Slot('pose', Int32), Int32(data=3))\n"
        )
        subprocess.run([sys.executable, "-c", code], check=True)
        looker = machine(max_age_ms=1e6)
        with Arrangement([looker], whiteboard=board, unload_accepting=False) as arrangement:
            arrangement.round()
            (found, age), sample = looker.seen[-1], board[POSE].sample()
            assert found == 3
            assert age is not None
            assert age > 0
            assert sample is not None
            arrangement.round()
            assert looker.seen[-1][1] > age
        too_old = machine(max_age_ms=1e-6)
        with Arrangement([too_old], whiteboard=board, unload_accepting=False) as arrangement:
            arrangement.round()
            assert too_old.seen[-1][0] is None
        board.remove()


def test_under_a_manual_clock_a_message_of_a_shared_board_ages_from_when_it_was_found() -> None:
    clock = ManualClock()
    with own_board() as name, Whiteboard(name) as board, Whiteboard(name) as other:
        looker = machine(max_age_ms=50)
        with Arrangement(
            [looker], whiteboard=board, clock=clock, unload_accepting=False
        ) as arrangement:
            other.add_message(POSE, Int32(data=7))
            for _ in range(3):
                arrangement.round()
                clock.advance(ms=30)
    assert looker.seen == ((7, 0.0), (7, 30.0), (None, 60.0))


def test_a_sensor_that_there_is_not_is_named() -> None:
    world = World()
    world.start()
    with pytest.raises(SensorNameError, match="Looker has no sensor 'pos'; it has: pose"):
        world.machine.age_ms("pos")


@pytest.mark.parametrize("age", [0, -1, math.nan])
def test_an_impossible_age_is_refused(age: float) -> None:
    with pytest.raises(DefinitionError, match="max_age_ms"):
        Sensor(POSE, max_age_ms=age)
