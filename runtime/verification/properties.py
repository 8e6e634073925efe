"""Properties of machines, the views that their functions get, and the verdicts on them.

A property's function gets a `View` of a state, as in `v.Timer.minutes`, `v[MOTOR].on` or
`v.Cooker.door`, and returns True or False. It must depend on nothing else: it is called once for
all states that agree in the fields that it reads. A view shows wrong names as errors, also those of
states, which are compared as texts: a misspelt name would make a property hold for no reason.

A `Verdict` has a shortest way to a violation as a `Witness`, at any time a short one: data from
which `llfsm.runtime.counterexamples` makes scripts, tables and tests.
"""

from __future__ import annotations

import dis
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from itertools import dropwhile
from math import inf
from types import CodeType, FrameType, MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, Protocol, TypeAlias, TypeVar

from llfsm.errors import LlfsmError, did_you_mean
from llfsm.runtime._values import message_text
from llfsm.runtime.engine.events import Request
from llfsm.runtime.engine.source_text import expression_of
from llfsm.runtime.engine.state import State
from llfsm.runtime.verification.errors import PredicateError

if TYPE_CHECKING:
    from llfsm.runtime.engine.machine import Machine
    from llfsm.runtime.engine.seat import Seat
    from llfsm.runtime.verification.environment import ControlState
    from llfsm.whiteboard import Slot


LastAsk: TypeAlias = Literal["suspend", "stop"]


class ChosenTurn(NamedTuple):
    """A turn of a machine, and the choice of its environment just before.

    `found` has the messages in the slots that the environment writes, by name (None: no message).
    `request` is asked of the machine from outside, and `stop` is True if a stop came. The time is
    that of the round, in milliseconds; the first round is number 1, one period after 0.
    """

    round: int
    time_ms: float
    machine: str
    found: Mapping[str, Any]
    request: Request | None
    stop: bool
    withdraws: bool = False
    """True if a suspend is asked for before the request: a resume alone replaces no restart."""
    answers: Mapping[str, tuple[tuple[str, bool] | None, ...]] = MappingProxyType({})
    """The answers to its questions for machines of other processes, in order, by their names: the
    state and whether it is suspended; None if there is none of that name."""


def answer_text(answer: tuple[str, bool] | None) -> str:
    """Say in which state a machine of another process is found."""
    return "not there" if answer is None else f"in {answer[0]}{', suspended' * answer[1]}"


class Region(NamedTuple):
    """A region with no way out, which a counterexample enters after so many `turns`."""

    turns: int
    states: int
    """The states that can follow then, the first included."""


class Witness(NamedTuple):
    """A way from the initial state: `turns`, and those that complete the last round, or the first.

    With a `loop`, the turns from that index on can repeat for ever. Where the machines end instead,
    `at_end` has the requests to them, by name, when the last round is over.
    """

    turns: tuple[ChosenTurn, ...]
    rest: tuple[ChosenTurn, ...]
    loop: int | None = None
    at_end: Mapping[str, tuple[LastAsk, ...]] = MappingProxyType({})
    region: Region | None = None
    """Of `always_possible`: where it goes into a region with no way out."""

    def lines(self) -> Iterator[str]:
        """Write the changes of the environment before each turn, in a line."""
        contents: dict[str, Any] = {}
        for turn in self.turns:
            news = [
                message_text(slot, message)
                for slot, message in turn.found.items()
                if slot not in contents or contents[slot] is not message  # equal ones are one
            ]
            contents.update(turn.found)
            for machine, answers in turn.answers.items():
                news += [f"{machine} is {answer_text(answer)}" for answer in answers]
            if turn.withdraws:
                news.append("suspend is asked for")
            if turn.request is not None:
                news.append(f"{turn.request.value} is asked for")
            if turn.stop:
                news.append("stop is asked for")
            if news:
                where = f"round {turn.round}, {turn.time_ms:.10g} ms, {turn.machine}"
                yield f"{where}: {', '.join(news)}"
        yield from self.end_lines()

    def end_lines(self) -> Iterator[str]:
        """Write the requests when the last round is over, a line each, and describe the region."""
        for name, asks in self.at_end.items():
            news = ", ".join(f"{ask} is asked for" for ask in asks)
            yield f"at the end of the round, {name}: {news}"
        if self.region is not None:
            turns, states = self.region
            since = f"after turn {turns}" if turns else "from the beginning"
            size = "one state" if states == 1 else f"{states:,} states"
            yield f"no way leads to it {since}: {size} can follow"


