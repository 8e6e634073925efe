"""What a state runs begins, takes turns, is seen and ends with the state, at any depth."""

from __future__ import annotations

from typing import Any

import pytest

from definition import Defined
from llfsm.runtime import (
    KEEP,
    Actuator,
    Arrangement,
    DefinitionError,
    ExecutionError,
    LoadError,
    Machine,
    ManualClock,
    NotLoadedError,
    State,
    TimeSlot,
    Timetable,
)
from llfsm.whiteboard import Slot
from llfsm.whiteboard.local import LocalBoard

from .commands import ARM, LAMP, WHEEL, Heard, Speed


class Wheel(Machine):
    """Drives for some turns."""

    post = Actuator(WHEEL, at_suspend=Speed("Wheel, suspended"), at_end=Speed("Wheel"))
    to: int = 99
    turns: int = 0
    bad: bool = False
    drive, done = State(), State()

    @drive.internal
    def _(self) -> None:
        if self.bad:
            raise ValueError("flat tyre")
        self.turns += 1
        self.post(Speed("Wheel", 1))

    drive.to(done, when=lambda self: self.turns >= self.to or self.stopping)


class Arm(Machine):
    """Moves, and the wheel with it."""

    post = Actuator(ARM, at_suspend=Speed("Arm, suspended"), at_end=Speed("Arm"))
    to: int = 99
    work = State(runs=lambda self: Wheel(to=self.to))
    done = State()

    @work.on_entry
    def _(self) -> None:
        self.post(Speed("Arm", 1))

    work.to(done, when_done=True)


class Mission(Machine):
    """Lights a lamp while the arm works."""

    post = Actuator(LAMP, at_suspend=Speed("Mission, suspended"), at_end=Speed("Mission"))
    to: int = 99
    bad: bool = False
    enough: bool = False
    seen: tuple[Any, ...] = ()
    work = State(runs=lambda self: Arm(to=self.to))
    rest, failed = State(), State()

    @work.on_entry
    def _(self) -> None:
        self.post(Speed("Mission", 1))

    @work.internal
    def _(self) -> None:
        if self.bad:
            raise ValueError("lost")

    @work.on_exit
    def _(self) -> None:
        self.post(Speed("Mission's OnExit"))

    work.to(rest, when_done=True)
    work.to(rest, when=lambda self: self.enough)
    rest.to(rest, when=lambda self: False)
    failed.to(failed, when=lambda self: False)
    work.to(failed, when=lambda self: False)


class World:
    """The three machines at work, and what is posted from then on."""

    def __init__(self, kind: type[Arrangement] = Arrangement, **how: Any):
        self.board, self.posts = LocalBoard(), list[str]()
        self.mission = how.pop("mission", None) or Mission()
        self.arrangement = kind([self.mission], whiteboard=self.board, clock=ManualClock(), **how)
        self.arrangement.round()
        self.heard = [Heard(self.board, slot, self.posts) for slot in (WHEEL, ARM, LAMP)]

    def machine(self, name: str) -> Any:
        return self.arrangement.machine(name)

    def rounds(self, number: int) -> None:
        for _ in range(number):
            self.arrangement.round()


NAMES = ["Mission", "Mission/Arm", "Mission/Arm/Wheel"]
INNER = ["Wheel 0", "Arm 0"]
HALTED = ["Wheel, suspended 0", "Arm, suspended 0", "Mission, suspended 0"]
ENDS = {
    "transition": [*INNER, "Mission's OnExit 0"],
    "suspend": HALTED,
    "abandon": HALTED,
    "restart": [*INNER, "Mission, suspended 0"],
    "unload": [*INNER, "Mission 0"],
    "raise": [*INNER, "Mission, suspended 0"],
    "end": [*INNER, "Mission 0"],
}


