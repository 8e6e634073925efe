"""Random machines, as data: what code does and what guards ask is drawn by hypothesis."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, Flag, auto
from typing import Any, NamedTuple

from hypothesis import strategies as st

from llfsm.runtime import Actuator, Machine, Sensor, State
from llfsm.runtime.engine.machine import define
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.messages.std_msgs import Int32

__all__ = [
    "AGAIN",
    "FRESH",
    "LEFT",
    "MIXED",
    "NAMES",
    "RIGHT",
    "SHARED",
    "Ages",
    "ages",
    "built",
    "resumptions",
    "specs",
]


class Mode(Enum):
    """A mode, as devices have them."""

    OFF = "off"
    ON = "on"


class Lamps(Flag):
    """Lamps, of which any may be on."""

    RED = auto()
    GREEN = auto()


class Mixed(Message):
    """A message with fields of many kinds."""

    mode: Mode = Mode.OFF
    lamps: Lamps = Lamps(0)
    pair: tuple[float, str] = (0.5, "half")
    note: str | None = None
    raw: bytes = b""
    nested: Int32 | None = None

    @property
    def data(self) -> int:
        """A number for what is in it."""
        return 1 if self.mode is Mode.ON and self.nested is not None else len(self.raw)


MIXED = [
    Mixed(lamps=Lamps.RED | Lamps.GREEN, note="none"),
    Mixed(mode=Mode.ON, pair=(float("inf"), ""), nested=Int32(data=7)),
]
"""Messages whose data are 0 and 1."""
LEFT = Slot("left", Mixed)
RIGHT, SHARED = (Slot(name, Int32) for name in ("right", "shared"))
NAMES = ("A", "B", "C")

deeds = st.one_of(
    st.tuples(st.just("post"), st.integers(0, 2)),
    st.tuples(st.just("count"), st.integers(2, 3)),
    st.tuples(st.just("copy"), st.none()),
    st.tuples(st.just("late"), st.sampled_from([8, 20])),
    st.tuples(st.just("keep"), st.sampled_from([None, True, 1, 1.0, float("nan"), "1", (1,)])),
    st.tuples(st.just("push"), st.integers(0, 1)),
    st.tuples(st.sampled_from(["suspend", "resume", "restart"]), st.sampled_from(NAMES)),
    st.tuples(
        st.sampled_from(["unload", "index_of", "suspend_all", "restart_self", "suspend_self"]),
        st.sampled_from(NAMES),
    ),
)
guards = st.one_of(
    st.none(),
    st.tuples(st.sampled_from(["left", "right", "shared", "n"]), st.integers(0, 2)),
    st.tuples(st.just("after"), st.sampled_from([0, 8, 20, 25])),
    st.tuples(
        st.sampled_from(["suspended", "initial", "stopping", "fails"]), st.sampled_from(NAMES)
    ),
)
SECTIONS = ("on_entry", "on_exit", "internal", "on_suspend", "on_resume")
sections = st.dictionaries(
    st.sampled_from(SECTIONS), st.lists(deeds, min_size=1, max_size=2), max_size=2
)
transitions = st.lists(
    st.tuples(st.integers(0, 2), guards, st.sampled_from([None, None, 5, 15])), max_size=2
)
machines = st.lists(st.tuples(sections, transitions), min_size=1, max_size=3)
specs = st.lists(machines, min_size=1, max_size=3)


class Ages(NamedTuple):
    """The `max_age_ms` of the sensors of RIGHT and SHARED."""

    right: float | None = None
    shared: float | None = None


FRESH = Ages()
_age = st.sampled_from([None, None, None, 1, 5, 8, 9.5, 20])
ages = st.builds(Ages, _age, _age)
AGAIN: dict[str, Any] = {}
resumptions = st.sampled_from(
    [AGAIN, {"resume": "in_place"}, {"resume": "in_place", "clock": "stops"}]
)


def built(drawn: Any, ages: Ages = FRESH, resumed: Any = AGAIN) -> list[type[Machine]]:
    """Return the machines of a drawn list; `resumed` are the options of their states."""
    names = NAMES[: len(drawn)]
    pairs = zip(names, drawn, strict=True)
    return [_machine(name, spec, names, ages, resumed) for name, spec in pairs]


def _machine(
    name: str, spec: Any, others: tuple[str, ...], ages: Ages, resumed: Any
) -> type[Machine]:
    states = [State(f"S{number}", **resumed) for number in range(len(spec))]
    for state, (codes, leads) in zip(states, spec, strict=True):
        for section, what in codes.items():
            getattr(state, section)(_code(what, others))
        for target, guard, after_ms in leads:
            if any(each.unconditional for each in state.transitions):
                break
            when = None if guard is None else _guard(*guard, others)
            state.to(states[target % len(states)], when=when, after_ms=after_ms)
    ports = {
        "left": Sensor(LEFT),
        "right": Sensor(RIGHT, default=Int32(data=2), max_age_ms=ages.right),
        "shared": Sensor(SHARED, default=Int32(data=1), max_age_ms=ages.shared),
        "post": Actuator(SHARED, at_suspend=Int32(data=3)),
    }
    variables = {"n": (int, 0), "kept": (Any, None), "pushed": (list, [])}
    return define(name, states, variables=variables, attributes=ports)


def _code(what: list[tuple[str, Any]], others: tuple[str, ...]) -> Callable[[Any], None]:
    def run(machine: Any) -> None:
        for verb, argument in what:
            match verb:
                case "post":
                    machine.post(Int32(data=argument))
                case "count":
                    machine.n = (machine.n + 1) % argument
                case "copy":
                    machine.post(Int32(data=machine.n))
                case "late":
                    machine.n = 2 if machine.after_ms(argument) else machine.n
                case "keep":
                    machine.kept = argument
                case "push":
                    machine.pushed.append(argument)
                    del machine.pushed[:-2]
                case "suspend_all" | "restart_self" | "suspend_self":
                    getattr(machine, verb)()
                case _ if argument in others:
                    getattr(machine, verb)(argument)

    return run


def _guard(what: str, argument: Any, others: tuple[str, ...]) -> Callable[[Any], bool]:
    def holds(machine: Any) -> bool:
        match what:
            case "after":
                return bool(machine.after_ms(argument))
            case "suspended":
                return argument in others and bool(machine.is_suspended(argument))
            case "initial":
                return argument in others and bool(machine.state_name_of(argument) == "S0")
            case "stopping":
                return bool(machine.stopping)
            case "fails":
                return not machine.n or bool(1 / (machine.n - 1))
            case "n":
                return bool(machine.n == argument)
        message = getattr(machine, what)
        return message is not None and bool(message.data == argument)

    return holds
