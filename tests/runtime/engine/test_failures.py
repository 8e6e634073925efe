"""What fails in a machine is reported with machine, state, step and line."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from llfsm.errors import one_line
from llfsm.runtime import (
    Arrangement,
    ExecutionError,
    GuardResultError,
    LoadError,
    Machine,
    ManualClock,
    NotLoadedError,
    Reason,
    Sensor,
    State,
    Trace,
    UnknownMachineError,
    define,
)
from llfsm.runtime.engine.events import Failed
from llfsm.whiteboard import Message, Slot, Whiteboard


class Boom(Exception):  # noqa: N818
    pass


def boom(machine: Machine) -> None:
    raise Boom("bang")  # the line that is reported


LINE = boom.__code__.co_firstlineno + 1


class Other(Machine):
    a = State()
    a.to(a, when=lambda m: False)


def failing(step: str) -> type[Machine]:
    """Return a machine that fails in `step` in round 2, or in round 1 if it cannot be later."""
    s0, s1, susp = State("S0"), State("S1"), State("SUSP", suspend=True)
    if step == "OnSuspend":
        s0.on_suspend(boom)
    elif step == "OnResume":
        s0.on_resume(boom)
    elif step == "OnResume of SUSP":
        susp.on_resume(boom)
    else:
        {"OnEntry": s1.on_entry, "OnExit": s0.on_exit, "Internal": s0.internal}[step](boom)
    s0.to(s1, when=lambda m: step in ("OnEntry", "OnExit"))
    s1.to(s0, when=lambda m: False)
    return define("M", [s0, s1, susp])


@pytest.mark.parametrize("observed", [False, True])
@pytest.mark.parametrize(
    ("step", "state"),
    [
        ("OnEntry", "S1"),
        ("OnExit", "S0"),
        ("Internal", "S0"),
        ("OnSuspend", "S0"),
        ("OnResume", "S0"),
        ("OnResume of SUSP", "SUSP"),
    ],
)
def test_a_section_that_raises(step: str, state: str, observed: bool):
    arrangement = Arrangement(observers=[lambda event: None] if observed else [])
    if "Suspend" in step or "Resume" in step:
        arrangement.load_suspended(failing(step))
        arrangement.resume("M") if "Resume" in step else None
    else:
        arrangement.load(failing(step))

    def run() -> None:
        for _ in range(3):
            arrangement.round()

    with pytest.raises(ExecutionError) as caught:
        run()
    error = caught.value
    assert (error.machine, error.state, error.step) == ("M", state, step.partition(" ")[0])
    assert (error.filename, error.line) == (__file__, LINE)
    assert str(error) == (f"machine M, state {state}, {error.step}: Boom: bang ({__file__}:{LINE})")
    assert isinstance(error.__cause__, Boom)


@pytest.mark.parametrize("observed", [False, True])
@pytest.mark.parametrize("timed", [False, True])
def test_a_guard_that_raises(observed: bool, timed: bool):
    class M(Machine):
        a = State()
        b = State()

        @a.to(b)
        def fine(self) -> bool:
            return False

        @a.to(b, after_ms=0 if timed else None)
        def wrong(self) -> bool:
            return self.name / 2  # type: ignore[operator, no-any-return]

    clock = ManualClock()
    arrangement = Arrangement([M], clock=clock, observers=[Trace()] if observed else [])

    def run() -> None:
        for _ in range(2):
            arrangement.round()
            clock.advance(ms=1)

    with pytest.raises(ExecutionError) as caught:
        run()
    label = "after_ms(0) and wrong" if timed else "wrong"
    assert caught.value.step == f"transition {label}"
    assert caught.value.line == M.wrong.__code__.co_firstlineno + 2
    assert isinstance(caught.value.__cause__, TypeError)


@pytest.mark.parametrize("observed", [False, True])
@pytest.mark.parametrize("value", [None, 1, 0, "", "yes", [], 1.0])
def test_a_guard_that_returns_no_bool(value: Any, observed: bool):
    class M(Machine):
        a = State()

        @a.to(a)
        def maybe(self) -> bool:
            return value  # type: ignore[no-any-return]

    arrangement = Arrangement([M], observers=[Trace()] if observed else [])
    with pytest.raises(GuardResultError, match="transition maybe: the guard returned") as caught:
        arrangement.round()
    assert (caught.value.machine, caught.value.state) == ("M", "a")
    assert (caught.value.filename, caught.value.line) == (
        __file__,
        M.maybe.__code__.co_firstlineno,
    )
    assert type(value).__name__ in str(caught.value)


class Undescribed(Exception):  # noqa: N818
    def __str__(self) -> str:
        raise OSError

    __repr__ = __str__


def test_what_cannot_be_described_is_contained_too(caplog: pytest.LogCaptureFixture):
    def section(machine: Machine) -> None:
        raise Undescribed

    s0, t0 = State("S0"), State("T0")
    s0.on_entry(section)
    s0.to(s0, when=lambda m: False)
    t0.to(t0, when=Undescribed)
    raises, returns = define("Raises", [s0]), define("Returns", [t0])
    arrangement = Arrangement([raises, returns], on_error="suspend")
    arrangement.round()
    assert "OnEntry: Undescribed: (OSError while it was described)" in caplog.text
    assert "the guard returned (OSError while it was described), a Undescribed" in caplog.text
    assert arrangement.roster.failed == ["Raises", "Returns"]


def test_a_failure_in_one_line_can_be_published_whatever_is_in_it():
    assert one_line(ValueError("\udcff\x00\n bad")).encode() == b"\\udcff\\x00 bad"


def test_a_function_in_two_places_of_one_state_gives_both():
    a = State("a")
    a.on_entry(boom)
    a.internal(boom)
    with pytest.raises(ExecutionError, match="state a, OnEntry or Internal: Boom"):
        Arrangement([define("M", [a])]).round()


def test_a_snapshot_that_cannot_be_read():
    class Number(Message):
        value: int = 0

    class M(Machine):
        number = Sensor(Slot("number", Number))
        a = State()

    board = Whiteboard.local()
    arrangement = Arrangement([M], whiteboard=board)
    board.close()
    with pytest.raises(ExecutionError, match="machine M, state a, the snapshot: ") as caught:
        arrangement.round()
    assert caught.value.filename != __file__


def test_an_error_in_an_abandoned_ringlet_names_the_abandoned_machine():
    class A(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            self.abandon("M")

    arrangement = Arrangement([A, failing("OnSuspend")])
    with pytest.raises(ExecutionError, match="machine M, state S0, OnSuspend: Boom"):
        arrangement.round()


def test_abandoning_without_end_is_an_error_too():
    class M(Machine):
        a = State(suspend=True)

        @a.internal
        def _(self) -> None:
            self.abandon(self.name)

    with pytest.raises(ExecutionError, match="Internal: RecursionError"):
        Arrangement([M]).round()


def test_an_unknown_name_in_a_section_names_those_that_exist():
    class M(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            self.suspend("Nobody")

    with pytest.raises(ExecutionError, match="no machine 'Nobody'; loaded: Other, M") as caught:
        Arrangement([Other, M]).round()
    assert isinstance(caught.value.__cause__, UnknownMachineError)


# Policies


def test_by_default_all_stops():
    arrangement = Arrangement([failing("Internal"), Other], clock=ManualClock())
    with pytest.raises(ExecutionError):
        arrangement.run()
    assert arrangement.reason is Reason.FAILED


def test_only_the_machine_is_suspended_if_so_asked(caplog: pytest.LogCaptureFixture):
    trace = Trace()
    arrangement = Arrangement(
        [failing("Internal"), Other], on_error="suspend", observers=[trace], clock=ManualClock()
    )
    with caplog.at_level(logging.ERROR, "llfsm.runtime"):
        arrangement.run(max_rounds=4)
    (failed,) = [event for event in trace if isinstance(event, Failed)]
    assert (failed.round, failed.index, failed.machine) == (1, 0, "M")
    assert isinstance(failed.error, ExecutionError)
    assert "machine M, state S0, Internal: Boom: bang" in caplog.text
    assert [s for s in trace.sections() if s[1] == "M" and s[0] < 4] == [
        (1, "M", "OnEntry", "S0"),
        (1, "M", "Internal", "S0"),
        (2, "M", "OnSuspend", "S0"),
        (2, "M", "OnEntry", "SUSP"),
        (2, "M", "Internal", "SUSP"),
        (3, "M", "Internal", "SUSP"),
    ]


def test_it_can_be_resumed_and_fails_again():
    trace = Trace()
    arrangement = Arrangement([failing("Internal"), Other], on_error="suspend", observers=[trace])
    arrangement.round()
    arrangement.round()
    arrangement.resume("M")
    arrangement.round()
    assert len([event for event in trace if isinstance(event, Failed)]) == 2
    assert arrangement.is_suspended("M")


def test_a_failure_clears_a_pending_request():
    class M(Machine):
        a = State()

        @a.on_entry
        def _(self) -> None:
            self.restart_self()
            raise Boom

    trace = Trace()
    arrangement = Arrangement([M, Other], on_error="suspend", observers=[trace])
    arrangement.round()
    arrangement.round()
    assert [event.round for event in trace if isinstance(event, Failed)] == [1]


def test_a_run_in_which_nobody_can_resume_the_failed_machine_ends_as_failed():
    boards = [None, Whiteboard.local()]
    for board in boards:
        arrangement = Arrangement([failing("Internal")], on_error="suspend", whiteboard=board)
        assert arrangement.run(max_rounds=50) is Reason.FAILED
        assert arrangement.roster.failed == ["M"]
        assert arrangement.rounds < 50


def test_a_run_whose_failed_machine_was_resumed_ends_as_any_other():
    class M(Machine):
        fails: bool = True

        a = State()
        b = State()
        a.to(b)

        @a.on_entry
        def _(self) -> None:
            if self.fails:
                raise Boom

    class Mends(Machine):
        a = State()
        b = State()
        a.to(b, when=lambda m: m.is_suspended("M"))

        @a.on_exit
        def _(self) -> None:
            machine.fails = False
            self.restart("M")

    machine = M()
    arrangement = Arrangement([machine, Mends], on_error="suspend", clock=ManualClock())
    assert arrangement.run(max_rounds=50) is Reason.ACCEPTING
    assert arrangement.roster.failed == []


def test_a_machine_that_fails_while_suspended_is_unloaded():
    arrangement = Arrangement([Other], on_error="suspend")
    arrangement.load_suspended(failing("OnSuspend"))
    arrangement.round()
    assert [machine.name for machine in arrangement.machines] == ["Other"]


def test_a_machine_that_fails_when_abandoned_is_unloaded_and_its_caller_goes_on():
    class A(Machine):
        went_on: bool = False

        a = State()

        @a.on_entry
        def _(self) -> None:
            self.abandon("M")
            self.went_on = True

    caller = A()
    arrangement = Arrangement([caller, failing("OnSuspend"), Other], on_error="suspend")
    arrangement.round()
    assert caller.went_on
    assert [machine.name for machine in arrangement.machines] == ["Other"]


# Machines that are nowhere


@pytest.mark.parametrize(
    "ask",
    [
        lambda m: m.suspend("x"),
        lambda m: m.suspend_all(),
        lambda m: m.after_ms(1),
        lambda m: m.after(1),
        lambda m: m.timeout(1),
        lambda m: m.stopping,
        lambda m: m.state_name,
        lambda m: m.number_of_machines,
        lambda m: m.load("x"),
        lambda m: m.unload("x"),
        lambda m: m.abandon("x"),
        lambda m: m.restart_self(),
    ],
)
def test_a_machine_must_be_loaded(ask: Any):
    with pytest.raises(NotLoadedError, match="Other is in no arrangement: load it first"):
        ask(Other())


def test_an_init_that_leaves_out_super():
    class M(Machine):
        a = State()

        def __init__(self) -> None:
            self.x = 1

    with pytest.raises(LoadError, match=r"M.__init__ must call super\(\).__init__\(\)"):
        Arrangement([M])
