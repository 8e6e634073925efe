"""What cannot be explored, and what a property cannot ask: each is refused by name."""

from __future__ import annotations

import datetime
import logging
import random
import time
import uuid
from collections.abc import Callable
from contextvars import ContextVar
from enum import Enum
from typing import Annotated, Any, Literal

import msgspec
import pytest

from llfsm.runtime import Actuator, Machine, OptionError, Sensor, State, define
from llfsm.runtime.verification import (
    DomainError,
    PredicateError,
    Property,
    PropertyError,
    UnsupportedError,
    VerificationError,
    always,
    every,
    explore,
    leads_to,
    never,
    step,
    verify,
)
from llfsm.whiteboard import Message, Slot


class Colour(Enum):
    RED = 1
    GREEN = 2


class Light(Message):
    colour: Colour | None = None
    lanes: tuple[bool, Literal["a", "b"]] = (False, "a")
    level: Annotated[int, msgspec.Meta(gt=0, lt=3)] = 1


class Number(Message):
    value: int = 0


LIGHT, NUMBER = Slot("junction/light", Light), Slot("junction/number", Number)


class Reader(Machine):
    light = Sensor(LIGHT, default=Light())
    count: int = 0

    GO = State()
    WAIT = State()
    GO.to(WAIT, when=lambda self: self.light.colour == Colour.RED)
    WAIT.to(GO, after_ms=100)


def test_every_value_of_a_type() -> None:
    assert len(every(Light)) == 3 * 4 * 2
    assert len(set(every(Light))) == 3 * 4 * 2
    assert every(bool | None) in ((False, True, None), (None, False, True))
    assert every(Colour) == (Colour.RED, Colour.GREEN)
    assert every(Annotated[int, msgspec.Meta(ge=-5, le=5, multiple_of=5)]) == (-5, 0, 5)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Number, "Number.value.*both bounds"),
        (str, "str has too many"),
        (Annotated[int, msgspec.Meta(ge=0, le=10**7)], "10000001 values"),
        ("no type at all", "no type"),
    ],
)
def test_a_type_without_end_is_no_domain(kind: object, message: str) -> None:
    with pytest.raises(DomainError, match=message):
        every(kind)


class Poster(Machine):
    number = Actuator(NUMBER)
    light = Sensor(LIGHT, domain=[Light()])
    A = State()


@pytest.mark.parametrize(
    ("machines", "sensors", "message"),
    [
        ([Reader], {}, r"Reader.light \(junction/light\)"),
        ([Reader], {LIGHT: []}, "empty"),
        ([Reader], {LIGHT: Light}, "must list Light"),
        ([Reader], {LIGHT: [Number()]}, "of type Number, not Light"),
        ([Reader], {LIGHT: every(Light), NUMBER: [Number()]}, "no machine reads"),
        ([Reader], {"junction/lihgt": every(Light)}, "did you mean 'junction/light'"),
        ([Poster], {NUMBER: [Number()]}, "no machine reads"),
    ],
)
def test_a_wrong_domain(machines: list[type[Machine]], sensors: Any, message: str) -> None:
    with pytest.raises(DomainError, match=message):
        explore(machines, period_ms=100, sensors=sensors)


def test_machines_and_their_environment_do_not_both_write_a_slot() -> None:
    reader = define(
        "R", [State("A")], attributes={"number": Sensor(NUMBER), "post": Actuator(NUMBER)}
    )
    with pytest.raises(DomainError, match="either the machines"):
        explore(reader, period_ms=100, sensors={NUMBER: [Number(1)]})


def machine(code: Callable[[Any], None], **attributes: Any) -> type[Machine]:
    """Return a machine that runs `code` in each turn."""
    start = State("START")
    start.internal(code)
    start.to(start, when=lambda self: False)
    return define("M", [start], attributes=attributes, variables={"n": (Any, 0)})