@pytest.mark.parametrize("kind", [Arrangement, Defined])
@pytest.mark.parametrize("how", ENDS)
def test_what_a_state_runs_ends_inwards_first(how: str, kind: type[Arrangement]) -> None:
    world = World(kind, on_error="suspend")
    arrangement = world.arrangement
    assert [*arrangement.states()] == NAMES
    match how:
        case "raise":
            world.mission.bad = True
        case "transition":
            world.mission.enough = True
        case "end":
            arrangement.end()
        case _:
            getattr(arrangement.control, how)("Mission")
    if how not in ("end", "unload", "abandon"):
        arrangement.round()
    number = len(ENDS[how])
    assert world.posts[:number] == ENDS[how]
    if how == "restart":  # it has begun anew, and so has what it runs
        assert world.posts[number:] == ["Mission 1", "Arm 1", "Wheel 1"]
        assert [*arrangement.states()] == NAMES
        return
    assert len(world.posts) == number
    kept = {"suspend": NAMES, "abandon": NAMES, "unload": []}.get(how, NAMES[:1])
    assert [*arrangement.states()] == kept
    if how == "end":
        return
    world.rounds(3)
    assert len(world.posts) == number, "nothing drives on"


def test_turns_are_one_sequence_depth_first() -> None:
    turns: list[str] = []

    class Noted(Machine):
        a = State(final=False)

        @a.internal
        def _(self) -> None:
            turns.append(self.name)

    class Inner(Noted):
        b = State()

        @b.internal
        def _(self) -> None:
            turns.append(self.name)

        c = State(runs=[Noted])

        @c.internal
        def _(self) -> None:
            turns.append(self.name)

        Noted.a.to(b)
        b.to(c)

    class Outer(Machine):
        a = State(runs=[Inner, Noted])

        @a.internal
        def _(self) -> None:
            turns.append(self.name)

    class Last(Noted):
        pass

    for kind in (Arrangement, Defined):
        arrangement = kind([Outer, Last], clock=ManualClock())
        rounds = []
        for _ in range(4):
            turns.clear()
            arrangement.round()
            rounds.append([*turns])
        both = ["Outer", "Outer/Noted", "Last"]
        inner = ["Outer", "Outer/Inner", "Outer/Inner/Noted", "Outer/Noted", "Last"]
        assert rounds == [both, both, inner, inner]


def test_the_results_are_in_the_machine_also_after_the_state() -> None:
    class Uses(Machine):
        work = State(runs=lambda self: Wheel(to=3))
        done = State()
        turns: int = 0
        work.to(done, when_done=True)

        @done.on_entry
        def _(self) -> None:
            self.turns = self.work.machine.turns

    uses = Uses()
    world = World(mission=uses)
    assert repr(uses.work) == "<Submachine Uses/Wheel: in drive>"
    assert not uses.work.done
    world.rounds(6)
    assert uses.turns == 3
    assert uses.work.done
    assert not uses.work.failed


def test_before_its_state_there_is_nothing() -> None:
    class Later(Machine):
        first = State()
        work = State(runs=Wheel)
        both = State(runs=[Wheel, Wheel])
        first.to(work, when=lambda self: False)
        work.to(both, when_done=True)

    later = Later()
    with pytest.raises(NotLoadedError):
        assert later.work
    World(mission=later)
    assert (later.work.done, later.work.failed, later.work.error) == (False, False, None)
    assert (later.both.done, later.both.failed, later.both.error) == (False, False, None)
    assert later.both.machines == ()
    assert repr(later.work) == "<Submachine: has not run yet>"
    assert repr(later.both) == "<Submachines that have not run yet>"
    with pytest.raises(NotLoadedError, match="not there before the state's OnEntry"):
        assert later.work.machine


