"""A guard is closed if nothing can change its value but what it is said to read."""

from __future__ import annotations

import enum
import functools
import importlib
import math
import pkgutil
import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest

import llfsm.machines
from llfsm.machines.calls import GoalCaller
from llfsm.machines.stand_ins import ActionStandIn
from llfsm.runtime import Actuator, Machine, Sensor, State, Submachine
from llfsm.runtime.bundles import load_bundle
from llfsm.runtime.expressions.guards import GuardReads, reads_of_guard
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages.turtlesim import Pose

LIMIT = 0.5
NAMES = ("a", "b")
MIXED = ["a"]
ORIGIN = Pose()
limit = 0.5


class Mode(enum.Enum):
    """Two ways to drive."""

    SLOW = 1
    FAST = 2


class Held(enum.Enum):
    """Members whose values can be changed."""

    FUSSY = [1]  # noqa: RUF012


class Fussy(int):
    """A number whose comparison could do anything."""

    def __gt__(self, other: int) -> bool:
        return random.random() > other


class Point(Message):
    """A message with code of its own."""

    x: float = 0.0
    parts: tuple[Pose, ...] = ()

    @property
    def is_far(self) -> bool:
        return self.x > LIMIT

    @property
    def is_lucky(self) -> bool:
        return random.random() > self.x

    def beyond(self, least: float = 1.0) -> bool:
        return self.x > least

    @staticmethod
    def doubled(value: float) -> float:
        return value * 2


def near(point: Point | None, least: float) -> bool:
    return point is not None and point.x < least


def again(machine: Robot, times: int) -> bool:
    return machine.on or (times > 0 and again(machine, times - 1))


def noisy(function: Any) -> Any:
    @functools.wraps(function)
    def wrapper(self: Any) -> Any:
        return function(self)

    return wrapper


class Robot(Machine):
    """A machine with one of everything that a guard can name."""

    pose = Sensor(Slot("guards_pose", Pose))
    point = Sensor(Slot("guards_point", Point), default=Point())
    drive = Actuator(Slot("guards_drive", Pose))
    count: int = 0
    on: bool = False
    label: str = ""
    mode: Mode = Mode.SLOW
    items: list[float] = []  # noqa: RUF012
    table_of: dict[str, int] = {}  # noqa: RUF012
    child: Submachine[Any] | None = None
    children: tuple[Submachine[Any], ...] = ()
    held: Held = Held.FUSSY
    whatever: Any = None
    fussy: Fussy = Fussy()
    bare: list = []  # type: ignore[type-arg]  # noqa: RUF012
    MOST: Final = 3
    least: Final = [3]

    def is_far(self, factor: float = 2.0) -> bool:
        """Two statements and a loop."""
        total = 0.0
        for each in self.items:
            if each > LIMIT:
                total = max(total, each * factor)
        return total > self.count

    def collects(self) -> bool:
        items = self.items
        items += [1.0]
        return True

    def counts(self) -> bool:
        self.count += 1
        return self.count > 3

    def remembers(self, seen: list[int] = []) -> bool:  # noqa: B006  # that is what is found
        return len(seen) > 1

    @property
    def is_ready(self) -> bool:
        return self.on and self.point.x > 0

    @staticmethod
    def half(value: float) -> float:
        return value / 2

    @noisy
    def wrapped(self) -> bool:
        return True

    go = State()
    stop = State()
    go.to(stop, when=lambda self: self.on)


