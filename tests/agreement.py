"""Random machines in random environments: what is explored agrees with the naive explorer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from hypothesis import assume, event, reject
from hypothesis import strategies as st

from llfsm.runtime.engine.kernel import OnError
from llfsm.runtime.engine.schedule import TimeSlot, Timetable
from llfsm.runtime.verification import (
    Region,
    UnsupportedError,
    always_possible,
    eventually_always,
    explore,
    leads_to,
    never,
    reachable,
)
from llfsm.whiteboard.messages.std_msgs import Int32
from naive_explorer import Explored, May, gaps_ns_of, naively_explored
from random_machines import FRESH, LEFT, MIXED, NAMES, RIGHT, SHARED, Ages, ages, built, specs

__all__ = [
    "DOMAINS",
    "Situation",
    "Turns",
    "assert_agreement",
    "situations",
    "timetable_of",
    "turns",
]

_ZERO_OR_ONE = [Int32(data=0), Int32(data=1)]
DOMAINS: dict[Any, list[Any]] = {LEFT: [None, *MIXED], RIGHT: _ZERO_OR_ONE}

Turns = list[tuple[int, int]]
Naively = Callable[[Mapping[str, Any]], bool]


class Situation(NamedTuple):
    """Machines, as `built` makes them, and how they run."""

    machines: Any
    unload_accepting: bool
    period_ms: int
    may: May
    on_error: OnError = "stop"
    ages: Ages = FRESH
    turns: Turns | None = None
    """If not None, when which machines have their turns, in the place of a period."""

    @property
    def timetable(self) -> Timetable | None:
        """Return their timetable."""
        return None if self.turns is None else timetable_of(self.turns, len(self.machines))


CYCLE_US = 12_000


def timetable_of(turns: Turns, machines: int) -> Timetable:
    """Return a timetable in which each machine has a turn at least."""
    each = [(number, start) for number, start in turns if number < machines]
    each += [(number, 0) for number in range(machines) if number not in dict(each)]
    slots = [TimeSlot(NAMES[number], ms * 1_000, CYCLE_US) for number, ms in each]
    return Timetable(sorted(slots, key=lambda slot: slot.start_us), CYCLE_US)


turns = st.lists(st.tuples(st.integers(0, 2), st.sampled_from([0, 3, 4, 10])), max_size=5)
situations = st.builds(
    Situation,
    specs,
    st.booleans(),
    st.sampled_from([5, 8, 10]),
    st.builds(May, st.booleans(), st.sets(st.just("A")), st.booleans()),
    st.sampled_from(["stop", "suspend"]),
    ages,
    st.none() | turns,
)


def assert_agreement(situation: Situation, *, most: int) -> None:
    """Compare counts, verdicts and the lengths of witnesses; leave out what has more states."""
    machines, may = built(situation.machines, situation.ages), situation.may
    timetable = situation.timetable
    how: dict[str, Any] = {
        **({"timetable": timetable} if timetable else {"period_ms": situation.period_ms}),
        "unload_accepting": situation.unload_accepting,
        "on_error": situation.on_error,
    }
    ours: dict[str, Any] = {
        "sensors": DOMAINS,
        "stop": may.stop,
        "suspend": may.suspend,
        "choices": "rounds" if may.by_rounds else "turns",
    }
    try:
        alone = explore(machines, max_states=most, **ours, **how)
    except UnsupportedError as error:
        if "in OnSuspend or OnResume" not in str(error):
            raise
        reject()
    assume(alone.complete)
    naive = naively_explored(machines, domains=DOMAINS, may=may, **how)
    event(f"{len(str(naive.states))} digits of states")
    assert (alone.states, alone.transitions) == (naive.states, naive.transitions)

    last = machines[-1].table
    where, name, first = last.states[-1].name, machines[-1].__name__, last.states[0].name
    sought: list[tuple[Callable[[Any], bool], Naively]] = [
        (lambda v: v[name].state == where, lambda view: view[f"{name}.state"] == where),
        (lambda v: v.A.n == 1, lambda view: view["A.n"] == 1),
        (lambda v: v[SHARED].data == 0, lambda view: view["shared"] == Int32(data=0)),
        (lambda v: v[name].has_failed, lambda view: view[f"{name}.has_failed"]),
    ]
    safety = [kind(of_view) for of_view, _ in sought for kind in (never, reachable)]
    depths = [
        _depth(naive, lambda state, n=of_naive: n(naive.views[state]))
        for _, of_naive in sought
        for _ in range(2)
    ]

    # Does whoever is not there come there, ever or in so much time?
    there, there_naively = sought[0]
    late = _late_naively(situation, naive, there_naively)
    answers = [leads_to(lambda v: not there(v), there, within_ms=ms) for ms in late]
    expected = [not each for each in late.values()]

    (asks, asks_naively), _, (response, response_naively), _ = sought
    recurring = (lambda v: v.A.n == 1, lambda v: v[name].state == first)
    naively: tuple[Naively, ...] = (
        lambda view: view["A.n"] == 1,
        lambda view: view[f"{name}.state"] == first,
    )
    answers += [leads_to(asks, response, assuming=recurring[:n]) for n in range(3)]
    asking = {state for state, view in naive.views.items() if asks_naively(view)}
    wrong = [naive.unanswered(response_naively, naively[:n]) for n in range(3)]
    expected += [asking.isdisjoint(each) for each in wrong]

    answers.append(leads_to(asks, [there, response]))
    in_turn = naive.unanswered_in_turn(there_naively, response_naively)
    expected.append(asking.isdisjoint(in_turn))

    # Does it stay so in the end, and can it always become so again?
    for of_view, of_naive in sought:
        answers += [eventually_always(of_view), always_possible(of_view)]
        restless = naive.unanswered(lambda _: False, [lambda view, n=of_naive: not n(view)])
        expected += [naive.first not in restless, not naive.hopeless(of_naive)]

    space = explore(machines, properties=[*safety, *answers], **ours, **how)
    for verdict, least in zip(space.verdicts, depths, strict=False):
        known = (least is None) == (verdict.property.kind == "never")
        assert verdict.holds is (None if naive.fails and least is None else known)
        assert (verdict.witness and len(verdict.witness.turns)) == least
    decided = [None if naive.fails and each else each for each in expected]
    assert [verdict.holds for verdict in space.verdicts[len(safety) :]] == decided
    for verdict, (_, of_naive) in zip(space.verdicts[-7::2], sought, strict=True):
        _assert_region(verdict.witness and verdict.witness.region, naive, of_naive)


def _late_naively(situation: Situation, naive: Explored, there: Naively) -> dict[float | None, Any]:
    """Find the states that do not come there ever, and in how many ms others do not."""
    late = {None: naive.unanswered(there)}
    if situation.timetable is None:
        return late | {n * situation.period_ms: naive.late(there, n) for n in range(5)}
    gaps_ns = gaps_ns_of(situation.timetable)
    bounds = (0, 4, 7, 12, 20) if _all_stay(naive) else ()
    return late | {ms: naive.late_by(there, ms * 10**6, gaps_ns) for ms in bounds}


def _all_stay(naive: Explored) -> bool:
    return all(each[5] for _, machines, *_ in naive.successors for each in machines)


def _assert_region(region: Region | None, naive: Explored, goal: Naively) -> None:
    hopeless = naive.hopeless(goal)
    assert (region is None) is (not hopeless)
    if region:
        assert region.turns == _depth(naive, hopeless.__contains__)
        assert region.states <= len(hopeless)


def _depth(naive: Explored, sought: Callable[[Any], bool]) -> int | None:
    """Return after how many turns a state that is sought can be reached first."""
    level, known, turns = {naive.first}, {naive.first}, 0
    while level:
        if any(sought(state) for state in level):
            return turns
        level = {after for state in level for after in naive.successors[state]} - known
        known |= level
        turns += 1
    return None