def test_a_state_without_transitions_ends_its_machine_when_what_it_runs_is_done() -> None:
    class Only(Machine):
        work = State(runs=[lambda self: Wheel(to=2), lambda self: Wheel(to=4)])

    only = Only()
    arrangement = Arrangement([only], whiteboard=LocalBoard(), clock=ManualClock())
    seen = []
    while not arrangement.finished:
        arrangement.round()
        seen.append(([*arrangement.states()], only.work.done))
    assert seen == [
        *[(["Only", "Only/Wheel", "Only/Wheel.0"], False)] * 3,
        *[(["Only", "Only/Wheel.0"], False)] * 2,
        (["Only"], True),
        ([], True),
    ]
    assert [each.turns for each in only.work.machines] == [2, 4]


@pytest.mark.parametrize("on_error", ["stop", "suspend"])
def test_a_failure_that_no_transition_is_for_is_one_of_the_outer_machine(on_error: Any) -> None:
    world = World(on_error=on_error)
    world.machine("Mission/Arm/Wheel").bad = True
    world.arrangement.round()  # in which the wheel fails, behind the others
    assert not world.arrangement.roster.find("Mission").failure
    world.arrangement.round()  # in which the arm does
    if on_error == "stop":
        with pytest.raises(ExecutionError, match="Mission/Arm has failed, and no transition") as at:
            world.arrangement.round()
        assert isinstance(at.value.__cause__, ExecutionError)
        assert "Mission/Arm/Wheel has failed" in str(at.value.__cause__)
        assert "flat tyre" in str(at.value.__cause__.__cause__)
    else:
        world.arrangement.round()
        assert world.arrangement.states() == {"Mission": "Suspended"}
        assert str(world.mission.failure).startswith("machine Mission, state work, runs: Mission/")
    assert [each.rpartition(" ")[2] for each in world.posts[-3:]] == ["0"] * 3


@pytest.mark.parametrize("on_error", ["stop", "suspend"])
def test_a_failure_is_handled_by_a_transition(on_error: Any) -> None:
    class Handles(Machine):
        work = State(runs=Wheel)
        failed = State()
        why: str = ""
        work.to(failed, when_failed=True)

        @failed.on_entry
        def _(self) -> None:
            self.why = str(self.work.error and self.work.error.__cause__)

    handles = Handles()
    world = World(mission=handles, on_error=on_error)
    world.machine("Handles/Wheel").bad = True
    world.rounds(3)
    assert handles.why == "flat tyre"
    assert handles.work.failed
    assert world.arrangement.finished
    assert world.posts[-1] == "Wheel 0"


def test_one_that_is_unloaded_has_failed() -> None:
    world = World(on_error="suspend")
    world.arrangement.unload("Mission/Arm")
    assert world.mission.work.failed
    world.arrangement.round()
    assert "was unloaded before it was done" in str(world.mission.failure)


def test_a_suspension_keeps_it_where_it_is() -> None:
    world = World()
    world.rounds(2)
    wheel = world.machine("Mission/Arm/Wheel")
    assert wheel.turns == 3
    world.arrangement.suspend("Mission")
    world.rounds(4)
    assert set(world.arrangement.states().values()) == {"Suspended"}
    assert wheel.turns == 3
    world.posts.clear()
    world.arrangement.resume("Mission")
    world.arrangement.round()
    assert world.machine("Mission/Arm/Wheel") is wheel
    assert wheel.turns == 4
    assert world.posts == ["Mission 1", "Arm 1", "Wheel 1"]


def test_one_that_was_suspended_alone_stays_so() -> None:
    world = World()
    world.arrangement.suspend("Mission/Arm/Wheel")
    world.arrangement.round()
    world.arrangement.suspend("Mission")
    world.rounds(2)
    world.arrangement.resume("Mission")
    world.rounds(2)
    assert [*world.arrangement.states().values()] == ["work", "work", "Suspended"]


