"""Explore machines, and verify properties of them: explicit-state model checking of their classes.

A state is all that the future depends on (see `Space`). From each state, all that the environment
may do at the next turn is tried: every message of a domain, every request, every time that makes a
difference. What keeps this fast is that the machines' code is run only for distinct ringlets:

1. `ringlets` and `environment` run one ringlet from any control state, and note what it depends on;
   `system` keeps each distinct one.
2. `tables` packs states into whole numbers, and looks turns up by the bits that they depend on.
3. `breadth_first` finds all states by levels; `predicates` and `deciding` check the properties of
   each level, and `responses` those of liveness at the end.
4. All this is right only if a ringlet does the same whenever it is given the same. So at the end
   `unmodelled_state` runs them again, of many a sample, and looks for state that is kept elsewhere.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from itertools import chain
from math import inf
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, Unpack, get_args

from llfsm.runtime.engine.errors import OptionError
from llfsm.runtime.engine.schedule import Timetable
from llfsm.runtime.verification._breadth_first import search_states
from llfsm.runtime.verification._deciding import Decisions
from llfsm.runtime.verification._ringlets import ENDINGS
from llfsm.runtime.verification._system import System
from llfsm.runtime.verification._time_model import AnyTime, Periods, Slots, TimeModel
from llfsm.runtime.verification._unmodelled_state import UnmodelledState, check_determinism
from llfsm.runtime.verification.domains import Member, members_of
from llfsm.runtime.verification.errors import PredicateError
from llfsm.runtime.verification.inner import UnknownInnerError
from llfsm.runtime.verification.loaded import Found, UnknownLoadingError
from llfsm.runtime.verification.properties import (
    NO_FAILURE,
    Property,
    PropertyError,
    Verdict,
    on_a_screen,
)
from llfsm.runtime.verification.space import Progress, Space

if TYPE_CHECKING:
    from llfsm.runtime.engine.kernel import Factory, OnError
    from llfsm.runtime.engine.machine import Machine
    from llfsm.whiteboard import Slot

_YOUNG = 50_000
"""Objects that are made before garbage is looked for among them."""


Choices: TypeAlias = Literal["turns", "rounds"]


class ExploreOptions(TypedDict, total=False):
    """The options of `explore`, which says what they do; those of `verify` are the same."""

    period_ms: float | None
    timetable: Timetable | None
    any_time: bool
    skips: bool
    sensors: Mapping[Slot[Any] | str, Iterable[Any]] | None
    stop: bool
    suspend: Iterable[str]
    elsewhere: Mapping[str, type[Machine] | Iterable[str | None]] | None
    choices: Choices
    abstract: Mapping[str, Callable[[Any], Any]] | None
    unload_accepting: bool
    on_error: OnError
    max_states: int | None
    max_seconds: float | None
    progress: Callable[[Progress], object] | None


def explore(
    machines: Factory | Iterable[Factory | Member],
    *,
    period_ms: float | None = None,
    timetable: Timetable | None = None,
    any_time: bool = False,
    skips: bool = False,
    sensors: Mapping[Slot[Any] | str, Iterable[Any]] | None = None,
    properties: Iterable[Property] = (),
    stop: bool = False,
    suspend: Iterable[str] = (),
    elsewhere: Mapping[str, type[Machine] | Iterable[str | None]] | None = None,
    choices: Choices = "turns",
    abstract: Mapping[str, Callable[[Any], Any]] | None = None,
    unload_accepting: bool = True,
    on_error: OnError = "stop",
    max_states: int | None = None,
    max_seconds: float | None = None,
    progress: Callable[[Progress], object] | None = None,
) -> Space:
    """Find all states that the machines can reach, and return the space with the verdicts.

    It ends early once every property is decided, by `max_states`, `max_seconds` or Ctrl-C, and
    before memory is used up. The order of machines is that of their turns.

    Args:
        machines: machine classes, functions that return a machine, or a `Member` for each.
        period_ms: the time from one round to the next. Without one, any may pass, also none: then
            `leads_to` without `within_ms` and `eventually_always` cannot be decided.
        timetable: when each machine has its turns, instead of a period; rounds are its cycles.
        any_time: True to say so.
        skips: True to let any number of rounds be left out, as in runs that are far behind.
        sensors: what the environment may put into slots, as in ``{DOOR: every(Door)}``: any of
            these messages, or None for no message, at each turn that reads the slot. They replace
            the domains that sensors declare. A slot to which a machine posts can have none, and a
            domain that its sensors declare is not used.
        properties: the properties to decide.
        stop: True to let a stop come before any turn, as by Ctrl-C.
        suspend: names of machines that anybody may suspend, resume or restart before their turns.
        elsewhere: machines of other processes, by name, each by its class or a list of the states
            that it may be in at each question for it; None is for one that is not there.
        choices: "rounds" to let the environment choose once a round for all machines.
        abstract: for "Machine.variable", a function of its value whose result replaces the value
            after each turn.
        unload_accepting: as for `Arrangement`.
        on_error: as for `Arrangement`. With "stop", what no way shows is undecided if code raises.
        max_states: end the exploration at a level with as many states.
        max_seconds: end it after this time, once the ringlet under way is over.
        progress: called after each level, and within large ones; it ends the exploration by
            returning False.

    Raises:
        OptionError: an argument is impossible.
        VerificationError: the machines cannot be explored as asked; see its subclasses.

    """
    asked = _check_properties(properties)
    watching = dict.fromkeys(each.monitor for each in asked if each.monitor is not None)
    members = (*members_of(machines, sort=timetable is None), *map(Member, watching))
    schedule = _schedule(period_ms, timetable, any_time=any_time)
    _check_option("on_error", on_error, ("stop", "suspend"))
    _check_option("choices", choices, get_args(Choices))
    make_system = partial(
        System,
        members,
        watchers=len(watching),
        time_model=_time_model(schedule, asked, [*watching], skips=skips),
        sensors=sensors or {},
        stop=stop,
        suspend=[suspend] if isinstance(suspend, str) else suspend,
        by_rounds=choices == "rounds",
        unload_accepting=unload_accepting,
        on_error=on_error,
        abstract=abstract or {},
        elsewhere=elsewhere or {},
    )
    decide = partial(Decisions, max_states=max_states, max_seconds=max_seconds, progress=progress)
    return _learnt(make_system, decide, asked, [*watching], members)


def _learnt(
    make_system: Callable[..., System],
    decide: Callable[..., Decisions],
    asked: list[Property],
    monitors: list[type[Machine]],
    members: tuple[Member, ...],
) -> Space:
    """Explore until it is known what states run and code loads; only then decide properties."""
    found, learning, begin_s = Found({}, []), True, time.monotonic()
    while True:
        system = make_system(found=found, learning=learning)
        for machine, name in zip(monitors, system.names[system.watchers.start :], strict=True):
            if machine.__name__ != name:
                raise PredicateError(
                    f"monitor: another machine is called {machine.__name__}, too; rename one"
                )
        learning = system.learning
        try:
            space = _explored(
                system, decide(system, [] if learning else asked, begin_s=begin_s), members
            )
        except UnknownInnerError as error:
            found.inner.setdefault(error.place, []).append(error.cls)
            learning = True
        except UnknownLoadingError as error:
            found.loaded.append(error.loading)
            learning = True
        else:
            if not learning:
                return space
            learning = False


def _explored(system: System, decisions: Decisions, members: tuple[Member, ...]) -> Space:
    """Find all states, check that nothing was left out of them, and decide the properties."""
    unmodelled = UnmodelledState({seat.name: seat.machine for seat in system.ringlets.seats})
    with _seldom_collected():
        search = search_states(
            system, decisions.named, decisions.look, decisions.goes_on, decisions.restart
        )
    ringlets, repeated = system.ringlets.executed, 0
    if search.interrupted:
        decisions.end()
    else:
        unmodelled.check()
        try:
            sample, is_whole = system.sample()
            check_determinism(system.ringlets, iter(sample))
            repeated = ringlets if is_whole else len(sample)
        except ENDINGS as error:
            decisions.end()
            decisions.short_of_memory |= isinstance(error, MemoryError)
    verdicts = tuple(decisions.verdicts(search))
    return Space(
        system,
        search,
        members,
        verdicts,
        decisions.seconds,
        ringlets=ringlets,
        repeated=repeated,
        complete=decisions.complete,
        cut=decisions.cut,
        short_of_memory=decisions.short_of_memory or search.out_of_memory,
    )


@contextmanager
def _seldom_collected() -> Iterator[None]:
    """Let garbage be looked for less often: what is kept is no garbage, and much is made."""
    young, *older = gc.get_threshold()
    gc.set_threshold(young and max(young, _YOUNG), *older)
    try:
        yield
    finally:
        gc.set_threshold(young, *older)


def verify(
    machines: Factory | Iterable[Factory | Member],
    *asked: Property,
    properties: Iterable[Property] = (),
    **how: Unpack[ExploreOptions],
) -> Space:
    """Explore as `explore` does, and raise `PropertyError` unless all properties hold.

    They are given one after the other, or as `properties`. That no machine's code raises is one of
    them. A property that is undecided does not hold.
    """
    given = [NO_FAILURE, *asked, *_check_properties(properties)]
    space = explore(machines, properties=given, **how)
    wrong = [verdict for verdict in space.verdicts if not verdict.holds]
    if wrong:
        hints = () if space.complete else space.hints()
        why = (
            "as code raises, and all ends there"
            if space.complete
            else "as not all states were found"
        )
        lines = chain(*(_lines(verdict, why) for verdict in wrong), hints)
        raise PropertyError("\n".join(lines), space.verdicts)
    return space


def _lines(verdict: Verdict, why: str) -> Iterator[str]:
    witness = verdict.witness
    if verdict.holds is None:
        yield f"{verdict.property}: undecided, {why}"
    elif witness is None:
        yield f"{verdict.property}: violated"
    else:
        yield f"{verdict.property}: violated after {len(witness.turns)} turns"
        lines = on_a_screen([*witness.lines()], lambda left: f"({left} more lines)")
        yield from (f"  {line}" for line in lines)


def _schedule(
    period_ms: float | None, timetable: Timetable | None, *, any_time: bool
) -> float | Timetable | None:
    if timetable is not None and period_ms is not None:
        raise OptionError("give period_ms or a timetable, not both")
    schedule = period_ms if timetable is None else timetable
    if any_time and schedule is not None:
        given = "period_ms" if timetable is None else "a timetable"
        raise OptionError(f"give {given}, or any_time=True")
    return schedule


def _time_model(
    schedule: float | Timetable | None,
    asked: list[Property],
    monitors: list[type[Machine]],
    *,
    skips: bool,
) -> TimeModel:
    if skips and not isinstance(schedule, int | float):
        raise OptionError("skips leaves out rounds of a period: give period_ms, too")
    if schedule is None:
        for prop in asked:
            if prop.within_ms is None and prop.kind in ("leads_to", "eventually_always"):
                raise OptionError(
                    f"{prop}: {prop.kind} needs a period (period_ms, --period-ms, or period_us in "
                    f"a file) or a timetable, as without one any time may pass, also none at all, "
                    f"and then nothing need follow; decide it by itself, and the rest at any time"
                )
        return AnyTime()
    timed = isinstance(schedule, Timetable)
    if not timed and not (isinstance(schedule, int | float) and 1e-6 <= schedule < inf):
        raise OptionError(f"period_ms is {schedule!r}; it must be a number, 1e-6 or more")
    for prop in asked:
        if skips and prop.within_ms is not None:
            raise OptionError(
                f"{prop}: with skips any response may be late, as any number of rounds is left "
                f"out; decide it without"
            )
    if isinstance(schedule, Timetable):
        return Slots(schedule, watching=[each.__name__ for each in monitors])
    return Periods(round(schedule * 1e6), skips=skips)


def _check_option(name: str, given: str, known: Iterable[str]) -> None:
    """Raise `OptionError` unless an option is one of those there are."""
    if given not in known:
        must = " or ".join(f'"{each}"' for each in known)
        raise OptionError(f"{name} is {given!r}; it must be {must}")


def _check_properties(properties: Iterable[Property]) -> list[Property]:
    if isinstance(properties, Property):
        properties = [properties]
    asked = list(properties)
    for prop in asked:
        if not isinstance(prop, Property):
            raise PredicateError(
                f"{prop!r} is not a property: make one with never, always, reachable or step"
            )
    return asked
