"""Versions where the clock of a host is wrong, or is set."""

from __future__ import annotations

import msgspec
import pytest

from llfsm.whiteboard import Slot
from llfsm.whiteboard.mirror.batches import Batch, Heartbeat, Version, decoder

from .part import NUMBER, Number, Part, batch


def sent_versions(part: Part) -> list[Version]:
    batches = map(decoder(Batch).decode, part.collect())
    return [value.version for batch in batches for value in batch.values]


def test_a_version_from_far_ahead_does_not_close_its_slot(caplog: pytest.LogCaptureFixture) -> None:
    part = Part(ahead_s=60)
    bound = part.now_ns + 60 * 10**9
    for number, time in enumerate((2**62 - 1, bound + 1), 1):
        part.exchange.receive_batch(batch(number, message=Number(number), time=time))
    assert part.board[NUMBER].count == 0
    assert part.refused() == {"from 0000000000000002: ahead of this host's clock": 2}
    assert "days ahead of this host's clock" in caplog.text
    part.exchange.receive_batch(batch(3, message=Number(3), time=bound))
    assert part.get() == Number(3)
    part.board.add_message(NUMBER, Number(4))
    assert sent_versions(part) == [Version(bound + 1, 1)]


def test_what_was_from_too_far_ahead_is_asked_for_once_the_clock_is_set() -> None:
    """A robot without a clock of its own starts in the past, and is set later."""
    part = Part()
    part.set_ns = -(10**15)
    part.exchange.receive_batch(batch(1))
    (first,) = part.exchange.queries()
    part.exchange.end_reply(first)
    part.exchange.receive_batch(batch(2))
    assert part.board[NUMBER].count == 0
    assert part.exchange.queries() == []
    part.set_ns = 0
    assert [query.source.host for query in part.exchange.queries()] == [2]


def test_what_was_added_before_the_clock_was_set_back_holds_nobody_up() -> None:
    part, ahead_ns = Part(), 10**15
    part.set_ns = ahead_ns
    part.board.add_message(NUMBER, Number(1))
    part.board.add_message(Slot("other", Number), Number(1))
    assert min(sent_versions(part)).time > ahead_ns
    part.set_ns = 0
    part.now_ns += 10**9
    part.exchange.receive_batch(batch(1, message=Number(2), time=part.now_ns))
    assert part.get() == Number(2)
    part.board.add_message(Slot("other", Number), Number(3))
    assert sent_versions(part) == [Version(part.now_ns, 1)]


def test_a_host_that_restarts_with_its_clock_set_back_is_asked_for_what_it_lost() -> None:
    part = Part()

    def beat(born: int, number: int) -> list[int]:
        beat = Heartbeat(2, born, number, 10**12, "other")
        part.exchange.receive_heartbeat(msgspec.msgpack.encode(beat))
        queries = part.exchange.queries()
        for query in queries:
            part.exchange.end_reply(query)
        return [query.source.host for query in queries]

    assert beat(born=10**12, number=5) == [2]
    assert beat(born=10**11, number=3) == [2]  # its messages before this heartbeat
    assert beat(born=10**11, number=4) == [2]  # one batch was lost
    assert beat(born=10**11, number=4) == []