_SCREEN = 24
T = TypeVar("T")


def on_a_screen(lines: Sequence[T], gap: Callable[[int], T]) -> list[T]:
    """Leave lines in the middle out that no screen has room for; `gap` makes one of their number.

    Two thirds of the others are the last ones, which show what is wrong.
    """
    left = len(lines) - _SCREEN
    first = _SCREEN // 3
    return [*lines] if left <= 0 else [*lines[:first], gap(left), *lines[first + left :]]


class Situation(Protocol):
    """A state of all machines, from which a view reads one field after the other."""

    seats: Mapping[str, Seat]
    """The machines by name; only what never changes is read from them."""
    defaults: Mapping[str, Any]
    """By slot, the message as which an empty one reads."""

    def control(self, machine: str) -> ControlState:
        """Return a machine's control state."""
        ...

    def variables(self, machine: str) -> Mapping[str, Any]:
        """Return a machine's variables."""
        ...

    def seen(self, machine: str, sensor: str) -> Any:
        """Return the message that a machine's sensor found in its last turn; None if none."""
        ...

    def content(self, slot: str) -> Any:
        """Return the message in a slot; None before the first."""
        ...


def defaults_of(seats: Iterable[Seat]) -> dict[str, Any]:
    """Find the message that a view shows for each slot, by name, while it is empty.

    It is the default that sensors agree on, or a message of defaults; None if there is neither.
    """
    types: dict[str, Callable[[], Any]] = {}
    given: dict[str, list[Any]] = {}
    for seat in seats:
        table = type(seat.machine).table
        for actuator in table.actuators.values():
            slot = seat.slot_of(actuator)
            types[slot.name] = slot.type
        for sensor in table.sensors.values():
            slot = seat.slot_of(sensor)
            types[slot.name] = slot.type
            if sensor.default is not None:
                given.setdefault(slot.name, []).append(sensor.default)
    defaults: dict[str, Any] = {}
    for name, make in types.items():
        found = given.get(name, [])
        if found and all(other == found[0] for other in found):
            defaults[name] = found[0]
            continue
        try:
            defaults[name] = make()
        except TypeError:  # a field has no default
            defaults[name] = None
    return defaults


class View:
    """A state: its machines by name, as in `v.Timer` or `v["Timer.0"]`, and `v[SLOT]`.

    An empty slot shows the default that sensors agree on, or else a message of its type's defaults;
    None if there is no such message. A slot of the environment shows what a machine found there
    last.
    """

    def __init__(self, situation: Situation):
        self._situation = situation

    def __getattr__(self, name: str) -> MachineView:
        seats = self._situation.seats
        if name not in seats:
            raise PredicateError(
                f"there is no machine {name!r}{did_you_mean(name, seats)}; there are: "
                f"{', '.join(seats)}"
            )
        return MachineView(self._situation, name)

    def __getitem__(self, what: Slot[Any] | str) -> Any:
        if isinstance(what, str) and what in self._situation.seats:
            return MachineView(self._situation, what)
        name = what if isinstance(what, str) else what.name
        defaults = self._situation.defaults
        if name not in defaults:
            seats = self._situation.seats if isinstance(what, str) else {}
            raise PredicateError(
                f"no machine reads or posts to a slot {name!r}"
                f"{', or is called so' if seats else ''}"
                f"{did_you_mean(name, (*defaults, *seats))}; the slots are: "
                f"{', '.join(sorted(defaults))}"
                + (f"; the machines are: {', '.join(seats)}" if seats else "")
            )
        content = self._situation.content(name)
        return defaults[name] if content is None else content