@pytest.mark.parametrize("how", ["resume", "restart"])
def test_nobody_wakes_one_whose_outer_machine_is_suspended(how: str) -> None:
    world = World()
    world.arrangement.suspend("Mission")
    world.rounds(2)
    world.posts.clear()
    getattr(world.arrangement, how)("Mission/Arm/Wheel")
    world.rounds(2)
    assert set(world.arrangement.states().values()) == {"Suspended"}
    assert world.posts == []
    world.arrangement.resume("Mission")
    world.rounds(1)
    assert world.posts == ["Mission 1", "Arm 1", "Wheel 1"]


def test_one_that_is_suspended_meanwhile_stays_so() -> None:
    world = World()
    world.arrangement.suspend("Mission")
    world.rounds(2)
    world.arrangement.suspend("Mission/Arm/Wheel")
    world.rounds(1)
    world.arrangement.resume("Mission")
    world.rounds(2)
    assert [*world.arrangement.states().values()] == ["work", "work", "Suspended"]
    world.arrangement.resume("Mission/Arm/Wheel")
    world.rounds(1)
    assert world.machine("Mission/Arm/Wheel").state_name == "drive"


class Steps(Machine):
    """Goes to its second state, and stays."""

    begun: int = 0
    first, second = State(), State(final=False)
    first.to(second)

    @first.on_entry
    def _(self) -> None:
        self.begun += 1


class RunsSteps(Machine):
    away: bool = False
    work = State(runs=Steps, history=True)
    wait = State(final=False)
    work.to(wait, when=lambda self: self.away)
    wait.to(work, when=lambda self: not self.away)


@pytest.mark.parametrize("kind", [Arrangement, Defined])
@pytest.mark.parametrize("when", ["before", "meanwhile", "put away"])
@pytest.mark.parametrize(
    ("asked", "begun", "state"),
    [
        (["restart"], 2, "second"),
        (["restart", "resume"], 2, "second"),
        (["restart", "suspend"], 1, "Suspended"),
        (["suspend", "restart"], 2, "second"),
        (["resume"], 1, "second"),
    ],
)
def test_a_restart_is_for_when_it_goes_on(
    asked: list[str], begun: int, state: str, when: str, kind: type[Arrangement]
) -> None:
    outer = RunsSteps()
    arrangement = kind([outer], clock=ManualClock())
    for _ in range(3):
        arrangement.round()
    if when == "meanwhile":
        arrangement.suspend("RunsSteps")
        arrangement.round()
    for how in asked:
        getattr(arrangement, how)("RunsSteps/Steps")
    if when == "before":
        arrangement.suspend("RunsSteps")
    outer.away = when == "put away"
    arrangement.round()
    arrangement.round()
    assert arrangement.states().get("RunsSteps/Steps") == (None if outer.away else "Suspended")
    assert outer.work.machine.begun == 1
    outer.away = False
    arrangement.resume("RunsSteps")
    for _ in range(3):
        arrangement.round()
    assert outer.work.machine.begun == begun
    assert arrangement.states()["RunsSteps/Steps"] == state


class Alternates(Machine):
    """Drives, and waits in between."""

    work = State(runs=lambda self: Wheel(to=6), history=True)
    wait, over = State(), State()
    away: bool = False
    work.to(over, when_done=True)
    work.to(wait, when=lambda self: self.away)
    wait.to(work, when=lambda self: not self.away)
    over.to(work, when=lambda self: self.away)


@pytest.mark.parametrize("kind", [Arrangement, Defined])
def test_with_a_history_it_goes_on_where_it_was_left(kind: type[Arrangement]) -> None:
    alternates = Alternates()
    world = World(kind, mission=alternates)
    world.rounds(1)
    wheel = world.machine("Alternates/Wheel")
    alternates.away = True
    world.posts.clear()
    world.rounds(2)
    assert world.posts == ["Wheel, suspended 0", "Wheel 0"]
    assert world.arrangement.states() == {"Alternates": "wait"}
    assert not alternates.work.failed
    alternates.away = False
    world.rounds(2)
    assert world.machine("Alternates/Wheel") is wheel
    assert wheel.turns == 3
    world.rounds(9)
    assert alternates.state_name == "over"
    assert wheel.turns == 6
    alternates.away = True  # what was done begins anew
    world.rounds(1)
    alternates.away = False
    world.rounds(1)
    assert world.machine("Alternates/Wheel") is not wheel


