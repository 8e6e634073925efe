"""States and transitions: what a machine class declares, and what everything reads.

A `State` is a name, its sections and its ordered transitions; a `Transition` is an ordered
(expression, target). The runner, the drawing and the checker read these same objects.
"""

from __future__ import annotations

import dis
import math
import sys
from collections.abc import Callable, Sequence
from functools import lru_cache
from types import CodeType, FrameType
from typing import (
    TYPE_CHECKING,
    Any,
    Generic,
    Literal,
    NamedTuple,
    Self,
    TypeAlias,
    TypeVar,
    overload,
)

from llfsm.runtime.engine.errors import DefinitionError

if TYPE_CHECKING:
    from llfsm.runtime.engine.submachine import Submachine, Submachines

SectionCode: TypeAlias = Callable[[Any], None]
Guard: TypeAlias = Callable[[Any], bool]
Runs: TypeAlias = "str | type[Any] | Callable[[Any], Any]"
"""What a state runs: a machine class, a function of the machine that makes one, or a name."""
Resume: TypeAlias = Literal["again", "in_place"]
ClockWhileSuspended: TypeAlias = Literal["runs", "stops"]
S = TypeVar("S", bound=SectionCode)
G = TypeVar("G", bound=Guard)
M = TypeVar("M")
R = TypeVar("R")

DEFERRED = 0x20 | 0x80 | 0x200
"""Flags of the code of generators, coroutines and both, which does nothing when called."""

SECTIONS = ("OnEntry", "OnExit", "Internal", "OnSuspend", "OnResume")


class ClassBody(dict[str, Any]):
    """The names of a machine class under way, with copies of its parent's states to extend."""

    def __init__(self, owner: str, parent: type | None, states: tuple[State, ...]):
        super().__init__()
        self.owner = owner
        self.parent = parent
        self.inherited = {state.name: state.copy() for state in states}
        self.loops: set[str] = set()  # variables of loops over states, which name no state
        for state in self.inherited.values():
            for transition in state.transitions:
                transition.target = self.inherited[transition.target.name]

    def __setitem__(self, name: str, value: Any) -> None:
        if getattr(self.get(name), "declared_once", False) and name not in self.loops:
            raise DefinitionError(f"{self.owner}: {name!r} is declared twice")
        if isinstance(value, State) and name in _loop_variables(sys._getframe(1).f_code):
            self.loops.add(name)
        super().__setitem__(name, value)


@lru_cache(maxsize=64)
def _loop_variables(code: CodeType) -> frozenset[str]:
    """Name the variables of the loops in a class body."""
    found, is_target = set(), False
    for each in dis.get_instructions(code):
        if is_target and each.opname == "STORE_NAME":
            found.add(each.argval)
        is_part = is_target and each.opname in ("STORE_NAME", "UNPACK_SEQUENCE")
        is_target = each.opname == "FOR_ITER" or is_part
    return frozenset(found)


class Waiting(NamedTuple):
    """All that a machine in one state waits for, besides requests and a stop."""

    polls: str = ""
    """The reason why it has to be polled; "" if only what is listed here can change anything."""
    sensors: frozenset[str] = frozenset()
    machines: frozenset[str] = frozenset()
    """The machines of whose statuses it asks."""
    limits_ns: tuple[int, ...] = ()
    """Times in the state, in order: beyond each, something may change."""
    limits_in: tuple[tuple[str, float], ...] = ()
    """Variables that hold such times, each with the nanoseconds of its unit."""
    ends: bool = False
    """True if it waits for the end of what the state runs."""

    @property
    def text(self) -> str:
        """Describe its wait in words, as "battery or 3.2 s"; "" if that is requests alone."""
        awaited = sorted(self.sensors)
        awaited += ["the end of what it runs"] * self.ends
        awaited += [f"the status of {name}" for name in sorted(self.machines)]
        awaited += [f"{limit_ns / 1e9:g} s" for limit_ns in self.limits_ns]
        awaited += [f"the time in {name}" for name, _ in self.limits_in]
        *others, last = awaited or [""]
        return f"{', '.join(others)} or {last}" if others else last