def assign(name: str, value: Callable[[Any], Any]) -> Callable[[Any], None]:
    return lambda self: setattr(self, name, value(self))


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (lambda self: self.load("Other"), "M loads 'Other', which is the name of none"),
        (lambda self: self.call_machine(Reader), "calls .*submachine"),
        (lambda self: self.suspend("Far"), "'Far', which is not among those explored"),
        (lambda self: self.is_running("Far"), "'Far'"),
        (lambda self: self.age_ms("light"), "how old"),
        (assign("n", lambda self: self.post(Number()) + 1), "count"),
        (assign("n", lambda self: self._seat.now() + 1), "uses the time"),
        (assign("n", lambda self: self._seat.now() - self._seat.entered_ns == 3), "compares"),
        (assign("n", lambda self: open), "M.n is a builtin_function"),
        (assign("n", lambda self: self.post(Number())), "M.n is"),
    ],
)
def test_what_cannot_be_explored_is_refused_by_name(
    code: Callable[[Any], None], message: str
) -> None:
    made = machine(code, light=Sensor(LIGHT, domain=[None]), post=Actuator(NUMBER))
    with pytest.raises(UnsupportedError, match=message):
        explore(made, period_ms=100)


def test_a_refusal_holds_even_if_the_code_catches_it() -> None:
    def code(self: Any) -> None:
        try:
            self.call_machine(Reader)
        except Exception:  # as careless code does
            self.n = 1

    with pytest.raises(UnsupportedError, match=r"calls .*submachine"):
        explore(machine(code), period_ms=100)


def test_the_time_before_a_state_is_entered_is_refused() -> None:
    start, rest = State("START"), State("REST", suspend=True)
    start.on_suspend(lambda self: self.after_ms(5))
    start.to(rest)
    with pytest.raises(UnsupportedError, match="OnSuspend"):
        explore([define("M", [start, rest]), Reader], period_ms=100, sensors={LIGHT: [None]})


calls = ContextVar("calls", default=0)


def called() -> int:
    """Return how often it was called before."""
    calls.set(calls.get() + 1)
    return calls.get() - 1


def test_code_that_reads_more_than_it_should_is_found() -> None:
    made = machine(assign("n", lambda self: called() % 3))
    with pytest.raises(VerificationError, match="M, state START, Internal, did not"):
        explore(made, period_ms=100, max_states=50)


@pytest.mark.parametrize(
    ("value", "called"),
    [
        (lambda self: random.randrange(1000), "Random.getrandbits"),
        (lambda self: uuid.uuid4().int < 0, "urandom"),
        (lambda self: time.time() > 4e9, "time"),
        (lambda self: datetime.datetime.now().year > 9998, "datetime.now"),
    ],
)
def test_clocks_and_random_numbers_are_found_though_they_always_say_the_same(
    value: Callable[[Any], Any], called: str
) -> None:
    made = machine(assign("n", value), post=Actuator(NUMBER))
    with pytest.raises(
        VerificationError, match=rf"M, state START, Internal, calls {called} \(.*:\d+"
    ):
        explore(made, period_ms=100, max_states=50)


def test_code_may_log_and_post() -> None:
    def code(self: Any) -> None:
        logging.getLogger("tests.verification").info("posting")
        self.post(Number())

    assert explore(machine(code, post=Actuator(NUMBER)), period_ms=100).complete


def test_code_may_not_depend_on_which_of_equal_messages_it_has() -> None:
    """A message that is posted again is another object, but not another state."""

    def code(self: Any) -> None:
        self.n, self.last = self.light is getattr(self, "last", None), self.light

    with pytest.raises(VerificationError, match="compare messages with `is`"):
        explore(machine(code, light=Sensor(LIGHT, domain=[Light()])), period_ms=100)


def test_a_variable_without_end_is_named_and_can_be_bounded() -> None:
    made = machine(assign("n", lambda self: self.n + 1))
    space = explore(made, period_ms=100, max_states=500)
    [hint] = space.hints()
    assert hint.startswith("M.n has had 500 values: bound it")
    assert hint.endswith("; 128 in the first 128 states")
    space = explore(made, period_ms=100, abstract={"M.n": lambda n: min(n, 3)})
    assert space.values == {"M.n": 4}
    for name in ("M.m", "N.n", "n"):
        with pytest.raises(UnsupportedError, match="abstract"):
            explore(made, period_ms=100, abstract={name: abs})
    with pytest.raises(UnsupportedError, match=r"of M.n raised ZeroDivisionError for 0"):
        explore(made, period_ms=100, abstract={"M.n": lambda n: 1 / n})


