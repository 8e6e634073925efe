"""The merge rule alone, over any history: boards agree, and none goes back."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from llfsm.whiteboard.mirror.batches import Version, succeed

HOSTS = 3
CLOCKS = st.lists(st.integers(-5, 5), min_size=HOSTS, max_size=HOSTS)
# An add on a host, or the delivery to a host of any message so far: late, again, in any order.
ADD = st.tuples(st.just("add"), st.integers(0, HOSTS - 1), st.integers(0, 3))
DELIVER = st.tuples(st.just("deliver"), st.integers(0, HOSTS - 1), st.integers(0, 50))
HISTORIES = st.lists(ADD | DELIVER, max_size=60)


@given(history=HISTORIES, skews=CLOCKS)
def test_boards_never_go_back_and_agree_when_all_is_delivered(
    history: list[tuple[str, int, int]], skews: list[int]
) -> None:
    boards: list[Version | None] = [None] * HOSTS
    messages: list[Version] = []
    now = 10
    for what, host, number in history:
        before = boards[host]
        if what == "add":
            now += number
            added = succeed(before, now + skews[host], host)
            assert before is None or added > before  # who adds replaces what is there
            boards[host] = added
            messages.append(added)
        elif messages:
            arrived = messages[number % len(messages)]
            if before is None or arrived > before:
                boards[host] = arrived
        assert before is None or (boards[host] or before) >= before
    assert len(set(messages)) == len(messages)  # no two messages share a version
    for host in range(HOSTS):
        for message in reversed(messages):
            boards[host] = max(boards[host] or message, message)
    assert set(boards) == {max(messages, default=None)}


def test_of_two_at_one_time_the_larger_host_wins() -> None:
    assert succeed(None, 5, 2) > succeed(None, 5, 1)
    assert succeed(None, 6, 1) > succeed(None, 5, 2)


def test_an_add_is_later_than_what_a_fast_clock_has_added() -> None:
    assert succeed(Version(1000, 7), 5, 1) == Version(1001, 1)