class MachineView:
    """A machine: its `state`, its variables, and what its sensors found in its last turn.

    `suspended`, `accepted`, `loaded` and `has_failed` are True or False. A state compares with
    names and with `State` objects; a name that the machine's states do not have is an error. So is
    to look a state up by its hash, but in a set of names that is written out, as in
    `v.Door.state in {"OPEN", "SHUT"}`.
    """

    def __init__(self, situation: Situation, name: str):
        self._situation = situation
        self._name = name

    @property
    def state(self) -> StateName:
        """The name of its current state."""
        control, seat = self._control("state"), self._situation.seats[self._name]
        known = dict.fromkeys([*seat.states, seat.suspension.name])
        return StateName(control.current, self._name, tuple(known))

    @property
    def suspended(self) -> bool:
        """True if it is in its suspend state."""
        control, seat = self._control("suspended"), self._situation.seats[self._name]
        return control.current == seat.suspension.name

    @property
    def accepted(self) -> bool:
        """True if it has ended a turn in an accepting state."""
        return self._control("accepted").accepted

    @property
    def loaded(self) -> bool:
        """True unless it has been unloaded."""
        return self._control("loaded").loaded

    @property
    def has_failed(self) -> bool:
        """True if its code has raised, and it was not resumed since (``on_error="suspend"``)."""
        return self._control("has_failed").failed

    def _control(self, asked: str) -> ControlState:
        table = type(self._situation.seats[self._name].machine).table
        if asked in table.variables or asked in table.sensors:
            raise PredicateError(
                f"{self._name} has {asked!r} of its own, which {self._name}.{asked} does not show: "
                f"call the variable or sensor otherwise"
            )
        return self._situation.control(self._name)

    def __getattr__(self, name: str) -> Any:
        table = type(self._situation.seats[self._name].machine).table
        if name in table.sensors:
            found = self._situation.seen(self._name, name)
            return table.sensors[name].default if found is None else found
        variables = self._situation.variables(self._name)
        if name in variables:
            return deepcopy(variables[name])
        known = [
            "state",
            "suspended",
            "accepted",
            "loaded",
            "has_failed",
            *table.sensors,
            *variables,
        ]
        raise PredicateError(
            f"{self._name} has no {name!r}{did_you_mean(name, known)}; it has: {', '.join(known)}"
        )


class StateName(str):
    """The name of a machine's state, which knows the others."""

    _machine: str
    _known: tuple[str, ...]

    def __new__(cls, name: str, machine: str, known: tuple[str, ...]) -> StateName:
        """Make the name of a state of `machine`, whose states are `known`."""
        made = super().__new__(cls, name)
        made._machine = machine
        made._known = known
        return made

    def __eq__(self, other: object) -> bool:
        if isinstance(other, State):
            other = other.name
        if isinstance(other, str) and not isinstance(other, StateName) and other not in self._known:
            raise PredicateError(
                f"{self._machine} has no state {other!r}{did_you_mean(other, self._known)}; its "
                f"states are: {', '.join(self._known)}"
            )
        return str.__eq__(self, other) is True

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        names = _written_set(sys._getframe(1))
        if names is None:
            raise PredicateError(
                f"a state of {self._machine} is looked up in a set or dict, which takes any name "
                f"for one of no state: compare it by ==, or by `in` with a tuple"
            )
        for name in names:
            self == name  # noqa: B015, which refuses a name of no state
        return str.__hash__(self)


def _written_set(frame: FrameType) -> frozenset[str] | None:
    """Find the names in `... in {"A", "B"}`, if the frame is about to evaluate that; else None.

    Python compiles such a set to a constant, which it loads just before the comparison.
    """
    before: object = None
    for step in dis.get_instructions(frame.f_code):
        if step.offset == frame.f_lasti:
            break
        before = step.argval
    if isinstance(before, frozenset) and all(isinstance(name, str) for name in before):
        return before
    return None


Predicate: TypeAlias = Callable[[Any], bool]
"""A function of a `View`; Any, as a view's machines and their variables have no types of theirs."""
StepPredicate: TypeAlias = Callable[[Any, Any], bool]
"""A function of the views before and after a turn."""
Kind: TypeAlias = Literal[
    "never", "always", "reachable", "step", "leads_to", "eventually_always", "always_possible"
]
LIVENESS: Final = ("leads_to", "eventually_always", "always_possible")
"""The kinds that are decided once all states are known."""