@pytest.mark.parametrize("number", [-1, float("nan"), float("inf"), "10"])
def test_times_are_numbers_that_can_pass(number: Any) -> None:
    with pytest.raises(OptionError, match="period_ms is"):
        explore(Poster, period_ms=number)
    with pytest.raises(PredicateError, match="within_ms is"):
        leads_to(lambda v: True, lambda v: True, within_ms=number)


def test_code_that_seldom_does_something_else_is_named() -> None:
    """Of two ringlets each is run again hundreds of times."""
    start = State("START")
    start.to(start, when=lambda self: called() % 50 == 49)
    with pytest.raises(VerificationError, match="M, state START"):
        explore(define("M", [start]), period_ms=100)


def test_values_differ_by_type_and_by_their_bits() -> None:
    values = [True, 1, 1.0, 0.0, -0.0, float("nan"), float("nan"), "1", b"1", [1], [1.0], (1,)]

    def code(self: Any) -> None:
        self.i = min(getattr(self, "i", -1) + 1, len(values) - 1)
        self.n = values[self.i]

    assert explore(machine(code), period_ms=100).values["M.n"] == len(values)


def test_mutable_variables_are_states_of_their_own() -> None:
    def code(self: Any) -> None:
        if self.n == 0:
            self.n = []
        self.n.append(1)
        del self.n[3:]

    assert explore(machine(code), period_ms=100).values["M.n"] == 4


def test_variables_that_share_a_mutable_value_are_refused() -> None:
    def code(self: Any) -> None:
        self.n = self.m = [1]

    with pytest.raises(UnsupportedError, match="share"):
        explore(machine(code), period_ms=100)


def test_code_that_raises_violates_what_is_always_checked() -> None:
    made = machine(assign("n", lambda self: [1, 2][self.n]))
    with pytest.raises(PropertyError, match="no machine's code raises: violated") as caught:
        verify(made, period_ms=100)
    (verdict,) = caught.value.verdicts
    assert verdict.witness is not None
    assert len(verdict.witness.turns) == 3


@pytest.mark.parametrize(
    ("prop", "message"),
    [
        (never(lambda v: v.Raeder.count > 3), "'Raeder'; did you mean 'Reader'"),
        (never(lambda v: v.Reader.cuont > 3), "'cuont'; did you mean 'count'"),
        (never(lambda v: v.Reader.state == "GOO"), "'GOO'; did you mean 'GO'"),
        (never(lambda v: v.Reader.state == Poster.A), "no state 'A'"),
        (never(lambda v: v[NUMBER].value == 1), "slot 'junction/number'"),
        (never(lambda v: v.Reader.count), "returned 0; it must return True or False"),
        (always(lambda v: v.Reader.count / 0), "ZeroDivisionError.*test_refusals.py:"),
        (never(lambda v: v.Reader.light.color), "AttributeError"),
        (step(lambda before: True), "TypeError"),
    ],
)
def test_a_property_that_asks_for_what_there_is_not(prop: Property, message: str) -> None:
    with pytest.raises(PredicateError, match=message) as caught:
        explore(Reader, period_ms=100, sensors={LIGHT: every(Light)}, properties=[prop])
    assert str(prop) in str(caught.value)


def test_what_is_no_property_is_refused() -> None:
    for wrong in (lambda v: True, "never", Reader):
        with pytest.raises(PredicateError, match="not a property"):
            explore(Reader, period_ms=100, properties=[wrong])  # type: ignore[list-item]
    with pytest.raises(PredicateError, match="needs a function"):
        never("door open")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "how", [{"period_ms": 0}, {"period_ms": 1, "choices": "sometimes"}], ids=["period", "choices"]
)
def test_wrong_options(how: Any) -> None:
    with pytest.raises(ValueError, match=r"period_ms|choices"):
        explore(Reader, **how)


def test_suspend_names_machines() -> None:
    with pytest.raises(DomainError, match="did you mean 'Reader'"):
        explore(Reader, period_ms=1, suspend=["reader"], sensors={LIGHT: [None]})


def test_only_machines_are_explored() -> None:
    for wrong in (Reader(), 3, []):
        with pytest.raises((UnsupportedError, TypeError)):
            explore(wrong, period_ms=100)  # type: ignore[arg-type]
