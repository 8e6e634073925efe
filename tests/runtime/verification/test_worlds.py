"""Worlds do all that their bounds allow, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Actuator, Arrangement, Machine, ManualClock, Sensor, State
from llfsm.runtime.verification import DomainError, explore, never, reachable, step
from llfsm.runtime.verification.worlds import battery, button, drift, link
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Bool, Int32

VALUE, SENT, RECEIVED = (Slot(name, Int32) for name in ("value", "sent", "received"))
PRESSED = Slot("pressed", Bool)
NUMBERS = [Int32(data=number) for number in range(5)]


def verdicts(machines: Any, *properties: Any) -> list[bool | None]:
    return [each.holds for each in explore(machines, period_ms=10, properties=properties).verdicts]


@pytest.mark.parametrize("most", [0, 1, 2])
def test_a_value_drifts_by_so_many_places(most: int) -> None:
    world = drift(VALUE, NUMBERS, start=2, most=most)
    moves = [
        reachable(lambda v, n=number: v.Drift.place == n and v[VALUE] == NUMBERS[n])
        for number in range(5)
    ]
    jumps = step(lambda before, after: abs(after.Drift.place - before.Drift.place) <= most)
    there = [most > 0 or number == 2 for number in range(5)]
    assert verdicts(world, *moves, jumps) == [*there, True]


def test_a_button_keeps_its_place_for_so_many_turns() -> None:
    class Watch(Machine):
        pressed = Sensor(PRESSED, default=Bool())
        turns: int = 9
        was: bool = False
        least: int = 9
        watch = State(final=False)

        @watch.internal
        def _(self) -> None:
            if self.pressed.data != self.was:
                self.was, self.least, self.turns = self.pressed.data, min(self.least, self.turns), 0
            self.turns = min(self.turns + 1, 9)

    world = button(PRESSED, Bool(data=False), Bool(data=True), least_turns=3)
    longer, least = never(lambda v: v.Watch.least < 3), reachable(lambda v: v.Watch.least == 3)
    assert verdicts([world, Watch], longer, least) == [True, True]


class Send(Machine):
    """Post in each turn."""

    sent = Actuator(SENT)
    number: int = 0
    send = State(final=False)

    @send.internal
    def _(self) -> None:
        self.number = (self.number + 1) % 5
        self.sent(NUMBERS[self.number])


@pytest.mark.parametrize("most_lost", [None, 0, 2])
def test_a_link_loses_at_most_so_many(most_lost: int | None) -> None:
    class Hear(Machine):
        heard = Sensor(RECEIVED, max_age_ms=5)
        silent: int = 0
        hear = State(final=False)

        @hear.internal
        def _(self) -> None:
            self.silent = 0 if self.heard else min(self.silent + 1, 5)

    world = link(SENT, RECEIVED, most_lost=most_lost)
    lost = [reachable(lambda v, n=number: v.Hear.silent == n) for number in range(5)]
    expected = [True, *(most_lost is None or number <= most_lost for number in range(1, 5))]
    assert verdicts([Send, world, Hear], *lost) == expected


def test_a_battery_is_full_at_first_and_charged_alone_goes_up() -> None:
    class Charger(Machine):
        on = Actuator(PRESSED)
        level = Sensor(VALUE, default=NUMBERS[0])
        is_on: bool = False
        watch = State(final=False)

        @watch.internal
        def _(self) -> None:
            self.is_on = self.level.data < 3
            self.on(Bool(data=self.is_on))

    world = battery(VALUE, NUMBERS, charges=(PRESSED, lambda on: on is not None and on.data))
    full = step(lambda old, new: new.Battery.level <= old.Battery.level or old[PRESSED].data)
    low = [reachable(lambda v, n=number: v.Battery.level == n) for number in range(5)]
    assert verdicts([world, Charger], full, *low) == [True, False, False, True, True, True]


def test_by_default_it_stays_as_it_is() -> None:
    world = drift(VALUE, NUMBERS, start=3)
    board = Whiteboard.local()
    arrangement = Arrangement([world], whiteboard=board, clock=ManualClock())
    for _ in range(5):
        arrangement.round()
        assert board.get_message(VALUE) == NUMBERS[3]


def test_wrong_bounds_are_refused() -> None:
    with pytest.raises(DomainError, match="Drift: start is 5"):
        drift(VALUE, NUMBERS, start=5)
    with pytest.raises(DomainError, match="at least one level"):
        battery(VALUE, [], charges=(PRESSED, bool))