class Property(NamedTuple):
    """A property: its kind, its functions, and its name in reports."""

    kind: Kind
    functions: tuple[Callable[..., bool], ...]
    name: str
    assuming: tuple[Predicate, ...] = ()
    """Of `leads_to` and `eventually_always`: predicates that hold again and again."""
    within_ms: float | None = None
    """Of `leads_to`: the milliseconds that it may take; None for any time."""
    monitor: type[Machine] | None = None
    """A machine that is explored after the others, because the property asks for its states."""

    def __str__(self) -> str:
        return self.name


class Verdict(NamedTuple):
    """The result for a property.

    `holds` is None if the exploration ended before that was known. `witness` is a shortest way
    to a violation or, for `reachable`, to a state that was to be reached; a short one, if any time
    may pass. A `vacuous` property holds only because its trigger never does.
    """

    property: Property
    holds: bool | None
    witness: Witness | None
    vacuous: bool = False


class PropertyError(LlfsmError, AssertionError):
    """A property does not hold, or could not be decided; `verdicts` are those of all."""

    def __init__(self, text: str, verdicts: tuple[Verdict, ...]):
        self.verdicts = verdicts
        super().__init__(text)


def never(predicate: Predicate, name: str | None = None) -> Property:
    """Require that no state satisfies `predicate`."""
    return _property("never", name, predicate)


def always(predicate: Predicate, name: str | None = None) -> Property:
    """Require that every state satisfies `predicate`."""
    return _property("always", name, predicate)


def reachable(predicate: Predicate, name: str | None = None) -> Property:
    """Require that some state satisfies `predicate`."""
    return _property("reachable", name, predicate)


def step(predicate: StepPredicate, name: str | None = None) -> Property:
    """Require that every turn satisfies `predicate`, of the states before and after it."""
    return _property("step", name, predicate)


def leads_to(
    trigger: Predicate,
    response: Predicate | Iterable[Predicate],
    name: str | None = None,
    *,
    within_ms: float | None = None,
    assuming: Predicate | Iterable[Predicate] = (),
) -> Property:
    """Require that every state that satisfies `trigger` is or leads to one with `response`.

    Several responses must come one after the other; a state may be more than one of them. The last
    must come within `within_ms` milliseconds, counted by the periods that pass, or else at some
    time: there must be no cycle without it. Of the cycles only those count in which each function
    of `assuming` holds somewhere. An execution that ends without it violates it, too, if the
    assumptions hold in its last state. If any time may pass between rounds, `within_ms` must be
    given, and only what comes in the same round is in time: the next one may begin too late.

    Raise `PredicateError` for no response, and for `within_ms` together with `assuming`.
    """
    responses = (response,) if callable(response) else tuple(response)
    if not responses:
        raise PredicateError("leads_to needs a response: a function, or several in their order")
    assumed = _assumed("leads_to", assuming)
    if within_ms is not None and assumed:
        raise PredicateError(
            "leads_to has within_ms or assuming, not both: what happens again and again may take "
            "any time"
        )
    if within_ms is not None and not (isinstance(within_ms, int | float) and 0 <= within_ms < inf):
        raise PredicateError(f"within_ms is {within_ms!r}; it must be a number, 0 or more")
    prop = _property("leads_to", name, trigger, *responses)
    return prop._replace(assuming=assumed, within_ms=within_ms)


def eventually_always(
    predicate: Predicate,
    name: str | None = None,
    *,
    assuming: Predicate | Iterable[Predicate] = (),
) -> Property:
    """Require that in every execution `predicate` holds for ever from some point on.

    So there must be no cycle in which it fails somewhere; of the cycles only those count in which
    each function of `assuming` holds somewhere. It must hold in the last state of an execution that
    ends, too, if the assumptions do.
    """
    prop = _property("eventually_always", name, predicate)
    return prop._replace(assuming=_assumed("eventually_always", assuming))


