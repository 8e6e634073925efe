"""Machines of other processes are explored as declared: with any answer to each question."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from calling import call
from llfsm.runtime import Machine, State, UnknownMachineError
from llfsm.runtime.counterexamples import holds, regression_of, replay, script_of, story_of
from llfsm.runtime.engine.machine import define
from llfsm.runtime.testing import InvariantError, play
from llfsm.runtime.verification import (
    DomainError,
    Property,
    UnsupportedError,
    explore,
    monitor,
    never,
)
from replaying_explorer import QUESTIONS, replayed
from thoroughness import examples

STATUSES = [("drive", False), ("turn", False), ("Suspended", True), None]


@pytest.fixture(scope="module", autouse=True)
def _quiet() -> Iterator[None]:
    """Log no failures: there are thousands, on purpose."""
    logging.disable()
    yield
    logging.disable(logging.NOTSET)


questions = st.sampled_from(["suspended", "running", "in drive", "in turn", "suspend", "restart"])
machines = st.lists(
    st.tuples(
        st.none() | questions,
        st.lists(st.tuples(questions, st.integers(0, 2)), min_size=1, max_size=2),
    ),
    min_size=1,
    max_size=3,
)
assert QUESTIONS >= 3  # as a turn has: one of OnEntry, two of guards


def ask(machine: Any, question: str) -> bool:
    """Ask, and return whether it is so; note if there is none."""
    try:
        if question == "suspended":
            return bool(machine.is_suspended("Driver"))
        if question == "running":
            return bool(machine.is_running("Driver"))
        if question.startswith("in "):
            return bool(machine.state_name_of("Driver") == question.removeprefix("in "))
        return bool(getattr(machine, question)("Driver"))
    except UnknownMachineError:
        machine.missed = True
        return False


def asking(specs: Any) -> type[Machine]:
    states = [State(f"S{number}") for number in range(3)]
    for state, (question, ways) in zip(states, specs, strict=False):
        if question is not None:
            state.on_entry(counting(question))
        for each, to in ways:
            state.to(states[to], when=guarding(each))
    variables = {"yes": (int, 0), "missed": (bool, False)}
    return define("Asking", states, variables=variables)


def counting(question: str) -> Callable[[Any], None]:
    def count(machine: Any) -> None:
        machine.yes = (machine.yes + ask(machine, question)) % 3

    return count


def guarding(question: str) -> Callable[[Any], bool]:
    return lambda machine: ask(machine, question)


@settings(max_examples=examples(30), deadline=None)
@given(specs=machines, statuses=st.sets(st.sampled_from(STATUSES), min_size=1, max_size=3))
@pytest.mark.filterwarnings("ignore::llfsm.runtime.UnreachableStateWarning")
def test_random_questions_lead_to_as_many_states_as_replayed_runs(
    specs: Any, statuses: Any
) -> None:
    machine = asking(specs)
    names = [None if each is None else each[0] for each in statuses]
    explored = explore(machine, period_ms=10, elsewhere={"Driver": names}, on_error="suspend")
    event(f"{explored.states} states")
    found = replayed([machine], period_ms=10, statuses=statuses)
    assert found is not None
    assert explored.states == found.states


class Boss(Machine):
    """Waits until the driver is suspended, and starts it again."""

    wait, ask, over = State(), State(), State()
    wait.to(ask, when=lambda self: self.is_suspended("Driver"))
    ask.to(over, when=lambda self: self.state_name_of("Driver") == "drive")

    @ask.on_entry
    def _(self) -> None:
        self.restart("Driver")


class Driver(Machine):
    """Drives, and parks."""

    drive, park = State(), State()
    drive.to(park)


OVER = never(lambda v: v.Boss.state == "over", "over")
HOW: dict[str, Any] = {"period_ms": 10, "elsewhere": {"Driver": Driver}}


def test_a_class_stands_for_its_states() -> None:
    space = explore(Boss, **HOW, properties=[OVER])
    assert space.verdicts[0].holds is False
    parked = explore(
        Boss, period_ms=10, elsewhere={"Driver": ["park", "Suspended"]}, properties=[OVER]
    )
    assert parked.verdicts[0].holds
    never_there = explore(Boss, period_ms=10, elsewhere={"Driver": [None]}, on_error="suspend")
    assert "Boss.ask" in never_there.unreached


def test_a_counterexample_shows_the_answers_and_becomes_a_test() -> None:
    space = explore(Boss, **HOW, properties=[OVER])
    witness = space.verdicts[0].witness
    assert witness is not None
    assert replay(space, witness)[-1].Boss.state == "over"
    story = "\n".join(story_of(space, witness))
    assert "Driver is suspended" in story
    assert "Driver is in drive" in story
    assert "Driver is in Suspended, suspended" in next(witness.lines())
    text = regression_of(space, witness, f"{__name__}:OVER", folder=None)
    assert "elsewhere={'Boss': {'Driver': (('Suspended', True)," in text
    with pytest.raises(InvariantError, match="over"):
        play([Boss], script_of(witness, space), invariant=holds(OVER))


def loops(machine: Any) -> None:
    while machine.is_running("Driver"):
        pass


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (loops, "asks for Driver more than 8 times in a turn"),
        (lambda machine: machine.resume("Driver") == 1, "uses the status that resume"),
        (lambda machine: machine.is_running("Other"), r"declare it \(elsewhere\)"),
    ],
)
def test_what_cannot_be_explored_is_refused(code: Any, text: str) -> None:
    state = State("S")
    state.on_entry(code)
    with pytest.raises(UnsupportedError, match=text):
        explore(define("M", [state]), **HOW)


def test_a_monitor_asks_no_other_process() -> None:
    first, bad = State("FIRST"), State("BAD")
    first.to(bad, when=lambda machine: machine.is_suspended("Driver"))
    watching: Property = monitor(define("Watch", [first, bad]), bad)
    with pytest.raises(UnsupportedError, match="a monitor knows no machines of other processes"):
        explore(Boss, **HOW, properties=[watching])


@pytest.mark.parametrize("wrong", [[], "drive", [3], object])
def test_a_wrong_declaration_is_an_error(wrong: Any) -> None:
    with pytest.raises(DomainError, match=r"elsewhere: Driver is declared as .*: give its class"):
        explore(Boss, period_ms=10, elsewhere={"Driver": wrong})


def test_a_machine_is_either_explored_or_elsewhere() -> None:
    with pytest.raises(DomainError, match="elsewhere has 'Driver', which is one of the machines"):
        explore([Boss, Driver], **HOW)


def test_the_command_line_and_files_declare_them(tmp_path: Path) -> None:
    (tmp_path / "boss.py").write_text(
        "from llfsm.runtime import Machine, State\n"
        "from llfsm.runtime.verification import never\n"
        "class Boss(Machine):\n"
        "    wait, over = State(), State()\n"
        "    wait.to(over, when=lambda self: self.is_suspended('Driver'))\n"
        "class Driver(Machine):\n    drive = State()\n"
        "over = never(lambda v: v.Boss.state == 'over')\n"
    )
    (tmp_path / "boss.toml").write_text(
        "[[machine]]\ndefinition = 'boss:Boss'\n[verify]\nproperties = ['boss:over']\n"
        "elsewhere = { Driver = ['drive'] }\n"
    )
    done = call("verify", "boss.toml", cwd=tmp_path)
    assert done.returncode == 0
    for declared in ("drive,Suspended", "boss:Driver"):
        done = call("verify", "boss.toml", "--elsewhere", f"Driver={declared}", cwd=tmp_path)
        assert done.returncode == 1
        assert "Driver is suspended" in done.stdout
    done = call("verify", "boss.toml", "--elsewhere", "Driver=none", cwd=tmp_path)
    assert "there is no Driver" in done.stdout
