"""Whatever ends an exploration, and wherever: nothing is proved then."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Any

import pytest

from llfsm.runtime import State, define
from llfsm.runtime.verification import NO_FAILURE, Space, always, explore, leads_to, reachable
from llfsm.runtime.verification._ringlets import Deadline, TimeUpError

COUNTED = State("COUNTED")
COUNTED.internal(lambda self: setattr(self, "n", (self.n + 1) % 5))
COUNTED.to(COUNTED, when=lambda self: False)
M = define("M", [COUNTED], variables={"n": (int, 0)})
PROPERTIES = (
    NO_FAILURE,
    always(lambda v: v.M.n < 5, "small"),
    reachable(lambda v: v.M.n == 1, "counts"),
    leads_to(lambda v: v.M.n == 1, lambda v: v.M.n == 4, "goes on"),
    leads_to(lambda v: v.M.n == 1, lambda v: v.M.n == 4, "in time", within_ms=100),
)
"""All of which hold."""


def explored() -> Space:
    """Return the space of a machine that counts to 4 and begins again."""
    return explore(M, period_ms=10, properties=PROPERTIES, max_seconds=1e9)


class Looks:
    """Looks at the time, the one of a number ends the exploration."""

    def __init__(self, patch: pytest.MonkeyPatch, last: float, error: type[BaseException]):
        self.number = 0

        def check(_: Deadline) -> None:
            self.number += 1
            if self.number >= last:
                raise error

        patch.setattr(Deadline, "check", check)


@pytest.mark.parametrize("error", [KeyboardInterrupt, TimeUpError])
def test_nothing_is_proved_wherever_an_exploration_is_ended(
    monkeypatch: pytest.MonkeyPatch, error: type[BaseException]
) -> None:
    """There are looks at the time before each ringlet, also as it is repeated, and in a proof."""
    looks = Looks(monkeypatch, inf, error)
    assert all(verdict.holds for verdict in explored().verdicts)
    found = set()
    for last in (1, 2, 3, 5, 7, 12, looks.number // 2, *range(looks.number - 12, looks.number)):
        Looks(monkeypatch, last, error)
        space = explored()
        verdicts = [verdict.holds for verdict in space.verdicts]
        assert space.cut
        assert verdicts[-1] is None
        assert space.complete or verdicts[:2] == [None, None]
        found.add((space.complete, *verdicts))
    whole = (True, True, True)
    assert {(True, *whole, None, None), (True, *whole, True, None)} <= found
    assert {(False, None, None, None, None, None), (False, None, None, True, None, None)} <= found


def test_time_limits_hold_for_repetitions(monkeypatch: pytest.MonkeyPatch) -> None:
    def late(ringlets: Any, kept: Iterator[Any]) -> None:
        ringlets.deadline.at_s = 0
        ringlets.run_ringlet(next(kept)[0])

    monkeypatch.setattr("llfsm.runtime.verification._exploring.check_determinism", late)
    space = explored()
    assert (space.complete, space.cut) == (False, True)
    assert [each.holds for each in space.verdicts] == [None, None, True, None, None]
