"""Any time between rounds: exact for one clock, and for several by what all clocks allow."""

from __future__ import annotations

from typing import Any

import pytest

from llfsm.runtime import Machine, State, define
from llfsm.runtime.counterexamples import replay
from llfsm.runtime.verification import (
    NO_FAILURE,
    Property,
    always_possible,
    eventually_always,
    explore,
    leads_to,
    never,
    reachable,
    step,
)


def waits(name: str, ms: int) -> type[Machine]:
    """Return a machine that goes from WAIT to DONE after a time, and stays."""
    wait, done = State("WAIT"), State("DONE")
    wait.to(done, after_ms=ms)
    done.to(wait, when=lambda self: False)
    return define(name, [wait, done])


SHORT, LONG = waits("Short", 100), waits("Long", 200)


def overtaken(v: object) -> bool:
    return v.Long.state == "DONE" and v.Short.state == "WAIT"  # type: ignore[attr-defined, no-any-return]


def decided(machines: list[type[Machine]], prop: Property) -> tuple[bool | None, list[float]]:
    """Return the verdict, and the times of the rounds of a witness that replays."""
    space = explore(machines, any_time=True, properties=[prop])
    (verdict,) = space.verdicts
    if verdict.witness is None:
        return verdict.holds, []
    views = replay(space, verdict.witness)
    end = len(verdict.witness.turns)
    views = views[end - 1 : end + 1] if prop.kind == "step" else views[end : end + 1]
    assert prop.functions[0](*views) is (prop.kind in ("never", "reachable"))
    return verdict.holds, list(dict.fromkeys(turn.time_ms for turn in verdict.witness.turns))


def test_a_way_that_only_unequal_clocks_allow_is_dropped() -> None:
    """Both wait from the same round on, and the short one has its turn first."""
    assert decided([SHORT, LONG], never(overtaken)) == (True, [])
    assert decided([SHORT, LONG], reachable(overtaken)) == (False, [])


def test_a_way_that_is_possible_has_times() -> None:
    """A nanosecond more than 200 ms must pass, and the long one has its turn first."""
    assert decided([LONG, SHORT], never(overtaken)) == (False, [0, 200.000001])


def test_a_dropped_way_is_replaced_by_a_possible_one() -> None:
    """The short one is done only if it has its turn before the long one, a round earlier."""
    only_short = step(
        lambda before, after: not (before.Short.state == "DONE" and before.Long.state == "WAIT")
    )
    assert decided([LONG, SHORT], only_short) == (False, [0, 100.000001])


def test_code_that_would_raise_on_such_a_way_only_does_not_raise() -> None:
    wait, done = State("WAIT"), State("DONE")
    wait.to(done, after_ms=200)
    wait.on_exit(lambda self: {"DONE": None}[self.state_name_of("Short")])
    done.to(wait, when=lambda self: False)
    careful = define("Careful", [wait, done])
    for machines, holds in (([SHORT, careful], True), ([careful, SHORT], False)):
        space = explore(machines, any_time=True, properties=[NO_FAILURE])
        assert space.verdicts[0].holds is holds


def test_the_states_do_not_depend_on_how_long_the_times_are() -> None:
    """They are: before the first turn, entered, done but not entered, and done."""
    assert {explore(waits("One", ms), any_time=True).states for ms in (1, 100, 10**9)} == {4}


def test_for_one_clock_it_finds_what_short_periods_find() -> None:
    quick, slow, end = State("QUICK"), State("SLOW"), State("END")
    quick.to(slow, after_ms=100)
    slow.to(end, when=lambda self: self.after_ms(300) and not self.after_ms(310))
    slow.to(quick, when=lambda self: self.after_ms(310))
    end.to(end)
    machine = define("Window", [quick, slow, end])
    prop = reachable(lambda v: v.Window.state == "END")
    assert explore(machine, period_ms=1, properties=[prop]).verdicts[0].holds
    assert not explore(machine, period_ms=20, properties=[prop]).verdicts[0].holds
    holds, times = decided([machine], prop)
    assert holds
    assert times == [0, 100.000001, 400.000002]


def test_without_a_period_any_time_may_pass() -> None:
    assert explore(SHORT).schedule == explore(SHORT, any_time=True).schedule
    with pytest.raises(ValueError, match="period_ms, or any_time"):
        explore(SHORT, period_ms=1, any_time=True)
    with pytest.raises(ValueError, match="leads_to needs a period"):
        explore(
            SHORT,
            any_time=True,
            properties=[leads_to(lambda v: True, lambda v: v.Short.state == "DONE")],
        )
    with pytest.raises(ValueError, match=r"eventually_always needs a period \(period_ms,"):
        explore(
            SHORT,
            any_time=True,
            properties=[eventually_always(lambda v: v.Short.state == "DONE")],
        )


def test_what_stays_possible_is_decided_for_one_clock_at_a_time() -> None:
    """With several, only what no clock allows is known not to be possible."""

    def done(machine: str) -> Property:
        return always_possible(lambda v: v[machine].state == "DONE")

    def waiting(machine: str) -> Property:
        return always_possible(lambda v: v[machine].state == "WAIT")

    machines: list[type[Machine]]
    for machines, holds in ([SHORT], True), ([SHORT, LONG], None):
        space = explore(machines, any_time=True, properties=[done("Short"), waiting("Short")])
        possible, impossible = space.verdicts
        assert possible.holds is holds
        assert impossible.holds is False
        assert impossible.witness is not None
        assert impossible.witness.region is not None
        views = replay(space, impossible.witness)
        assert views[impossible.witness.region.turns].Short.state == "DONE"


class Counting(Machine):
    """Counts its turns while it waits for 60 ms."""

    turns: int = 0
    wait, over = State(), State()

    @wait.internal
    def _(self) -> None:
        self.turns += 1

    wait.to(over, after_ms=60)


def turns_of(**how: Any) -> list[int]:
    """List the numbers of turns after which the wait can be over."""
    numbers = range(7)
    properties = [
        reachable(lambda v, n=n: v.Counting.state == "over" and v.Counting.turns == n)
        for n in numbers
    ]
    space = explore(Counting, properties=properties, max_states=99, **how)
    found = [n for n in numbers if space.verdicts[n].holds]
    for n in found:
        way = space.verdicts[n].witness
        assert way is not None
        assert replay(space, way)[-1].Counting.turns == n
    return found


def test_rounds_that_are_left_out_make_a_wait_of_fewer_turns() -> None:
    assert turns_of(period_ms=20) == [4]
    assert turns_of(period_ms=20, skips=True) == [1, 2, 3, 4]
    assert turns_of() == [1, 2, 3, 4, 5, 6]


def test_skips_need_a_period_and_no_time_limit() -> None:
    with pytest.raises(ValueError, match="give period_ms, too"):
        explore(SHORT, skips=True)
    late = leads_to(lambda v: True, lambda v: v.Short.state == "DONE", within_ms=10)
    with pytest.raises(ValueError, match="any response may be late"):
        explore(SHORT, period_ms=1, skips=True, properties=[late])