CLOSED: list[tuple[Callable[[Any], object], GuardReads]] = [
    (lambda self: True, GuardReads()),
    (lambda self: self.on, GuardReads(variables={"on"})),
    (lambda self: self.stopping, GuardReads(stopping=True)),
    (lambda self: self.count + 1 > LIMIT, GuardReads(variables={"count"})),
    (lambda self: self.mode is Mode.FAST, GuardReads(variables={"mode"})),
    (lambda self: self.label in NAMES, GuardReads(variables={"label"})),
    (lambda self: self.label.upper() == "A", GuardReads(variables={"label"})),
    (lambda self: self.pose is not None and self.pose.x > 1, GuardReads({"pose"})),
    (lambda self: (p := self.pose) is not None and p.x > 1, GuardReads({"pose"})),
    (lambda self: math.hypot(self.point.x, 1) > math.pi, GuardReads({"point"})),
    (lambda self: self.point.is_far and self.point.beyond(2), GuardReads({"point"})),
    (lambda self: self.point.doubled(self.count) > 1, GuardReads({"point"}, {"count"})),
    (lambda self: self.point.parts[0].x > 1, GuardReads({"point"})),
    (lambda self: any(x > LIMIT for x in self.items), GuardReads(variables={"items"})),
    (lambda self: sorted({*self.items}, reverse=True)[0] > 1, GuardReads(variables={"items"})),
    (lambda self: self.table_of.get("a", 0) > 1, GuardReads(variables={"table_of"})),
    (lambda self: f"{self.count:03}" == "001", GuardReads(variables={"count"})),
    (lambda self: isinstance(self.mode, (int, Mode)), GuardReads(variables={"mode"})),
    (lambda self: self.after_ms(100) or self.after(2), GuardReads(limits_ns={1e8, 2e9})),
    (lambda self: self.timeout(self.count),
     GuardReads(variables={"count"}, limits_in={("count", 1e3)})),
    (lambda self: self.timeout(self.count + 1), GuardReads(variables={"count"}, reads_time=True)),
    (lambda self: self.is_running("Other") and self.state_name_of("B") == "go",
     GuardReads(machines={"Other", "B"})),
    (lambda self: self.is_suspended(self.label), GuardReads(variables={"label"}, machines={""})),
    (lambda self: self.child and self.child.done, GuardReads(variables={"child"}, machines={""})),
    (lambda self: str(self.child) > "", GuardReads(variables={"child"}, machines={""})),
    (lambda self: self.mode.value > 1, GuardReads(variables={"mode"})),
    (lambda self: self.state_name == "go" and self.name == "Robot", GuardReads()),
    (lambda self: self.count > self.MOST, GuardReads(variables={"count"})),
    (lambda self: self.is_far(factor=3.0), GuardReads(variables={"items", "count"})),
    (lambda self: self.is_ready, GuardReads({"point"}, {"on"})),
    (lambda self: self.half(self.count) > 1, GuardReads(variables={"count"})),
    (lambda self: near(self.point, LIMIT), GuardReads({"point"})),
    (lambda self, least=2: self.count > least, GuardReads(variables={"count"})),
]  # fmt: skip

OPEN: list[tuple[Callable[[Any], object], str]] = [
    (lambda self: random.random() > 0.5, "random.random"),
    (lambda self: time.time() > self.count, "time.time"),
    (lambda self: self.count > limit, "limit"),
    (lambda self: self.label in MIXED, "MIXED"),
    (lambda self: self.count > self.least[0], "self.least"),
    (lambda self: self.unknown, "self.unknown"),  # type: ignore[attr-defined]
    (lambda self: self.age_ms("pose") > 5, "self.age_ms"),
    (lambda self: self.number_of_machines > 1, "self.number_of_machines"),
    (lambda self: self.index_of("A") > 1, "self.index_of"),
    (lambda self: self.restart("A"), "self.restart"),
    (lambda self: self.drive(ORIGIN), "self.drive"),
    (lambda self: self.whatever > 1, "self.whatever"),
    (lambda self: self.bare[0] > 1, "self.bare"),
    (lambda self: self.fussy > 1, "self.fussy"),
    (lambda self: self.child.machine.count > 1, "self.child.machine"),
    (lambda self: self.child.cancel(), "self.child.cancel"),
    (lambda self: self.children[0].done, "self.children"),
    (lambda self: self.held.value > 1, "self.held.value"),
    (lambda self: self.point.is_lucky, "self.point.is_lucky: random.random"),
    (lambda self: self.items.append(1.0), "self.items.append"),
    (lambda self: self.items.pop() > 1, "self.items.pop"),
    (lambda self: max(self.items, key=lambda x: -x) > 1, "lambda x: -x"),
    (lambda self: self.collects(), "self.collects: items += [1.0]"),
    (lambda self: self.counts(), "self.counts: self.count += 1"),
    (lambda self: self.remembers(), "self.remembers: a default value"),
    (lambda self: self.wrapped(), "self.wrapped: function"),
    (lambda self: again(self, 2), "self"),
    (lambda self: self.pose == Pose(x=1.0), "Pose"),
    (lambda self: self.items @ self.items, "self.items @ self.items"),
    (lambda self: getattr(self, "count") > 1, "self"),  # noqa: B009  # that is what is found
    (lambda self: any(limit > 1 for limit in self.items), "limit"),
    (eval("lambda self: True"), "<lambda>, whose source is not found"),
    (functools.partial(near, None, 1.0), "partial"),
]  # fmt: skip


