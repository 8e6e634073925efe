"""By how much turns begin after they are due."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from llfsm.runtime import Arrangement, Machine, ManualClock, State


@given(st.lists(st.integers(0, 3_000), min_size=1, max_size=30))
def test_turns_are_as_late_as_those_before_them_were_long(costs_us: list[int]) -> None:
    """With a period of 1 ms, a turn begins late by what the ones before it took too long."""
    clock = ManualClock()
    left = iter(costs_us)

    class Long(Machine):
        a = State()
        b = State()

        @a.internal
        def _(self) -> None:
            clock.advance(us=next(left))

        a.to(b, when=lambda m: False)

    arrangement = Arrangement([Long], clock=clock, period_us=1000)
    arrangement.run(max_rounds=len(costs_us))
    late = [0]
    for cost_us in costs_us[:-1]:
        late.append(max(late[-1] + cost_us - 1000, 0))
    [found] = arrangement.statistics()
    assert found.late_us is not None
    assert found.late_us.max == max(late)
    assert sum(found.late_counts) == len(late)
    assert found.late_counts[0] == late.count(0)