class State:
    """Declare a state of a machine; the first one declared is the initial state.

    The state is called what the class calls it, unless a `name` is given. `suspend=True` makes
    it the machine's suspend state. A machine ends after a turn in a state without transitions,
    unless that state is not `final`: then it goes on there. In a subclass, declare on
    `Parent.state` to extend the subclass's copy: sections replace the inherited ones, transitions
    come after them.

    A state `runs` a machine as long as it is the current one: a machine class, a function of the
    machine that makes one, the name of one, or several of these. It is made after OnEntry, has its
    turns right behind those of its machine, and ends before OnExit. What it has come to is seen by
    the state's name, as in `self.work.done` (see `Submachine`). A failure for which no transition
    fires is one of the machine. A state without transitions ends its machine when what it runs is
    done. With `history=True`, what was not done is suspended when the state is left, and resumed
    when it is entered again.

    A machine that is resumed enters its state again, and OnEntry runs, unless the state says
    `resume="in_place"`: then OnResume alone does, and the state's clock has run on meanwhile, or
    has stood still with `clock="stops"`. After an error, or if OnEntry has not run, it is entered.
    """

    declared_once = True

    name: str
    suspend: bool
    final: bool
    runs: tuple[Runs, ...]
    """The machines that it runs, in the order of turns."""
    several: bool
    """True if it was given a list of machines to run."""
    history: bool
    resume: Resume
    clock: ClockWhileSuspended
    sections: dict[str, SectionCode]
    transitions: list[Transition]
    owner: type | None
    """The machine class, once it is complete."""
    _given: set[str]
    """Those of `sections` that are not inherited."""

    if TYPE_CHECKING:  # the class of the result, and so what it is as an attribute

        @overload
        def __new__(
            cls,
            name: str | None = ...,
            *,
            suspend: bool = ...,
            final: bool = ...,
            runs: None = ...,
            resume: Resume = ...,
            clock: ClockWhileSuspended = ...,
        ) -> Self: ...
        @overload
        def __new__(
            cls,
            name: str | None = ...,
            *,
            suspend: bool = ...,
            final: bool = ...,
            runs: type[M] | Callable[[Any], M],
            history: bool = ...,
            resume: Resume = ...,
            clock: ClockWhileSuspended = ...,
        ) -> SubmachineState[Submachine[M]]: ...
        @overload
        def __new__(
            cls,
            name: str | None = ...,
            *,
            suspend: bool = ...,
            final: bool = ...,
            runs: str,
            history: bool = ...,
            resume: Resume = ...,
            clock: ClockWhileSuspended = ...,
        ) -> SubmachineState[Submachine[Any]]: ...
        @overload
        def __new__(
            cls,
            name: str | None = ...,
            *,
            suspend: bool = ...,
            final: bool = ...,
            runs: list[Any] | tuple[Any, ...],
            history: bool = ...,
            resume: Resume = ...,
            clock: ClockWhileSuspended = ...,
        ) -> SubmachineState[Submachines]: ...
        def __new__(cls, *_: Any, **__: Any) -> Any:
            """Make a state."""

    else:

        def __new__(cls, *_: Any, runs: Any = None, **__: Any) -> Any:
            """Make a state, or a `SubmachineState` if it runs anything."""
            return super().__new__(cls if runs is None else SubmachineState)

        def __init__(
            self,
            name: str | None = None,
            *,
            suspend: bool = False,
            final: bool = True,
            runs: Runs | Sequence[Runs] | None = None,
            history: bool = False,
            resume: Resume = "again",
            clock: ClockWhileSuspended = "runs",
        ):
            self.name = name or ""
            self.suspend = suspend
            self.final = final
            self.several = isinstance(runs, list | tuple)
            self.runs = tuple(_runnable(self, runs))
            self.history = history
            _check_resume(self, resume, clock)
            self.resume = resume
            self.clock = clock
            self.sections = {}
            self._given = set()
            self.transitions = []
            self.owner = None

    def __repr__(self) -> str:
        return f"State({self.name!r})"

    @property
    def accepting(self) -> bool:
        """True if a machine ends after a turn in the state."""
        return self.final and not self.transitions

    def on_entry(self, code: S) -> S:
        """Run `code` when the state is entered from another one."""
        return self._section("OnEntry", code)

    def on_exit(self, code: S) -> S:
        """Run `code` when a transition of the state fires."""
        return self._section("OnExit", code)

    def internal(self, code: S) -> S:
        """Run `code` in each ringlet in which no transition fires."""
        return self._section("Internal", code)

    def on_suspend(self, code: S) -> S:
        """Run `code` when the machine is suspended in this state."""
        return self._section("OnSuspend", code)

    def on_resume(self, code: S) -> S:
        """Run `code` when the machine is resumed in this state, before its OnEntry."""
        return self._section("OnResume", code)

    def to(
        self,
        target: State,
        *,
        when: Guard | None = None,
        after_ms: float | None = None,
        after: float | None = None,
        when_done: bool = False,
        when_failed: bool = False,
        label: str | None = None,
    ) -> Transition:
        """Add a transition to `target`, evaluated after those already there.

        It fires when all that is given holds: more than `after_ms` milliseconds, or `after`
        seconds, have passed since the state was entered, what the state runs is done or, with
        `when_failed`, has failed (with both: either), and `when` (or the guard that the result
        decorates) returns True. With nothing given it always fires. `label` replaces the label
        that would be derived.
        """
        frame = sys._getframe(1)
        state = self._open(frame)
        transition = Transition(
            state, target, (frame.f_code.co_filename, frame.f_lineno), after_ms, after, label
        )
        if when_done or when_failed:
            transition.wait_for_end(done=when_done, failed=when_failed)
        if when is not None:
            transition(when)
        state.transitions.append(transition)
        return transition

    def copy(self) -> State:
        """Return an independent state with the same sections, transitions and targets."""
        runs: Any = self.runs if self.several else next(iter(self.runs), None)
        twin: State = State(
            self.name,
            suspend=self.suspend,
            final=self.final,
            runs=runs,
            history=self.history,
            resume=self.resume,
            clock=self.clock,
        )
        twin.sections = dict(self.sections)
        twin.transitions = [transition.copy(twin) for transition in self.transitions]
        return twin

    def _section(self, section: str, code: S) -> S:
        state = self._open(sys._getframe(2))
        if section in state._given:
            raise DefinitionError(f"state {_name(self)!r}: {section} is given twice")
        _check_code(self, section, code)
        state._given.add(section)
        state.sections[section] = code
        return code

    def _open(self, frame: FrameType) -> State:
        """Return the state to declare on: this one, or its copy in a subclass under way.

        A complete class never changes, so a declaration on one of its states belongs to the
        class whose body makes it. Only the calling frame knows which that is.
        """
        if self.owner is None:
            return self
        body = frame.f_locals
        if isinstance(body, ClassBody) and body.parent and issubclass(body.parent, self.owner):
            return body.inherited[self.name]
        raise DefinitionError(
            f"{self.owner.__qualname__} is complete: extend its state {self.name!r} "
            f"in the body of a subclass"
        )


