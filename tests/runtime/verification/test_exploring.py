"""Counts, verdicts and witnesses of small machines whose states can be counted by hand."""

from __future__ import annotations

from typing import Annotated

import msgspec
import pytest

from llfsm.runtime import Actuator, Machine, Sensor, State, Trace, define
from llfsm.runtime.counterexamples import replay
from llfsm.runtime.verification import (
    PropertyError,
    Space,
    always,
    every,
    explore,
    never,
    reachable,
    step,
    verify,
)
from llfsm.whiteboard import Message, Slot


class Level(Message):
    value: Annotated[int, msgspec.Meta(ge=0, le=2)] = 0


class Valve(Message):
    open: bool = False


LEVEL, VALVE = Slot("tank/level", Level), Slot("tank/valve", Valve)


class Tank(Machine):
    """Open the valve when the level is high, and shut it a second later."""

    level = Sensor(LEVEL, default=Level(), domain=every(Level))
    valve = Actuator(VALVE)
    openings: int = 0

    SHUT = State()
    OPEN = State()

    @OPEN.on_entry
    def _(self) -> None:
        self.valve(Valve(True))
        self.openings = min(self.openings + 1, 3)

    @OPEN.on_exit
    def _(self) -> None:
        self.valve(Valve(False))

    SHUT.to(OPEN, when=lambda self: self.level.value == 2)
    OPEN.to(SHUT, after_ms=1000)


class Watcher(Machine):
    valve = Sensor(VALVE)

    CALM = State()
    ALARMED = State()
    CALM.to(ALARMED, when=lambda self: self.valve is not None and self.valve.open)


def test_a_machine_alone_has_the_states_counted_by_hand() -> None:
    """By (current, previous, openings, periods in the state).

    The initial state; (SHUT, SHUT, 0, 0); then for each of four numbers of openings (OPEN, SHUT,
    n, 0), and for 1 to 3 openings (OPEN, OPEN, n, 0 to 2), (SHUT, OPEN, n, 0), (SHUT, SHUT, n, 0):
    the third turn in OPEN is a second after its entry, and leaves after the fourth. In each the
    sensor reads one of three messages.
    """
    space = explore(Tank, period_ms=500)
    assert (space.states, space.transitions) == (2 + 4 + 3 * 5, 3 * (2 + 4 + 3 * 5))
    assert space.complete


def test_the_time_is_counted_no_longer_than_it_is_asked_for() -> None:
    assert explore(Tank, period_ms=5000).states == 2 + 4 + 3 * (1 + 2)
    assert explore(Tank, period_ms=1).states == 2 + 4 + 3 * (1001 + 2)


def test_the_time_stands_still_once_all_times_are_over() -> None:
    """The initial state, and 0, 300, 600, 900 and more than 1000 ms in the state."""
    start = State("START")
    start.to(start, after_ms=1000, when=lambda self: False)
    assert explore(define("Waiting", [start]), period_ms=300).states == 1 + 5


class Patience(Machine):
    """Ask for another second if the valve is open in time, which it never is."""

    valve = Sensor(VALVE, default=Valve())

    IDLE = State()
    LATE = State()
    IDLE.to(
        LATE,
        when=lambda self: (
            self.after_ms(20) and self.valve.open and not self.after_ms(100) and self.after_ms(1000)
        ),
    )


class Opener(Machine):
    valve = Actuator(VALVE)

    SHUT = State()
    OPEN = State()
    SHUT.to(OPEN, after_ms=500)
    OPEN.on_entry(lambda self: self.valve(Valve(True)))
    OPEN.to(SHUT, when=lambda self: False)


def test_a_time_counts_only_if_it_is_asked_about_when_that_can_happen() -> None:
    """At a time learnt before, the machine would ask for a second; it is long over by then.

    The machines have their turns alternately: the opener leaves after 510 ms, in round 52, and
    stays. By then the time is more than 100 ms for the other one.
    """
    space = explore([Patience, Opener], period_ms=10)
    assert (space.states, space.transitions) == (108, 108)
    assert space.unreached == ("Patience.LATE",)


PROPERTIES = (
    never(lambda v: v[VALVE].open and v.Tank.state == Tank.SHUT, "shut"),
    always(lambda v: v.Tank.openings < 3, "few"),
    reachable(lambda v: v.Watcher.state == "ALARMED", "alarm"),
    reachable(lambda v: v.Tank.openings > 3, "many"),
    step(lambda before, after: after.Tank.openings - before.Tank.openings < 2, "by one"),
    step(lambda before, after: not after.Tank.level.value or after.Tank.state != "OPEN", "seen"),
)


def explored() -> Space:
    return explore([Tank, Watcher], period_ms=500, properties=PROPERTIES)


def test_verdicts_and_the_lengths_of_the_shortest_witnesses() -> None:
    """The tank opens for the third time in round 12; the watcher leaves in round 3."""
    found = {
        str(verdict.property): (
            verdict.holds,
            None if verdict.witness is None else len(verdict.witness.turns),
        )
        for verdict in explored().verdicts
    }
    assert found == {
        "shut": (True, None),
        "few": (False, 3 * 2 + 9),
        "alarm": (True, 4),
        "many": (False, None),
        "by one": (True, None),
        "seen": (False, 1),
    }


@pytest.mark.parametrize("observed", [False, True])
def test_every_witness_replays(observed: bool) -> None:
    space = explored()
    for verdict in space.verdicts:
        if verdict.witness is None:
            continue
        views = replay(space, verdict.witness, observers=[Trace()] if observed else [])
        end, function = len(verdict.witness.turns), verdict.property.functions[0]
        if verdict.property.kind == "step":
            assert not function(*views[end - 1 : end + 1])
        else:
            sought = verdict.property.kind == "reachable"
            values = [function(view) for view in views[: end + 1]]
            assert values == [not sought] * end + [sought]


def test_verify_raises_for_what_does_not_hold() -> None:
    with pytest.raises(PropertyError) as error:
        verify([Tank, Watcher], *PROPERTIES[:3], period_ms=500)
    first, start, *_, last = str(error.value).splitlines()
    assert first == "few: violated after 15 turns"
    assert start == "  round 1, 500 ms, Tank: tank/level.value=2"
    assert last.startswith("  round ")
    verify([Tank, Watcher], PROPERTIES[0], period_ms=500)


def test_an_exploration_that_was_ended_leaves_properties_undecided() -> None:
    space = explore([Tank, Watcher], period_ms=500, properties=PROPERTIES[:1], max_states=5)
    assert not space.complete
    assert space.verdicts[0].holds is None
    with pytest.raises(PropertyError) as error:
        verify(Tank, PROPERTIES[3], period_ms=0.5, max_states=5)
    *lines, hint = str(error.value).splitlines()
    assert lines[-1] == "many: undecided, as not all states were found"
    assert hint.startswith("Tank.OPEN asks whether 1,000 ms have passed, which is 2,000 periods: ")