class Two(Machine):
    """Drives and moves at once."""

    work = State(runs=[Wheel, Arm], history=True)
    wait = State()
    away: bool = False
    work.to(wait, when_failed=True)
    work.to(wait, when=lambda self: self.away)
    wait.to(work, when=lambda self: not self.away)


@pytest.mark.parametrize("how", ["suspend", "unload", "leave"])
def test_of_several_the_last_one_ends_first(how: str) -> None:
    two = Two()
    world = World(mission=two)
    two.away = how == "leave"
    if how != "leave":
        getattr(world.arrangement.control, how)("Two")
    world.rounds(1)
    arm = next(place for place, each in enumerate(world.posts) if each.startswith("Arm"))
    assert "Wheel" in world.posts[0]  # that of the arm, which is inside it
    assert "Wheel" in world.posts[-1]
    assert 0 < arm < len(world.posts) - 1


def test_after_a_failure_all_begin_anew() -> None:
    two = Two()
    world = World(mission=two)
    before = two.work.machines
    before[0].bad = True
    world.rounds(2)
    assert two.state_name == "wait"
    two.away = False
    world.rounds(2)
    assert two.state_name == "work"
    assert all(each not in before for each in two.work.machines)


@pytest.mark.parametrize("outer_first", [False, True])
def test_both_may_be_suspended_in_one_round(outer_first: bool) -> None:
    world = World()
    names = ["Mission", "Mission/Arm/Wheel"]
    for name in names if outer_first else names[::-1]:
        world.arrangement.suspend(name)
    world.rounds(2)
    world.arrangement.resume("Mission")
    world.rounds(2)
    assert [*world.arrangement.states().values()] == ["work", "work", "Suspended"]


@pytest.mark.parametrize("alone", [False, True])
def test_with_a_history_one_that_was_suspended_alone_stays_so(alone: bool) -> None:
    alternates = Alternates()
    world = World(mission=alternates)
    world.arrangement.suspend("Alternates/Wheel" if alone else "Alternates")
    world.rounds(1)
    if not alone:  # it leaves its state while it is suspended, and so does what it runs
        world.arrangement.resume("Alternates")
    alternates.away = True
    world.rounds(2)
    alternates.away = False
    world.rounds(2)
    assert world.arrangement.states()["Alternates/Wheel"] == ("Suspended" if alone else "drive")


def test_a_restart_forgets_the_history() -> None:
    alternates = Alternates()
    world = World(mission=alternates)
    wheel = world.machine("Alternates/Wheel")
    alternates.away = True
    world.rounds(2)
    alternates.away = False
    world.arrangement.restart("Alternates")
    world.rounds(1)
    assert world.machine("Alternates/Wheel") is not wheel


def test_a_machine_that_brakes_by_itself_posts_its_values_when_it_is_put_away() -> None:
    class Ramps(Wheel):
        post = Actuator(WHEEL, at_suspend=KEEP, at_end=Speed("Ramps"))

    class Leaves(Machine):
        work = State(runs=Ramps, history=True)
        over = State(final=False)
        work.to(over, when=lambda self: self.after_ms(0))

    world = World(mission=Leaves())
    world.arrangement.kernel.environment.clock.advance(ms=1)  # type: ignore[attr-defined]
    world.rounds(1)
    assert world.posts == ["Ramps 0"]


def test_a_stop_of_one_machine_reaches_what_it_runs() -> None:
    world = World()
    world.arrangement.stop_machine("Mission")
    world.rounds(6)
    assert world.mission.state_name == "rest"


