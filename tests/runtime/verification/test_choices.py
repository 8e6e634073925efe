"""What the environment may do: stop, requests, choices by rounds; and machines that leave."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Actuator, Machine, Sensor, State, Trace, define
from llfsm.runtime.counterexamples import replay
from llfsm.runtime.verification import (
    NO_FAILURE,
    Member,
    Progress,
    Space,
    always,
    every,
    explore,
    never,
    reachable,
)
from llfsm.whiteboard import Message, Slot


class Button(Message):
    pressed: bool = False


class Lamp(Message):
    on: bool = False


BUTTON, LAMP = Slot("hall/button", Button), Slot("hall/lamp", Lamp)


class Hall(Machine):
    """Light the lamp while the button is pressed, until it is stopped."""

    button = Sensor(BUTTON, default=Button(), domain=iter(every(Button)))
    lamp = Actuator(LAMP, at_end=Lamp())
    resumed: bool = False

    DARK = State()
    BRIGHT = State()
    END = State()
    HELD = State(suspend=True)

    @DARK.on_entry
    def _(self) -> None:
        self.lamp(Lamp(False))

    @BRIGHT.on_entry
    def _(self) -> None:
        self.lamp(Lamp(True))

    @BRIGHT.on_resume
    def _(self) -> None:
        self.resumed = True

    DARK.to(BRIGHT, when=lambda self: self.button.pressed)
    BRIGHT.to(DARK, after_ms=100, when=lambda self: not self.button.pressed)
    DARK.to(END, when=lambda self: self.stopping)
    BRIGHT.to(END, when=lambda self: self.stopping)


class Guard(Machine):
    """Suspend the hall while the button is pressed; look at how it stands."""

    button = Sensor(BUTTON, default=Button())
    seen: str = ""

    WATCH = State()
    HOLD = State()

    @HOLD.on_entry
    def _(self) -> None:
        self.suspend("Hall")

    @HOLD.on_exit
    def _(self) -> None:
        self.resume("Hall")

    @HOLD.internal
    def _(self) -> None:
        self.seen = self.state_name_of("Hall")

    WATCH.to(HOLD, when=lambda self: self.button.pressed)
    HOLD.to(WATCH, after_ms=150)


def all_replay(space: Space) -> None:
    """Assert that each witness replays to what it shows, observed or not."""
    for verdict in space.verdicts:
        assert verdict.witness is not None, str(verdict.property)
        for observers in ([], [Trace()]):
            views = replay(space, verdict.witness, observers=observers)
            end, function = len(verdict.witness.turns), verdict.property.functions[0]
            values = [function(view) for view in views[: end + 1]]
            sought = verdict.property.kind != "always"
            assert values == [not sought] * end + [sought], str(verdict.property)


def states_of(*names: str) -> list[Any]:
    return [
        reachable(lambda v, m=m, s=s: v[m].state == s, f"{m}.{s}")
        for m, s in (name.split(".") for name in names)
    ]


HALL = ("Hall.BRIGHT", "Hall.END", "Hall.HELD")


def verdicts_of(space: Space) -> dict[str, bool | None]:
    return {str(verdict.property): verdict.holds for verdict in space.verdicts}


def test_only_a_stop_leads_to_the_end() -> None:
    never_stopped = explore(Hall, period_ms=50, properties=states_of(*HALL))
    assert verdicts_of(never_stopped) == dict(zip(HALL, (True, False, False), strict=True))
    stopped = explore(Hall, period_ms=50, stop=True, properties=states_of("Hall.END"))
    all_replay(stopped)
    assert "Hall.HELD" in stopped.unreached


def test_a_stop_may_come_before_each_turn_until_it_has() -> None:
    """A machine that accepts in its first turn leaves two states, with a stop and without."""
    space = explore(define("Deaf", [State("A")]), period_ms=50, stop=True, unload_accepting=False)
    assert (space.states, space.transitions) == (3, 2)


def test_anybody_may_suspend_resume_and_restart() -> None:
    properties = [
        *states_of("Hall.HELD"),
        reachable(lambda v: v.Hall.resumed, "resumed"),
        reachable(lambda v: v.Hall.suspended and v[LAMP].on, "held in the light"),
    ]
    space = explore(Hall, period_ms=50, suspend=["Hall"], properties=properties)
    assert verdicts_of(space) == {"Hall.HELD": True, "resumed": True, "held in the light": False}
    all_replay(explore(Hall, period_ms=50, suspend=["Hall"], properties=properties[:2]))


def test_requests_of_machines_and_what_they_see_of_each_other() -> None:
    properties = [
        *states_of("Hall.HELD", "Guard.HOLD", "Hall.BRIGHT"),
        reachable(lambda v: v.Guard.seen == "HELD", "seen"),
        reachable(lambda v: v.Hall.resumed, "resumed"),
    ]
    for machines in ([Hall, Guard], [Guard, Hall]):
        all_replay(explore(machines, period_ms=50, properties=properties))


def test_choices_by_rounds_are_the_same_for_all_machines() -> None:
    """So the hall cannot see a button that the guard, before it, has not seen."""
    differ = never(lambda v: v.Guard.button != v.Hall.button and v.Hall.state == "BRIGHT", "differ")
    by_turns = explore([Guard, Hall], period_ms=50, properties=[differ])
    assert by_turns.verdicts[0].witness is not None
    assert by_turns.verdicts[0].witness.turns[-1].machine == "Hall"
    by_rounds = explore([Guard, Hall], period_ms=50, choices="rounds", properties=[differ])
    assert by_rounds.verdicts[0].witness is not None  # in the midst of a round
    assert by_rounds.verdicts[0].witness.turns[-1].machine == "Guard"
    bright = states_of("Hall.BRIGHT", "Hall.HELD")
    all_replay(explore([Guard, Hall], period_ms=50, choices="rounds", properties=bright))


def test_a_machine_that_leaves_posts_its_last_values_and_has_no_turns() -> None:
    properties = [
        reachable(lambda v: not v.Hall.loaded, "left"),
        reachable(lambda v: v.Hall.accepted and not v[LAMP].on and v.Hall.state == "END", "dark"),
    ]
    space = explore([Hall, Guard], period_ms=50, stop=True, properties=properties)
    all_replay(space)


def test_slots_can_be_renamed_and_machines_named() -> None:
    members = [
        Member(Hall, name="Left"),
        Member(Hall, name="Right", slots={"hall/button": "other/button"}, suspended=True),
    ]
    properties = [
        *states_of("Left.BRIGHT"),
        always(lambda v: not v["Right"].loaded or v.Right.suspended, "asleep"),
    ]
    space = explore(
        members,
        period_ms=50,
        suspend=["Right"],
        sensors={"other/button": [Button(True)]},
        properties=properties,
    )
    assert verdicts_of(space) == {"Left.BRIGHT": True, "asleep": False}
    all_replay(space)


def test_a_failure_replays_to_the_same_error() -> None:
    class Broken(Hall):
        @Hall.BRIGHT.on_exit
        def _(self) -> None:
            raise ValueError("burnt out")

    space = explore(Broken, period_ms=50, properties=[NO_FAILURE])
    (verdict,) = space.verdicts
    assert verdict.witness is not None
    with pytest.raises(Exception, match="OnExit: ValueError: burnt out"):
        replay(space, verdict.witness)


def test_an_interrupted_exploration_knows_what_it_has_found() -> None:
    def interrupt(progress: Any) -> None:
        if progress.states > 3:
            raise KeyboardInterrupt

    properties = [*states_of("Hall.END"), reachable(lambda v: v.Hall.button.pressed, "pressed")]
    space = explore(Hall, period_ms=50, properties=properties, progress=interrupt)
    assert not space.complete
    assert verdicts_of(space) == {"Hall.END": None, "pressed": True}


def test_time_limits_end_an_exploration() -> None:
    assert not explore(Hall, period_ms=50, max_seconds=0).complete


def test_an_exploration_ends_within_a_large_level(monkeypatch: pytest.MonkeyPatch) -> None:
    """States are expanded one at a time here; the level that was begun does not count."""
    monkeypatch.setattr("llfsm.runtime.verification._breadth_first.STATES_AT_ONCE", 1)
    depths: list[int] = []

    def stop(now: Progress) -> bool:
        depths.append(now.depth)
        return now.depth == 0 or depths[-2:] != [now.depth] * 2

    space = explore(Hall, period_ms=50, progress=stop)
    assert not space.complete
    assert depths[-2:] == [space.depth] * 2
    whole = explore(Hall, period_ms=50)
    assert whole.complete
    assert space.states < whole.states
    assert explore(Hall, period_ms=50, progress=lambda now: True).states == whole.states
