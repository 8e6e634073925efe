"""Arrangement files: what they say, what is wrong in them, and that they run as code would."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import (
    Actuator,
    Arrangement,
    LoadError,
    Machine,
    ManualClock,
    Requirement,
    State,
    Timetable,
    Trace,
    VariableError,
)
from llfsm.runtime.engine.errors import ConfigurationError, UnknownMachineError
from llfsm.runtime.plans import Plan, PlannedMachine, assemble, names_of, read_plan
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int64

OUT = Slot("out", Int64)


class Counter(Machine):
    out = Actuator(OUT)
    rounds: int = 2
    speed: float = 1.0
    path: tuple[int, ...] = ()
    left: int = 0

    COUNT = State()
    DONE = State()

    @COUNT.on_entry
    def _(self) -> None:
        self.left = self.rounds

    @COUNT.internal
    def _(self) -> None:
        self.left -= 1
        self.out(Int64(self.left))

    COUNT.to(DONE, when=lambda m: m.left <= 0)


class Other(Machine):
    A = State()
    B = State()
    A.to(B, after_ms=30)


class Loader(Machine):
    A = State()
    B = State()

    @A.on_exit
    def _(self) -> None:
        self.load("Other")

    A.to(B)


CLASSES: dict[str, type[Machine]] = {"Counter": Counter, "Other": Other, "Loader": Loader}


def plan(folder: Path, text: str) -> Plan:
    file = folder / "robot.toml"
    file.write_text(text)
    return read_plan(file)


def made(plan: Plan, **how: Any) -> Arrangement:
    classes = [CLASSES[planned.definition] for planned in plan.machines]
    named = dict(zip(names_of(plan, [cls.__name__ for cls in classes]), classes, strict=True))
    environment = LiveEnvironment(Whiteboard.local(), how.pop("clock", None))
    return assemble(plan, named, environment, library=how.pop("library", {}), **how)


def names(arrangement: Arrangement) -> list[str]:
    return [machine.name for machine in arrangement.machines]


def test_all_that_a_file_can_say(tmp_path: Path) -> None:
    reported = plan(
        tmp_path,
        """
        board = "robot"
        idle_us = 0
        wake = false
        unload_accepting = false
        on_error = "suspend"

        [[machine]]
        definition = "Counter"
        name = "left"
        variables = { rounds = 3, path = [1, 2] }
        slots.out = "left/out"
        period_us = 1000
        start_us = [0, 500]
        deadline_us = 400

        [[machine]]
        definition = "Counter"
        period_us = 2_000
        start_us = 250
        suspended = true

        [[machine]]
        definition = "Other"
        period_us = 2000
        preload = true
        """,
    )
    assert reported == Plan(
        board="robot",
        idle_us=0,
        wake=False,
        unload_accepting=False,
        on_error="suspend",
        machines=(
            PlannedMachine(
                definition="Counter",
                name="left",
                variables={"rounds": 3, "path": [1, 2]},
                slots={"out": "left/out"},
                period_us=1000,
                start_us=(0, 500),
                deadline_us=400,
            ),
            PlannedMachine(definition="Counter", period_us=2000, start_us=250, suspended=True),
            PlannedMachine(definition="Other", period_us=2000, preload=True),
        ),
    )
    timetable = reported.timetable(["left", "Counter", "Other"])
    assert timetable is not None
    expected = Timetable.meeting(
        [
            Requirement("left", 1000, 400, (0, 500)),
            Requirement("Counter", 2000, 2000, (250,)),
            Requirement("Other", 2000, 2000, (0,)),
        ]
    )
    assert (timetable.slots, timetable.cycle_us) == (expected.slots, expected.cycle_us)
    arrangement = made(reported)
    assert names(arrangement) == ["left", "Counter"]
    assert arrangement.is_suspended("Counter")
    assert arrangement.pace[:2] == (0, False)
    assert not arrangement.kernel.unload_accepting
    assert arrangement.kernel.on_error == "suspend"


def test_what_a_file_need_not_say(tmp_path: Path) -> None:
    reported = plan(tmp_path, '[[machine]]\ndefinition = "Other"')
    assert reported == Plan(machines=(PlannedMachine(definition="Other"),))
    assert reported.timetable(["Other"]) is None
    arrangement = made(reported)
    bare = Arrangement()
    assert arrangement.pace.idle_us == bare.pace.idle_us
    assert arrangement.kernel.unload_accepting is bare.kernel.unload_accepting
    assert arrangement.kernel.on_error == bare.kernel.on_error
    assert arrangement.kernel.pacer is None


def test_a_period_for_all(tmp_path: Path) -> None:
    reported = plan(tmp_path, 'period_us = 5\n[[machine]]\ndefinition = "Other"')
    assert made(reported).kernel.pacer is not None


MACHINE = '[[machine]]\ndefinition = "Other"\n'


@pytest.mark.parametrize(
    ("text", "line", "printed"),
    [
        ("", None, "no [[machine]]"),
        ("idle_us = 1\n", None, "no [[machine]]"),
        ("machine = []\n", None, "no [[machine]]"),
        ("[machine]\ndefinition = 'Other'", 1, "machine: Expected `array`"),
        ("\n[[machine]]\nname = 'a'", 2, "missing required field `definition`"),
        (MACHINE + "\n[[machines]]\n", 4, "there is no key 'machines' here"),
        (MACHINE + "color = 1", 3, "there is no key 'color' here"),
        ("dispatch = [[0, 0]]\n" + MACHINE, 1, "there is no key 'dispatch' here"),
        (MACHINE + "name = 1", 3, "machine[0].name: Expected `str | null`"),
        (MACHINE + "[machine.slots]\nout = 1", 3, "machine[0].slots: Expected `str`, got `int`"),
        (MACHINE + "variables = 1", 3, "machine[0].variables: Expected `object`"),
        (MACHINE + "suspended = 'yes'", 3, "machine[0].suspended: Expected `bool`"),
        ("idle_us = -1\n" + MACHINE, 1, "idle_us: Expected `int` >= 0"),
        ("period_us = 0\n" + MACHINE, 1, "period_us: Expected `int` >= 1"),
        ("on_error = 'go on'\n" + MACHINE, 1, "on_error: Invalid enum value 'go on'"),
        (MACHINE + "period_us = 0", 3, "machine[0].period_us: Expected `int` >= 1"),
        (MACHINE + "period_us = 9\ndeadline_us = 0", 4, "machine[0].deadline_us: Expected"),
        (MACHINE + "period_us = 9\nstart_us = -1", 4, "machine[0].start_us: Expected"),
        (MACHINE + "period_us = 9\nstart_us = [0, -1]", 4, "machine[0].start_us[1]: Expected"),
        ("period_us = 9\n" + MACHINE + "period_us = 9", 4, "machine[0].period_us: give"),
        (MACHINE + "period_us = 9\n" + MACHINE, 4, "machine[1]: needs a period_us"),
        (MACHINE + MACHINE + "period_us = 9\n", 1, "machine[0]: needs a period_us"),
        (MACHINE + "start_us = 1", 1, "need a period_us"),
        (MACHINE + "start_us = [0]", 1, "need a period_us"),
        (MACHINE + "deadline_us = 1", 1, "need a period_us"),
        (MACHINE + MACHINE + "suspended = true\npreload = true", 3, "suspended or preloaded"),
        (MACHINE + "period_us = 9\nstart_us = 9", 1, "9 us is not a start within its period of 9"),
        (MACHINE + "period_us = 9\nstart_us = []", 1, "machine[0]: "),
        (
            MACHINE + "period_us = 999983\n\n" + MACHINE + "period_us = 1000003",
            1,
            "machine: the periods have",
        ),
    ],
)
def test_a_mistake_is_reported_with_its_line(
    tmp_path: Path, text: str, line: int | None, printed: str
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        plan(tmp_path, text)
    error = caught.value
    assert (error.file, error.line) == (tmp_path / "robot.toml", line), str(error)
    assert printed in str(error)


@pytest.mark.parametrize(
    "wrong", ["rounds = 'many'", "rounds = 1.5", "speed = 'x'", "path = ['a']"]
)
def test_variables_are_checked_when_loaded(tmp_path: Path, wrong: str) -> None:
    reported = plan(tmp_path, f'[[machine]]\ndefinition = "Counter"\nvariables.{wrong}')
    with pytest.raises(VariableError, match=f"Counter: {wrong.split()[0]} = "):
        made(reported)


def test_variables_become_what_the_machine_declares(tmp_path: Path) -> None:
    reported = plan(
        tmp_path, '[[machine]]\ndefinition = "Counter"\nvariables = {speed = 2, path = [1]}'
    )
    (machine,) = made(reported).machines
    assert isinstance(machine, Counter)
    assert (machine.speed, type(machine.speed), machine.path) == (2.0, float, (1,))


def test_unknown_variables_and_slots_are_reported_when_loaded(tmp_path: Path) -> None:
    with pytest.raises(VariableError, match="no variable 'color'; it has: rounds, speed"):
        made(plan(tmp_path, '[[machine]]\ndefinition = "Counter"\nvariables.color = 1'))
    with pytest.raises(LoadError, match="uses no slot 'color'; it uses: out"):
        made(plan(tmp_path, '[[machine]]\ndefinition = "Counter"\nslots.color = "a"'))


def test_a_slot_has_another_name(tmp_path: Path) -> None:
    arrangement = made(plan(tmp_path, '[[machine]]\ndefinition = "Counter"\nslots.out = "mine"'))
    board = arrangement.whiteboard
    assert board is not None
    arrangement.run()
    slots = {info.name for info in board.slots()}
    assert slots & {"mine", "out"} == {"mine"}


def test_a_preloaded_machine_is_loaded_by_name_alone(tmp_path: Path) -> None:
    reported = plan(tmp_path, MACHINE + 'preload = true\n[[machine]]\ndefinition = "Loader"')
    arrangement = made(reported, library=CLASSES)
    assert names(arrangement) == ["Loader"]
    arrangement.round()
    assert names(arrangement) == ["Loader", "Other"]
    with pytest.raises(UnknownMachineError):
        made(reported, library={}).load("Other")


def test_with_a_timetable_a_preloaded_machine_has_its_turns(tmp_path: Path) -> None:
    reported = plan(
        tmp_path,
        MACHINE + 'preload = true\nperiod_us = 10\n[[machine]]\ndefinition = "Loader"\n'
        "period_us = 10\nstart_us = 5",
    )
    arrangement = made(reported, library=CLASSES)
    assert arrangement.kernel.timetable is not None
    assert arrangement.kernel.timetable.machines == ("Other", "Loader")
    with pytest.raises(LoadError, match="Counter has no slot in the timetable"):
        arrangement.load(Counter)
    assert arrangement.load("Other") == 1


@pytest.mark.parametrize("what", ["name = 'c'", "variables.rounds = 7", "slots.out = 'o'"])
def test_what_a_preloaded_machine_would_not_get_is_refused(tmp_path: Path, what: str) -> None:
    text = MACHINE + f'[[machine]]\ndefinition = "Counter"\n{what}\npreload = true\n'
    with pytest.raises(ConfigurationError, match="preload") as caught:
        plan(tmp_path, text)
    assert caught.value.line in (3, 5)


@given(
    st.lists(
        st.tuples(
            st.sampled_from([Counter, Other]),
            st.sampled_from([None, "a", "Other", "Counter.0", "Other.0", "a.0", "a.1"]),
        ),
        min_size=1,
        max_size=8,
    )
)
def test_names_are_those_that_loading_gives(
    machines: list[tuple[type[Machine], str | None]],
) -> None:
    planned = Plan(
        machines=tuple(PlannedMachine(definition=cls.__name__, name=name) for cls, name in machines)
    )
    arrangement = Arrangement(whiteboard=Whiteboard.local())
    for cls, name in machines:
        arrangement.load(cls, name=name)
    assert names_of(planned, [cls.__name__ for cls, _ in machines]) == names(arrangement)
    assert names(made(planned)) == names(arrangement)


def traced(arrangement: Arrangement, rounds: int) -> Trace:
    trace = Trace()
    arrangement.attach(trace)
    arrangement.run(max_rounds=rounds)
    return trace


def test_suspended_machines_come_last_as_in_an_arrangement_made_by_hand(
    tmp_path: Path,
) -> None:
    reported = plan(
        tmp_path,
        MACHINE + 'suspended = true\n[[machine]]\ndefinition = "Counter"\n'
        "variables.rounds = 4\nslots.out = 'o'\n" + MACHINE,
    )
    by_hand = Arrangement(whiteboard=Whiteboard.local(), clock=ManualClock())
    by_hand.load(Counter, variables={"rounds": 4}, slots={"out": "o"})
    by_hand.load(Other, name="Other.0")
    by_hand.load_suspended(Other, name="Other")
    planned = made(reported, clock=ManualClock())
    assert names(planned) == ["Counter", "Other.0", "Other"]
    trace = traced(planned, 50)
    assert trace == traced(by_hand, 50)
    assert len(trace.sections()) > 5


def test_a_timetable_from_a_file_gives_the_trace_of_one_made_by_hand(
    tmp_path: Path,
) -> None:
    reported = plan(
        tmp_path,
        MACHINE + "period_us = 3000\nsuspended = true\n"
        '[[machine]]\ndefinition = "Counter"\nperiod_us = 1000\nstart_us = [100, 700]\n'
        "variables.rounds = 9\n" + MACHINE + "name = 'late'\nperiod_us = 1500\nstart_us = 50\n",
    )
    needs = [
        Requirement("Other", 3000, 3000),
        Requirement("Counter", 1000, 1000, (100, 700)),
        Requirement("late", 1500, 1500, (50,)),
    ]
    by_hand = Arrangement(
        whiteboard=Whiteboard.local(), clock=ManualClock(), timetable=Timetable.meeting(needs)
    )
    by_hand.load_suspended(Other)
    by_hand.load(Counter, variables={"rounds": 9})
    by_hand.load(Other, name="late")
    trace = traced(made(reported, clock=ManualClock()), 12)
    assert trace == traced(by_hand, 12)
    assert {machine for _, machine, _, _ in trace.sections()} == {"Other", "Counter", "late"}