@pytest.mark.parametrize(("guard", "expected"), CLOSED)
def test_a_closed_guard_has_all_that_it_reads(
    guard: Callable[[Any], object], expected: GuardReads
) -> None:
    found = reads_of_guard(guard, Robot.table)
    assert found == expected
    assert found.is_closed


@pytest.mark.parametrize(("guard", "reason"), OPEN)
def test_an_open_guard_names_the_reason(guard: Callable[[Any], object], reason: str) -> None:
    found = reads_of_guard(guard, Robot.table)
    assert not found.is_closed
    assert found.open == reason


def test_a_variable_around_a_guard_may_change() -> None:
    least = 1
    assert reads_of_guard(lambda self: self.count > least, Robot.table).open == "least"


def test_a_class_that_answers_for_attributes_leaves_nothing_closed() -> None:
    class Answering(Machine):
        on: bool = False
        go = State()

        def __getattr__(self, name: str) -> int:
            return 1

    assert reads_of_guard(lambda self: self.on, Answering.table).open == "__getattr__"


def test_an_overridden_method_counts() -> None:
    class Base(Machine):
        on: bool = False
        go = State()
        stop = State()
        go.to(stop, when=lambda self: self.is_done())

        def is_done(self) -> bool:
            return self.on

    class Derived(Base):
        def is_done(self) -> bool:
            return random.random() > 0.5

    assert [guard_of(cls, "go").is_closed for cls in (Base, Derived)] == [True, False]


def guard_of(cls: type[Machine], state: str) -> GuardReads:
    """Return what is read by the only guard of a state."""
    found = {each.name: each for each in cls.table.states}[state]
    (transition,) = found.transitions
    assert transition.guard is not None
    return reads_of_guard(transition.guard, cls.table)


BUNDLE = {
    "Language": "python",
    "States": "A\nB\nC\nD\n",
    "Lamp_Includes.py": (
        "from llfsm.runtime import Sensor\nfrom llfsm.whiteboard import Slot\n"
        "from llfsm.whiteboard.messages.turtlesim import Pose\nLIMIT = 3\nchanging = [1]\n"
    ),
    "Lamp_Variables.py": (
        "pose = Sensor(Slot('p', Pose))\nx: int = 0\nitems: tuple[int, ...] = ()\n"
    ),
    "Lamp_Methods.py": "def is_near(least):\n    return pose is not None and pose.x < least\n",
    "State_A_Variables.py": "x: float = 1\n",
    "State_A_Methods.py": "def is_more():\n    return x > LIMIT\n",
    "State_A_Transition_0.expr": "is_more() and is_near(LIMIT) and after_ms(20)",
    "State_A_Transition_0.target": "B",
    "State_B_Transition_0.expr": "x > 1 and is_running('Other') and self.x > 1",
    "State_B_Transition_0.target": "C",
    "State_C_Transition_0.expr": "any(x > 1 for x in items)",
    "State_C_Transition_0.target": "D",
    "State_D_Transition_0.expr": "x > changing[0]",
    "State_D_Transition_0.target": "A",
}


def test_the_names_of_a_bundle_are_those_of_its_states_first(tmp_path: Path) -> None:
    folder = tmp_path / "Lamp.machine"
    folder.mkdir()
    for name, text in BUNDLE.items():
        (folder / name).write_text(text)
    cls = load_bundle(folder)
    assert guard_of(cls, "A") == GuardReads({"pose"}, {"A.x"}, limits_ns={2e7})
    assert guard_of(cls, "B") == GuardReads(variables={"x"}, machines={"Other"})
    assert guard_of(cls, "C").open == "x"  # it is the machine's, and the comprehension's
    assert guard_of(cls, "D").open == "changing"


BASES = (Machine, GoalCaller, ActionStandIn)  # the others have no ports


def shipped() -> Iterator[type[Machine]]:
    """Return the machines of the product, classes and bundles."""
    for found in pkgutil.iter_modules(llfsm.machines.__path__):
        module = importlib.import_module(f"llfsm.machines.{found.name}")
        for cls in vars(module).values():
            if isinstance(cls, type) and issubclass(cls, Machine) and cls not in BASES:
                yield cls
    yield from map(load_bundle, sorted(Path(llfsm.machines.__path__[0]).glob("*.machine")))


def test_the_guards_of_all_machines_that_are_shipped_are_closed() -> None:
    guards = [
        (transition.guard, cls.table)
        for cls in shipped()
        for state in cls.table.states
        for transition in state.transitions
        if transition.guard is not None
    ]
    assert len(guards) > 100
    assert {reads_of_guard(*each).open for each in guards} == {""}
