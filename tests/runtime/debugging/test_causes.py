"""Each transition of a state is explained by the operands that it sees, without an effect."""

from __future__ import annotations

import math

from llfsm.runtime import Arrangement, Machine, ManualClock, Sensor, State
from llfsm.runtime.bundles import Bundle, BundleState, BundleTransition, Fragment, compile_bundle
from llfsm.runtime.debugging.causes import why
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.turtlesim import Pose

POSE = Slot("pose", Pose)
LIMIT = 9
effects: list[str] = []


class Wall(Machine):
    """Have a guard of each kind."""

    pose = Sensor(POSE)
    turns: int = 3
    found: object = None

    go = State()
    end = State()

    @go.to(end)
    def near(self) -> bool:
        return self.pose is not None and not 2 < self.pose.x < LIMIT

    go.to(end, when=lambda m: m.pose.y > 100 or m.turns % 2 == 1)
    go.to(end, after_ms=1000)
    go.to(end, after_ms=100, when=lambda m: m.after(2) and m.turns > 0)
    go.to(end, when=lambda m: m.is_far)
    go.to(end, when=lambda m: m.noting() and m.turns > 2)
    go.to(end, when=lambda m: abs(math.floor(m.pose.theta)) == 1)
    go.to(end, when=lambda m: m.found.x > 1)

    @go.to(end)
    def long(self) -> bool:
        turns = self.turns
        return turns == 0

    @property
    def is_far(self) -> bool:
        return self.turns > 9

    def noting(self) -> bool:
        """Have an effect."""
        effects.append("noted")
        return True


class Hostile:
    """Have an effect when an attribute or a comparison is asked for."""

    @property
    def x(self) -> int:
        effects.append("read")
        return 1


def test_each_transition_is_explained() -> None:
    board = Whiteboard.local()
    arrangement = Arrangement([Wall], whiteboard=board, clock=ManualClock())
    board.add_message(POSE, Pose(x=7.5625, y=2.0, theta=-0.5))
    machine = arrangement.machine("Wall")
    machine.pose, machine.found = board.get_message(POSE), Hostile()
    effects.clear()
    found = [(cause.value, cause.seen) for cause in why(machine, "go", 320_000_000)]
    pose = "Pose(x=7.5625, y=2.0, theta=-0.5, linear_v...r_velocity=0.0)"
    assert found[1:] == [
        (True, "pose.y=2 > 100 or turns=3 % 2 == 1"),
        (False, "320 ms > 1000 ms"),
        (False, "320 ms > 100 ms and (0.32 s > 2 s and turns=3 > 0)"),
        (False, "is_far=False"),
        (None, "m.noting() and turns=3 > 2"),
        (True, "abs(math.floor(pose.theta))=1 == 1"),
        (None, "m.found.x > 1"),
        (None, "long: more than one expression"),
    ]
    assert found[0][0] is False
    assert found[0][1].endswith("is not None and (not 2 < pose.x=7.5625 < LIMIT=9)"), pose
    assert effects == []


def test_a_state_that_was_not_entered_has_no_time() -> None:
    machine = Wall()
    assert why(machine, "go", None)[2][2:] == (None, "elapsed > 1000 ms")
    assert why(machine, "end", None) == why(machine, "Suspended", None) == []


def test_a_bundle_is_explained() -> None:
    expression = BundleTransition("B", Fragment("after_ms(50) and count > limit\n"))
    bundle = Bundle(
        "Counts",
        (
            BundleState("A", {}, (expression,), variables=Fragment("limit: int = 4\n")),
            BundleState("B"),
        ),
        variables=Fragment("count: int = 7\n"),
    )
    machine = compile_bundle(bundle)()
    (cause,) = why(machine, "A", 60_000_000)
    assert (cause.value, cause.seen) == (True, "60 ms > 50 ms and count=7 > limit=4")


NUMBERS, d = [1, 2], 99


class Compound(Machine):
    """Have guards of which each part has a value, or none."""

    numbers: list[int] = [1, 2]  # noqa: RUF012  a machine has a copy
    found: set[int] = {1, 2}  # noqa: RUF012
    x: float = 7.5
    word: str = "bob"

    go = State()
    end = State()

    go.to(end, when=lambda m: m.numbers == [1, 2] and m.found == {1, 2})
    go.to(end, when=lambda m: m.x**2 < 2 << 4 or m.numbers[:1] == [1])
    go.to(end, when=lambda m: (d := m.x - 5) > 2 and d < 9)
    go.to(end, when=lambda m: f"{m.word}-{m.numbers[0]}" == "bob-1")
    go.to(end, when=lambda m: f"{m.word!r:>9}" == m.word)
    go.to(end, when=lambda m: [d > m.x for d in m.numbers] == [d])
    go.to(end, when=lambda m: all(m.numbers) and sorted(m.numbers)[0] == 1)
    go.to(end, when=lambda m: (lambda d: d > m.x) if m.x else d > 3)


def test_a_compound_guard_is_explained() -> None:
    """A name that the expression binds is no global of the same name."""
    found = [(cause.value, cause.seen) for cause in why(Compound(), "go", 0)]
    assert found == [
        (True, "numbers=[1, 2] == [1, 2] and found={1, 2} == {1, 2}"),
        (True, "(x=7.5) ** 2 < 2 << 4 or numbers[:1]=[1] == [1]"),
        (True, "(d := (x=7.5 - 5)) > 2 and d=2.5 < 9"),
        (True, "'bob-1' == 'bob-1'"),
        (False, "\"    'bob'\" == word='bob'"),
        (False, "[False, False] == [d=99]"),
        (True, "all(numbers)=True and sorted(numbers)[0]=1 == 1"),
        (None, "(lambda d: d > x=7.5) if x=7.5 else d=99 > 3"),
    ]
