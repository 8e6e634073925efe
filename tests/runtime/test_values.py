"""Equal keys stand for values that behave alike: what has more to it than its key is refused."""

from __future__ import annotations

import enum
from collections import OrderedDict, defaultdict, deque
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, make_dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import msgspec
import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st

from llfsm.runtime import Machine, State
from llfsm.runtime._values import UnknownValueError, freeze, own_copy
from llfsm.runtime.verification import UnsupportedError, explore, never
from thoroughness import examples

T = TypeVar("T")


class Plain:
    """A base without anything of its own."""


class Slotted:
    __slots__ = ("hidden",)


class Struct(msgspec.Struct):
    hidden: Any = 0


class Loose(msgspec.Struct, dict=True):
    hidden: Any = 0


class Named(NamedTuple):
    first: int = 0


def _filled(base: type) -> Any:
    """Return something to make a `base` of that has content; None to make it of nothing."""
    return {int: 3, float: 1.5, str: "a", bytes: b"a", dict: {"a": 1}}.get(base, [1])


BASES = [
    *(Plain, Slotted, Struct, Loose, Named, int, float, str, bytes, complex, list, dict, set),
    *(tuple, frozenset, deque, bytearray, OrderedDict, defaultdict, Exception),
]
_DECLARED: list[dict[str, Any]] = [
    {},
    {"__slots__": ()},
    {"__slots__": ("slot",)},
    {"__slots__": ("slot", "__dict__")},
    {"__iter__": lambda self: iter(())},
    {"__eq__": lambda self, other: True, "__hash__": lambda self: 0},
    {"__getattribute__": lambda self, name: object.__getattribute__(self, name)},
]
changes: list[Callable[[Any], object]] = [
    lambda value: setattr(value, "hidden", 7),
    lambda value: setattr(value, "slot", 7),
    lambda value: setattr(value, "shown", 7),
    lambda value: setattr(value, "other", 7),
    lambda value: value.append(7),
    lambda value: value.add(7),
    lambda value: value.update({"k": 7}),
    lambda value: value.__init__(5),
    lambda value: delattr(value, "shown"),
]


def _behaviour(value: Any) -> list[Any]:
    """Return what code can see of a value."""
    seen: list[Any] = [type(value)]
    asks: list[Callable[[Any], Any]] = [
        *(lambda v, name=name: getattr(v, name) for name in ("hidden", "slot", "shown", "other")),
        *(lambda v, kind=kind: kind(v) for kind in (list, int, float, bytes, str, len, vars, dict)),
        lambda v: list(type(v).__mro__[-2].__iter__(v)),  # as an overridden __iter__ may hide it
    ]
    for ask in asks:
        try:
            seen.append(repr(ask(value)))
        except Exception as error:  # which classes like these raise for anything
            seen.append(type(error).__name__)
    return [text for text in seen if " at 0x" not in str(text)]


def _made(base: type, declared: dict[str, Any], *, data: bool, filled: bool) -> Any:
    try:
        if data:
            kind: Any = make_dataclass(
                "Made", [("shown", int, 0)], bases=(base,), namespace=dict(declared), eq=False
            )
        else:
            kind = type(base)("Made", (base,), dict(declared))
        return kind(_filled(base)) if filled else kind()
    except (TypeError, ValueError, AttributeError):  # there can be no such class
        reject()


@settings(max_examples=examples(150), suppress_health_check=list(HealthCheck), deadline=None)
@given(
    st.sampled_from(BASES),
    st.sampled_from(_DECLARED),
    st.booleans(),
    st.booleans(),
    st.lists(st.sampled_from(changes), max_size=2),
    st.lists(st.sampled_from(changes), max_size=2),
)
def test_values_that_behave_differently_have_different_keys_or_none(
    base: type, declared: Any, data: bool, filled: bool, first: Any, second: Any
) -> None:
    one = _made(base, declared, data=data, filled=filled)
    try:
        other = deepcopy(one)
    except TypeError:  # as it needs an argument
        reject()
    for value, changed in ((one, first), (other, second)):
        for change in changed:
            try:
                change(value)
            except (TypeError, AttributeError, ValueError):
                continue
    try:
        keys = [freeze(one), freeze(other)]
    except UnknownValueError:
        return
    assert keys[0] != keys[1] or _behaviour(one) == _behaviour(other)


@dataclass
class Listed(list):  # type: ignore[type-arg]
    limit: int = 5


@dataclass
class Counted(Slotted):
    shown: int = 0


@dataclass(slots=True)
class Slim:
    shown: int = 0


@dataclass
class Wider(Slim):
    more: int = 0


@dataclass
class Described:
    shown: int

    @property  # type: ignore[no-redef]
    def shown(self) -> int:
        return 1

    @shown.setter
    def shown(self, value: int) -> None: ...


@dataclass
class Shared:
    items: list[int]

    def __deepcopy__(self, memo: Any) -> Shared:
        return self


class Growing(msgspec.Struct):
    """A copy of it is another one."""

    n: int = 0
    items: list[int] = []

    def __post_init__(self) -> None:
        self.n += 1


class Text(str):
    pass


class Odd(tuple):  # type: ignore[type-arg]
    def __iter__(self) -> Any:
        return iter(())


class Level(enum.Enum):
    LOW = 0


class Generic1(msgspec.Struct, Generic[T]):
    content: T


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (Listed(), "a Listed, which is a list, too"),
        (Counted(), "a Counted with 'hidden', which is not a field"),
        (Described(1), "a Described with a 'shown' of its own"),
        (Shared([1]), "a Shared, whose copies are not its equals"),
        (Growing(), "a Growing, whose copies are not its equals"),
        (Text("a"), "a Text"),
        (defaultdict(int), "a defaultdict"),
        (range(3), "a range"),
    ],
)
def test_a_variable_with_more_than_can_be_seen_is_refused_by_name(value: Any, message: str) -> None:
    class M(Machine):
        held: Any = 0
        A, B = State(), State()
        A.to(B)
        B.on_entry(lambda self: setattr(self, "held", deepcopy(value)))

    with pytest.raises(UnsupportedError, match=rf"^M\.held is {message}: only data"):
        explore(M, period_ms=10)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (Odd((1,)), Odd((2,))),
        (Slim(1), Slim(2)),
        (Wider(1, 2), Wider(2, 1)),
        ({float("nan"), float("nan")}, {float("nan")}),
        (Generic1(True), Generic1(1)),
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
    ],
)
def test_values_that_are_hardly_different_have_keys_of_their_own(one: Any, other: Any) -> None:
    assert freeze(one) != freeze(other)
    assert freeze(own_copy(one)) == freeze(one)


@dataclass
class Tally:
    n: int = 0

    def count(self) -> int:
        Tally.total = getattr(Tally, "total", 0) + 1  # type: ignore[attr-defined]
        return Tally.total  # type: ignore[attr-defined, no-any-return]


def test_what_the_class_of_a_part_keeps_is_named() -> None:
    class M(Machine):
        tallies: list[Any] = [(Tally(),)]  # noqa: RUF012, as of every machine
        A, B = State(), State()
        A.to(B, when=lambda self: self.tallies[0][0].count() > 3)

    with pytest.raises(UnsupportedError, match=r"^M changes Tally\.total: "):
        explore(M, period_ms=10, properties=[never(lambda v: v.M.state == "B")])