def test_in_a_timetable_it_has_its_turns_in_the_slot_of_its_machine() -> None:
    slots = [TimeSlot("Mission", 0, 1_000), TimeSlot("Other", 1_000, 1_000)]
    turns: list[str] = []
    mission = Mission(to=2)

    class Other(Machine):
        a = State(final=False)

    arrangement = Arrangement(
        [mission, Other],
        whiteboard=LocalBoard(),
        clock=ManualClock(),
        timetable=Timetable(slots, 4_000),
        observers=[lambda event: turns.append(getattr(event, "machine", ""))],
    )
    arrangement.round()
    seen = [name for number, name in enumerate(turns) if name and name != turns[number - 1]]
    assert seen == [*NAMES, "Other"]
    for _ in range(7):
        arrangement.round()
    assert mission.state_name == "rest"


def test_slots_have_the_names_that_they_have_for_the_outer_machine() -> None:
    board = LocalBoard()
    arrangement = Arrangement(whiteboard=board, clock=ManualClock())
    arrangement.load(Mission, slots={"wheel": "left/wheel"})
    arrangement.round()
    assert board.get_message(Slot("left/wheel", Speed)) == Speed("Wheel", 1)

    class Plain(Machine):
        work = State(runs=Wheel)

    with pytest.raises(LoadError, match="Plain uses no slot 'wheels'; it uses: wheel"):
        arrangement.load(Plain, slots={"wheels": "left"})


def test_machines_that_run_each_other_without_end_are_refused() -> None:
    class Endless(Machine):
        work = State(runs=lambda self: Endless())

    for kind in (Arrangement, Defined):
        arrangement = kind([Endless], clock=ManualClock(), on_error="suspend")
        for _ in range(40):
            arrangement.round()
        assert arrangement.states() == {"Endless": "Suspended"}
        error: Any = arrangement.machine("Endless").failure
        while error.__cause__ is not None:
            error = error.__cause__
        assert "32 machines deep: do their states run each other?" in str(error)


def test_the_outer_machine_may_reach_it_by_its_name() -> None:
    class Asks(Machine):
        work = State(runs=Wheel)
        work.to(work, when=lambda self: False)

        @work.internal
        def _(self) -> None:
            if self.status("Asks/Wheel") and self.after_ms(5):
                self.unload("Asks/Wheel")

    world = World(mission=Asks())
    assert [*world.arrangement.states()] == ["Asks", "Asks/Wheel"]


@pytest.mark.parametrize(
    ("runs", "what"),
    [
        (Wheel(), "a machine that could run only once: give its class"),
        (int, "which is no machine class"),
        (3, "what it runs must be a plain function of the machine, not 3"),
        ([], "is to run nothing"),
        ([Wheel, None], "what it runs must be a plain function"),
    ],
)
def test_what_cannot_be_run_is_refused(runs: Any, what: str) -> None:
    with pytest.raises(DefinitionError, match=what):
        State("a", runs=runs)


def test_ends_are_for_states_that_run_something() -> None:
    with pytest.raises(DefinitionError, match="'a': when_done and when_failed are for states that"):

        class Wrong(Machine):
            a = State()
            a.to(a, when_done=True)


@pytest.mark.parametrize("made", [None, 5, "Nothing"])
def test_what_a_function_makes_must_be_a_machine(made: Any) -> None:
    class Makes(Machine):
        work = State(runs=[Wheel, lambda self: made])

    arrangement = Arrangement([Makes], whiteboard=LocalBoard(), clock=ManualClock())
    with pytest.raises(ExecutionError, match="Makes, state work, OnEntry"):
        arrangement.round()
    assert not arrangement.states() or [*arrangement.states()] == ["Makes"]


def test_a_subclass_runs_what_its_parent_runs() -> None:
    class Longer(Mission):
        work_more = State()
        Mission.rest.to(work_more)

    assert [*World(mission=Longer()).arrangement.states()] == [
        each.replace("Mission", "Longer") for each in NAMES
    ]