class SubmachineState(State, Generic[R]):
    """A state that runs machines. As an attribute of a machine it is what it runs, or ran last."""

    @overload
    def __get__(self, machine: None, owner: type) -> Self: ...
    @overload
    def __get__(self, machine: object, owner: type) -> R: ...
    def __get__(self, machine: Any, owner: type) -> Self | R:
        """Return the state of a class, and what the state of a machine runs."""
        if machine is None:
            return self
        found: R = machine._seat.work(self.name)
        return found


class Transition:
    """One transition of a state; as a decorator it takes the guard that must also hold."""

    def __init__(
        self,
        source: State,
        target: State,
        declared: tuple[str, int],
        after_ms: float | None,
        after: float | None,
        label: str | None,
    ):
        if not isinstance(target, State):
            raise DefinitionError(
                f"state {_name(source)!r}: a transition leads to a State, not to {target!r}"
            )
        if after_ms is not None and after is not None:
            raise DefinitionError(f"state {_name(source)!r}: give after_ms or after, not both")
        self.source = source
        self.target = target
        self.guard: Guard | None = None
        self.after_ms = after_ms if after is None else _time(source, after) * 1000
        self.timed = "" if after is None else f"after({after!r})"
        if after_ms is not None:
            self.timed = f"after_ms({_time(source, after_ms)!r})"
        self.ends: tuple[str, ...] = ()
        """The ends of what the state runs of which one must have come: "done", "failed"."""
        self._declared = declared
        self._label = label

    def wait_for_end(self, *, done: bool, failed: bool) -> None:
        """Require that what the state runs is done, has failed, or either."""
        if not self.source.runs:
            raise DefinitionError(
                f"state {_name(self.source)!r}: when_done and when_failed are for states that run "
                f"a machine: give it State(runs=...)"
            )
        self.ends = ("done",) * done + ("failed",) * failed

    def __call__(self, guard: G) -> G:
        """Require `guard` too."""
        if self.guard is not None:
            raise DefinitionError(
                f"state {_name(self.source)!r}: the transition to {_name(self.target)!r} "
                f"has two guards"
            )
        _check_code(self.source, "a guard", guard)
        self.guard = guard
        return guard

    def __repr__(self) -> str:
        return f"Transition({self.source.name!r} -> {self.target.name!r}, {self.label!r})"

    @property
    def label(self) -> str:
        """The text on the arrow: the guard's name, or its expression if it has none.

        "after_ms(1000)" for a timed transition, "true" for an unconditional one.
        """
        if self._label is not None:
            return self._label
        named = ""
        if self.guard is not None:
            named = getattr(self.guard, "__name__", "")
            if named in ("", "_", "<lambda>"):
                named = self.expression or "{}:{}".format(*self.location)
        return " and ".join(filter(None, (self.timed, " or ".join(self.ends), named))) or "true"

    @property
    def expression(self) -> str | None:
        """The source text of the guard's expression; None without guard or without source."""
        from llfsm.runtime.engine.source_text import expression_of  # here, as it needs `ast`

        return None if self.guard is None else expression_of(self.guard)

    @property
    def location(self) -> tuple[str, int]:
        """File and line of the guard, or of the declaration if there is none."""
        return (self.guard and location_of(self.guard)) or self._declared

    @property
    def unconditional(self) -> bool:
        """True if it always fires."""
        return self.guard is None and self.after_ms is None and not self.ends

    def copy(self, source: State) -> Transition:
        """Return the same transition leaving `source`."""
        twin = Transition(source, self.target, self._declared, None, None, self._label)
        twin.guard, twin.after_ms, twin.timed = self.guard, self.after_ms, self.timed
        twin.ends = self.ends
        return twin