def always_possible(predicate: Predicate, name: str | None = None) -> Property:
    """Require that from every state some way leads to one that satisfies `predicate`.

    Nobody need take that way: an environment that never helps is no violation, but a region
    without a way out is.
    """
    return _property("always_possible", name, predicate)


def monitor(
    machine: type[Machine], bad: State | Iterable[State], name: str | None = None
) -> Property:
    """Require that a machine that watches the others never comes into a state of `bad`.

    It has its turn after the others, posts nothing, and finds in slots of the environment what the
    others found there last.
    """
    states = [bad] if isinstance(bad, State) else list(bad)
    known = [state.name for state in machine.table.states]
    for state in states:
        if not isinstance(state, State) or state.name not in known:
            raise PredicateError(
                f"monitor: {machine.__name__} has no state {state!r}; it has: {', '.join(known)}"
            )
    if machine.table.actuators:
        raise PredicateError(
            f"monitor: {machine.__name__} posts to {next(iter(machine.table.actuators))}; what "
            f"watches must not act"
        )
    named, watcher = {state.name for state in states}, machine.__name__

    def is_bad(view: View) -> bool:
        return str(view[watcher].state) in named

    text = name or f"{watcher} never in {' or '.join(sorted(named))}"
    return Property("never", (is_bad,), text, monitor=machine)


NO_FAILURE: Final = Property("never", (), "no machine's code raises")
"""The property that is always checked."""


def some_failed(view: View) -> bool:
    """Check for a machine that was suspended because its code raised."""
    situation = view._situation
    outermost = (name for name, seat in situation.seats.items() if seat.caller is None)
    return any(situation.control(name).failed for name in outermost)


def _property(kind: Kind, name: str | None, *functions: Callable[..., bool]) -> Property:
    for function in functions:
        _check_function(kind, function)
    return Property(kind, functions, name or f"{kind}({', '.join(map(_text_of, functions))})")


def _assumed(kind: Kind, assuming: Predicate | Iterable[Predicate]) -> tuple[Predicate, ...]:
    assumed = (assuming,) if callable(assuming) else tuple(assuming)
    for function in assumed:
        _check_function(f"{kind}(..., assuming=...)", function)
    return assumed


def _check_function(what: str, function: object) -> None:
    if not callable(function) or isinstance(function, type):
        raise PredicateError(
            f"{what} needs a function of the view, such as lambda v: v.Timer.minutes > 0, "
            f"not {function!r}"
        )
    if _asks_which_state(getattr(function, "__code__", None)):
        raise PredicateError(
            f"{what}: the function compares a state by `is`, but a state is its name: use =="
        )


def _asks_which_state(code: CodeType | None) -> bool:
    """Check code for `v.Machine.state is ...`, or the other way round."""
    steps = [] if code is None else list(dis.get_instructions(code))
    for number, (view, machine, state) in enumerate(zip(steps, steps[1:], steps[2:], strict=False)):
        named = machine.opname == state.opname == "LOAD_ATTR" and state.argval == "state"
        if named and view.opname.startswith("LOAD_FAST"):
            rest = dropwhile(lambda step: step.opname.startswith("LOAD_"), steps[number + 3 :])
            if next(rest).opname == "IS_OP":
                return True
    return False


def _text_of(function: Callable[..., bool]) -> str:
    named = str(getattr(function, "__name__", "<lambda>"))
    return (expression_of(function) or named) if named == "<lambda>" else named


def evaluate(prop: Property, function: Callable[..., bool], *views: View) -> bool:
    """Call a property's function; raise `PredicateError` if it raises or returns no bool."""
    try:
        value = function(*views)
    except PredicateError as error:
        raise PredicateError(f"{prop}: {error}") from None
    except (Exception, SystemExit) as error:
        raise PredicateError(
            f"{prop} raised {type(error).__name__}: {error}{_line(error)}"
        ) from error
    if value is not True and value is not False:
        raise PredicateError(f"{prop} returned {value!r}; it must return True or False")
    return value


def _line(error: BaseException) -> str:
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "" if trace is None else f" ({trace.tb_frame.f_code.co_filename}:{trace.tb_lineno})"
