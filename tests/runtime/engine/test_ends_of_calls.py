"""A called machine ends with the state in which it was called, before its caller's own end."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from llfsm.runtime import (
    KEEP,
    Actuator,
    Arrangement,
    ExecutionError,
    Machine,
    ManualClock,
    State,
    Submachine,
)
from llfsm.whiteboard import Slot
from llfsm.whiteboard.local import LocalBoard

from .commands import ARM, LAMP, WHEEL, Heard, Speed


class Wheel(Machine):
    """Drives until it is done."""

    post = Actuator(WHEEL, at_end=Speed(by="Wheel"))
    over: bool = False
    drive, done = State(), State()

    @drive.internal
    def _(self) -> None:
        self.post(Speed(by="Wheel", value=1))

    drive.to(done, when=lambda self: self.over)


class Arm(Machine):
    """Calls the wheel, and moves."""

    post = Actuator(ARM, at_end=Speed(by="Arm"), at_suspend=Speed(by="Arm, suspended"))
    wheel: Submachine[Wheel] | None = None
    work, done = State(), State()

    @work.on_entry
    def _(self) -> None:
        self.wheel = self.call_machine(Wheel())
        self.post(Speed(by="Arm", value=1))

    work.to(done, when=lambda self: self.stopping)


class Mission(Machine):
    """Calls the arm, and lights a lamp meanwhile."""

    post = Actuator(LAMP, at_end=Speed(by="Mission"))
    arm: Submachine[Arm] | None = None
    bad: bool = False
    detached: bool = False
    work, rest = State(), State()

    @work.on_entry
    def _(self) -> None:
        self.post(Speed(by="Mission", value=1))
        self.arm = self.call_machine(Arm(), detached=self.detached)

    @work.internal
    def _(self) -> None:
        if self.bad:
            raise ValueError("lost")

    @work.on_exit
    def _(self) -> None:
        self.post(Speed(by="Mission's OnExit"))

    @work.to(rest)
    def finished(self) -> bool:
        return self.arm is not None and self.arm.failed

    work.to(rest, when=lambda self: self.stopping)
    rest.to(rest, when=lambda self: False)


class World:
    """The three machines at work, and what is posted from then on."""

    def __init__(self, **how: Any):
        self.board, self.posts = LocalBoard(), list[str]()
        self.mission = Mission(detached=how.pop("detached", False))
        self.arrangement = Arrangement(
            [self.mission], whiteboard=self.board, clock=ManualClock(), **how
        )
        self.arrangement.round()
        assert [*self.arrangement.states()] == ["Mission", "Arm", "Wheel"]
        self.heard = [Heard(self.board, slot, self.posts) for slot in (WHEEL, ARM, LAMP)]

    def at(self, slot: Slot[Speed]) -> str:
        found = self.board.get_message(slot)
        assert found is not None
        return f"{found.by} {found.value}"

    @property
    def moving(self) -> set[str]:
        return {each for slot in (WHEEL, ARM, LAMP) if not (each := self.at(slot)).endswith(" 0")}


INNER = ["Wheel 0", "Arm 0"]
ENDS = {
    "suspend": [*INNER, "Mission 0"],
    "restart": [*INNER, "Mission 0"],
    "unload": [*INNER, "Mission 0"],
    "abandon": [*INNER, "Mission 0"],
    "raise": [*INNER, "Mission 0"],
    "stop_machine": [*INNER, "Mission's OnExit 0"],
    "end": [*INNER, "Mission 0"],
}


@pytest.mark.parametrize("how", ENDS)
def test_calls_end_inwards_first_whatever_ends_their_caller(how: str) -> None:
    world = World(on_error="suspend")
    arrangement, control = world.arrangement, world.arrangement.control
    match how:
        case "raise":
            world.mission.bad = True
        case "end":
            arrangement.end()
        case "stop_machine":
            arrangement.stop_machine("Mission")
        case _:
            getattr(control, how)("Mission")
    before = len(ENDS[how])
    if how not in ("end", "unload", "abandon"):
        arrangement.round()
    assert world.posts[: before + 1] == [*ENDS[how], *world.posts[before : before + 1]]
    assert world.posts[:before] == ENDS[how]
    if how == "restart":  # it has begun anew, and so have its calls
        assert world.posts[before] == "Mission 1"
        assert [*arrangement.states()] == ["Mission", "Arm", "Wheel"]
    else:
        assert not world.moving
        assert {"Arm", "Wheel"}.isdisjoint(arrangement.states())


@pytest.mark.parametrize("how", ["suspend", "restart", "unload", "raise"])
def test_calls_of_a_called_machine_end_with_its_state(how: str) -> None:
    world = World(on_error="suspend")
    arrangement = world.arrangement
    if how == "raise":
        arm: Any = arrangement.machine("Arm")
        arm.wheel = None
        arrangement.kernel.fail(
            arrangement.roster.find("Arm"), ExecutionError("", "Arm", "work", "", None, None)
        )
    else:
        getattr(arrangement.control, how)("Arm")
        arrangement.round()
    first = ["Arm 0"] if how == "unload" else ["Arm, suspended 0"]
    assert world.posts[:2] == ["Wheel 0", *first]
    everything = {"Mission 1", "Arm 1", "Wheel 1"}
    left = set[str]() if how == "unload" else {"Mission 1"}  # which sees that the call is over
    assert world.moving == (everything if how == "restart" else left)


def test_a_detached_call_outlives_its_caller() -> None:
    world = World(detached=True)
    world.arrangement.unload("Mission")
    world.arrangement.round()
    assert world.moving == {"Arm 1", "Wheel 1"}


def test_a_transition_to_the_same_state_ends_no_call() -> None:
    class Again(Machine):
        sub: Submachine[Wheel] | None = None
        work = State()

        @work.on_entry
        def _(self) -> None:
            self.sub = self.call_machine(Wheel())

        work.to(work)

    again = Again()
    arrangement = Arrangement([again], whiteboard=LocalBoard(), clock=ManualClock())
    for _ in range(5):
        arrangement.round()
    assert [*arrangement.states()] == ["Again", "Wheel"]
    assert again.sub is not None
    assert not again.sub.failed


def test_a_call_of_a_suspend_state_ends_when_the_machine_is_resumed() -> None:
    class Parks(Machine):
        work, parked = State(), State(suspend=True)
        work.to(work, when=lambda self: False)

        @parked.on_entry
        def _(self) -> None:
            self.call_machine(Wheel())

    arrangement = Arrangement([Parks], whiteboard=LocalBoard(), clock=ManualClock())
    arrangement.round()
    arrangement.suspend("Parks")
    arrangement.round()
    assert [*arrangement.states()] == ["Parks", "Wheel"]
    arrangement.resume("Parks")
    arrangement.round()
    assert [*arrangement.states()] == ["Parks"]


# Restart, and what a suspension posts


class Ramp(Machine):
    """Brakes by itself while it is suspended."""

    post = Actuator(WHEEL, at_suspend=KEEP, at_end=Speed(by="Ramp"))
    speed: int = 2
    reasons: tuple[str, ...] = ()
    bad: bool = False
    drive, brake = State(), State(suspend=True)

    @drive.internal
    def _(self) -> None:
        self.post(Speed(by="Ramp", value=self.speed))
        if self.bad:
            raise ValueError("lost")

    drive.to(drive, when=lambda self: False)

    @brake.internal
    def _(self) -> None:
        self.reasons = (*self.reasons, str(self.failure and self.failure.__cause__))
        self.speed = max(self.speed - 1, 0)
        self.post(Speed(by="Ramp", value=self.speed))


def ramped(how: str) -> tuple[list[int], Ramp]:
    """List what is posted after a request or a failure, in three rounds."""
    board, posts, machine = LocalBoard(), list[str](), Ramp()
    arrangement = Arrangement([machine], whiteboard=board, clock=ManualClock(), on_error="suspend")
    arrangement.round()
    heard = Heard(board, WHEEL, posts)
    if how == "raise":
        machine.bad = True
        arrangement.round()
    else:
        getattr(arrangement, how)("Ramp")
    for _ in range(3):
        arrangement.round()
    assert heard
    return [int(each.split()[1]) for each in posts], machine


def test_a_suspend_state_brakes_by_itself_if_the_suspension_is_to_post_nothing() -> None:
    posts, machine = ramped("suspend")
    assert posts == [1, 0, 0]
    assert machine.reasons == ("None", "None", "None")


def test_a_restart_posts_safe_values_also_then() -> None:
    assert ramped("restart")[0] == [0, 2, 2, 2]


def test_a_failure_posts_safe_values_also_then_and_the_suspend_state_knows_it() -> None:
    posts, machine = ramped("raise")
    assert posts == [2, 0, 1, 0, 0]
    assert machine.reasons == ("lost",) * 3


@pytest.mark.parametrize("suspended", [False, True])
def test_a_restart_posts_the_values_of_a_suspension_unless_it_is_suspended(
    suspended: bool,
) -> None:
    board, posts = LocalBoard(), list[str]()
    arrangement = Arrangement([Arm], whiteboard=board, clock=ManualClock())
    arrangement.round()
    if suspended:
        arrangement.suspend("Arm")
        arrangement.round()
    heard = Heard(board, ARM, posts)
    arrangement.restart("Arm")
    arrangement.round()
    assert heard
    assert posts == (["Arm 1"] if suspended else ["Arm, suspended 0", "Arm 1"])


# Random sequences


class Ends(RuleBasedStateMachine):
    """No slot has a value that no living machine commands."""

    def __init__(self) -> None:
        super().__init__()
        self.board = LocalBoard()
        self.arrangement = Arrangement(
            [Mission], whiteboard=self.board, clock=ManualClock(), on_error="suspend"
        )

    def machines(self) -> dict[str, Any]:
        return {each.name: each for each in self.arrangement.machines}

    @precondition(lambda self: self.arrangement.machines)
    @rule(
        data=st.data(),
        how=st.sampled_from(
            ["suspend", "resume", "restart", "unload", "abandon", "stop_machine", "raise", "over"]
        ),
    )
    def ask(self, data: st.DataObject, how: str) -> None:
        name = data.draw(st.sampled_from([*self.machines()]))
        machine = self.machines()[name]
        if how == "raise":
            if isinstance(machine, Mission):
                machine.bad = not machine.bad
        elif how == "over":
            if isinstance(machine, Wheel):
                machine.over = True
        else:
            getattr(self.arrangement.control, how)(name)

    @rule(number=st.integers(1, 3))
    def turn(self, number: int) -> None:
        for _ in range(number):
            self.arrangement.round()

    @invariant()
    def nothing_moves_without_a_machine(self) -> None:
        kinds = {Wheel: WHEEL, Arm: ARM, Mission: LAMP}
        living = {
            type(each)
            for each in self.arrangement.machines
            if not self.arrangement.is_suspended(each.name)
            or self.arrangement.roster.find(each.name).previous is not None
        }
        for kind, slot in kinds.items():
            found = self.board.get_message(slot)
            if found is not None and found.value:
                assert kind in living, f"{kind.__name__} is gone, and {slot.name} has {found}"
        callers = {
            each.wheel and each.wheel.name
            for each in self.arrangement.machines
            if isinstance(each, Arm)
        }
        for each in self.arrangement.machines:
            if isinstance(each, Wheel):
                assert each.name in callers


TestEnds = Ends.TestCase
TestEnds.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)
