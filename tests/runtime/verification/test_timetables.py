"""Machines whose turns a timetable gives are explored turn for turn, when each is due."""

from __future__ import annotations

import pytest

from llfsm.runtime import Actuator, LoadError, Machine, OptionError, Sensor, State
from llfsm.runtime.counterexamples import replay
from llfsm.runtime.engine.schedule import TimeSlot, Timetable
from llfsm.runtime.verification import (
    Member,
    UnsupportedError,
    Verdict,
    every,
    explore,
    leads_to,
    monitor,
    never,
    reachable,
)
from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.std_msgs import Bool

LAMP, KEY = Slot("lamp", Bool), Slot("key", Bool)


class Lamp(Machine):
    """It is lit after 20 ms and until the key is turned."""

    key = Sensor(KEY, default=Bool(), domain=every(Bool))
    lamp = Actuator(LAMP)
    dark, lit = State(), State()

    @lit.on_entry
    def _(self) -> None:
        self.lamp(Bool(data=True))

    @dark.on_entry
    def _(self) -> None:
        self.lamp(Bool())

    dark.to(lit, after_ms=20)
    lit.to(dark, when=lambda self: self.key.data)


class Eye(Machine):
    """It sees the lamp, and its count is of the turns for which it did."""

    lamp = Sensor(LAMP, default=Bool())
    turns: int = 0
    blind, sees = State(), State()

    @sees.internal
    def _(self) -> None:
        self.turns = min(self.turns + 1, 5)

    blind.to(sees, when=lambda self: self.lamp.data)
    sees.to(blind, when=lambda self: not self.lamp.data)


class Brief(Machine):
    """It leaves after a turn."""

    only = State()


def table(*slots: tuple[str, int], cycle_ms: int = 30) -> Timetable:
    each = [TimeSlot(name, ms * 1_000, cycle_ms * 1_000) for name, ms in slots]
    return Timetable(each, cycle_ms * 1_000)


TURNS = table(("Lamp", 0), ("Eye", 5), ("Lamp", 10), ("Eye", 12))


def verdict(prop: object, timetable: Timetable = TURNS) -> Verdict:
    space = explore([Lamp, Eye], timetable=timetable, properties=[prop])  # type: ignore[list-item]
    return space.verdicts[0]


def test_the_time_between_turns_is_that_of_the_timetable() -> None:
    """The lamp's turns are 10 and 20 ms apart, in turn: it fires 30 ms after the first one."""
    way = verdict(reachable(lambda v: v.Lamp.state == "lit")).witness
    assert way is not None
    assert [(turn.round, turn.time_ms, turn.machine) for turn in way.turns] == [
        (1, 0, "Lamp"),
        (1, 5, "Eye"),
        (1, 10, "Lamp"),
        (1, 12, "Eye"),
        (2, 30, "Lamp"),
    ]
    assert verdict(reachable(lambda v: v.Lamp.state == "lit"), table(("Lamp", 0), ("Eye", 0))).holds


def test_a_response_is_due_by_the_times_of_turns() -> None:
    """A lamp lit at 10 ms is seen at 12 ms; one lit at 30 ms at 35 ms."""
    lit, seen = lambda v: v[LAMP].data, lambda v: v.Eye.state == "sees" or not v[LAMP].data
    in_time = [verdict(leads_to(lit, seen, within_ms=ms)).holds for ms in (1, 4, 5)]
    assert in_time == [False, False, True]


def test_a_counterexample_is_run_again() -> None:
    prop = never(lambda v: v.Eye.turns == 3)
    space = explore([Lamp, Eye], timetable=TURNS, properties=[prop])
    witness = space.verdicts[0].witness
    assert witness is not None
    views = replay(space, witness)
    assert len(views) == len((*witness.turns, *witness.rest)) + 1
    found = [view.Eye.turns for view in views[: len(witness.turns) + 1]]
    assert found[-2:] == [2, 3]


class Watch(Machine):
    """A monitor: the lamp was lit."""

    lamp = Sensor(LAMP, default=Bool())
    dark, bad = State(), State(final=False)
    dark.to(bad, when=lambda self: self.lamp.data)


def test_a_monitor_has_a_turn_whenever_one_is_due() -> None:
    way = verdict(monitor(Watch, Watch.bad)).witness
    assert way is not None
    times = [turn.time_ms for turn in way.turns if turn.machine == "Watch"]
    assert times == [0, 5, 10, 12, 30, 35, 40]
    assert way.turns[-1].machine == "Watch"


class Within(Machine):
    """Its state runs a lamp, which has its turns in the slots of this machine."""

    goes = State(runs=Lamp, final=False)


def test_inner_machines_have_their_turns_in_the_slots_of_the_outer_one() -> None:
    turns = table(("Within", 0), ("Eye", 5), ("Within", 10), ("Eye", 12))
    lit = reachable(lambda v: v["Within/Lamp"].state == "lit")
    (found,) = explore([Within, Eye], timetable=turns, properties=[lit]).verdicts
    assert found.witness is not None
    last = found.witness.turns[-1]
    assert (last.machine, last.time_ms) == ("Within/Lamp", 30)


def test_turns_of_machines_that_have_left_pass() -> None:
    turns = table(("Brief", 0), ("Lamp", 4), ("Brief", 20))
    lit = reachable(lambda v: v.Lamp.state == "lit")
    (found,) = explore([Brief, Lamp], timetable=turns, properties=[lit]).verdicts
    assert found.witness is not None
    assert [(turn.time_ms, turn.machine) for turn in found.witness.turns] == [
        (0, "Brief"),
        (4, "Lamp"),
        (34, "Lamp"),
    ]
    late = leads_to(lambda v: v[LAMP].data, lambda v: v.Lamp.state == "dark", within_ms=5)
    with pytest.raises(UnsupportedError, match="Brief leaves the arrangement"):
        explore([Brief, Lamp], timetable=turns, properties=[late])
    explore([Brief, Lamp], timetable=turns, properties=[late], unload_accepting=False)


def test_suspended_machines_keep_their_places() -> None:
    members = [Member(Lamp, suspended=True), Member(Eye)]
    space = explore(members, timetable=TURNS)
    assert [each.machine for each in space.members] == [Lamp, Eye]


def test_what_cannot_be_asked_of_a_timetable() -> None:
    with pytest.raises(LoadError, match="Eye has no slot in the timetable"):
        explore([Lamp, Eye], timetable=table(("Lamp", 0)))
    for more, message in (
        ({"period_ms": 10}, "give period_ms or a timetable, not both"),
        ({"any_time": True}, "give a timetable, or any_time=True"),
        ({"skips": True}, "skips leaves out rounds of a period"),
    ):
        with pytest.raises(OptionError, match=message):
            explore([Lamp, Eye], timetable=TURNS, **more)  # type: ignore[arg-type]


def test_the_report_names_it() -> None:
    space = explore([Lamp, Eye], timetable=TURNS)
    assert space.schedule == "a timetable of 4 turns every 30 ms"
    assert "cycles that a run leaves out" in space.not_covered