def location_of(function: Callable[..., Any]) -> tuple[str, int] | None:
    """Return file and line of `function`, or None if it is not a Python function."""
    code = getattr(function, "__code__", None)
    return None if code is None else (code.co_filename, code.co_firstlineno)


def _check_code(state: State, what: str, code: object) -> None:
    """Refuse anything but a function, and functions that do nothing when called."""
    flags = getattr(getattr(code, "__code__", None), "co_flags", 0)
    if callable(code) and not flags & DEFERRED:
        return
    given = repr(code)
    if flags & DEFERRED:
        given = f"{getattr(code, '__name__', given)!r}, which is async or yields"
    raise DefinitionError(
        f"state {_name(state)!r}: {what} must be a plain function of the machine, not {given}"
    )


def _check_resume(state: State, resume: object, clock: object) -> None:
    for what, value, known in (
        ("resume", resume, ("again", "in_place")),
        ("clock", clock, ("runs", "stops")),
    ):
        if value not in known:
            raise DefinitionError(
                f"state {_name(state)!r}: {what} is {value!r}; it must be {known[0]!r} or "
                f"{known[1]!r}"
            )
    if clock == "stops" and resume != "in_place":
        raise DefinitionError(
            f'state {_name(state)!r}: clock="stops" is for resume="in_place"; else it starts anew'
        )


def _runnable(state: State, runs: Runs | Sequence[Runs] | None) -> Sequence[Runs]:
    """List what a state is to run, checked."""
    each: list[Any] = [*runs] if isinstance(runs, list | tuple) else [runs][: runs is not None]
    for one in each:
        if not isinstance(one, type) and hasattr(one, "_seat"):
            raise DefinitionError(
                f"state {_name(state)!r} runs {one!r}, a machine that could run only once: give "
                f"its class, or a function of the machine that makes one, as in "
                f"runs=lambda self: Drive(to=self.goal)"
            )
        is_class = hasattr(one, "table") if isinstance(one, type) else False
        if isinstance(one, str) or is_class:
            continue
        if isinstance(one, type):
            raise DefinitionError(f"state {_name(state)!r} runs {one!r}, which is no machine class")
        _check_code(state, "what it runs", one)
    if runs is not None and not each:
        raise DefinitionError(f"state {_name(state)!r} is to run nothing: leave runs out")
    return each


def _name(state: State) -> str:
    """Return a state's name for an error, also while the body of its class is being executed."""
    frame: FrameType | None = sys._getframe()
    while frame is not None and not state.name:
        if isinstance(frame.f_locals, ClassBody):
            return next((name for name, value in frame.f_locals.items() if value is state), "")
        frame = frame.f_back
    return state.name


def _time(source: State, value: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
        raise DefinitionError(
            f"state {_name(source)!r}: a transition waits for a time of 0 or more, not {value!r}"
        )
    return value
