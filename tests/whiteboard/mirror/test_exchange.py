"""One host's part of mirroring: messages enter and leave, and missed ones are asked for."""

from __future__ import annotations

import gc
from collections.abc import Callable

import msgspec
import pytest

from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.llfsm import MIRROR
from llfsm.whiteboard.mirror.batches import Batch, Heartbeat, StateQuery, Version, decoder
from llfsm.whiteboard.mirror.store import VersionLog

from .part import NUMBER, Number, Part, Text, batch

MS = 1_000_000


def test_a_message_enters_with_its_slot() -> None:
    part = Part()
    part.exchange.receive_batch(batch(message=Number(5)))
    assert part.get() == Number(5)
    assert part.board[NUMBER].capacity == 64


def test_an_older_one_does_not_and_is_a_conflict() -> None:
    part = Part()
    part.exchange.receive_batch(batch(1, message=Number(5), time=100))
    part.now_ns += 10**9
    part.exchange.receive_batch(batch(2, message=Number(4), time=99, host=3))
    part.exchange.receive_batch(
        batch(3, message=Number(5), time=100)
    )  # known, which is not a conflict
    assert part.get() == Number(5)
    assert part.exchange.status().conflicts == 1


def test_of_one_time_the_larger_host_counts() -> None:
    for first, second in ((2, 3), (3, 2)):
        part = Part()
        part.exchange.receive_batch(batch(1, message=Number(first), host=first))
        part.now_ns += 10**9
        part.exchange.receive_batch(batch(1, message=Number(second), host=second))
        assert part.get() == Number(3)


class RacingVersionLog(VersionLog):
    """Lets something happen at the last moment before a message is added."""

    def __init__(self) -> None:
        self.race: Callable[[], object] | None = None

    def note(self, slot: str, count: int, writer: int, version: Version) -> None:
        race, self.race = self.race, None
        if race is not None:
            race()


@pytest.mark.parametrize(("ours", "wins"), [(10**12, False), (10**12 + 50, True)])
def test_an_add_between_look_and_add_is_compared(ours: int, wins: bool) -> None:
    """A process adds just before the daemon does: the newer of both stays, and leaves."""
    versions = RacingVersionLog()
    part = Part(versions=versions)
    part.now_ns = ours
    versions.race = lambda: part.board.add_message(NUMBER, Number(1))
    part.exchange.receive_batch(batch(message=Number(2), time=10**12 + 20))
    assert versions.race is None
    assert part.get() == Number(1 if wins else 2)
    assert bool(part.collect()) == wins


def test_a_listed_slot_enters_and_a_listed_slot_leaves() -> None:
    part = Part(enter=("robot/*", "number"), leave=("mine/*",))
    part.exchange.receive_batch(batch())
    part.exchange.receive_batch(batch(2, Slot("robot/arm/angle", Number)))
    assert [info.name for info in part.board.slots()] == ["number", "robot/arm/angle"]
    for name in ("mine/a", "yours/b"):
        part.board.add_message(Slot(name, Number), Number())
    (sent,) = part.collect()
    assert [value.slot for value in decoder(Batch).decode(sent).values] == ["mine/a"]
    (answer,) = part.exchange.reply(msgspec.msgpack.encode(StateQuery(())))
    assert [value.slot for value in decoder(Batch).decode(answer).values] == ["mine/a"]


def test_a_flood_on_one_slot_is_held_back_and_others_are_not() -> None:
    part, other = Part(), Slot("other", Number)
    for number in range(1, 1001):
        part.exchange.receive_batch(batch(number, message=Number(number), time=10**12 + number))
    assert part.board[NUMBER].count == 2
    part.exchange.receive_batch(batch(1001, other, Number(7)))
    assert part.get(other) == Number(7)
    assert part.exchange.status().held_back == 998
    due_ns = part.exchange.due_ns()
    assert due_ns is not None
    part.now_ns = due_ns
    part.exchange.enter_held()
    assert part.get() == Number(1000)
    assert part.board[NUMBER].count == 3
    part.now_ns += 10**9
    assert part.exchange.due_ns() is None


def test_of_what_is_held_back_the_newest_enters_in_whatever_order_they_come() -> None:
    part = Part()
    for number, time in enumerate((1, 2, 9, 7, 8), 1):
        part.exchange.receive_batch(batch(number, message=Number(time), time=10**12 + time))
    part.now_ns += 10**9
    part.exchange.enter_held()
    assert part.get() == Number(9)


def test_what_was_held_back_may_be_refused() -> None:
    part = Part()
    for number, message in enumerate((Number(1), Number(2), b"\xc1"), 1):
        part.exchange.receive_batch(batch(number, message=message, time=10**12 + number))
    assert part.refused() == {}
    part.now_ns += 10**9
    part.exchange.enter_held()
    assert part.refused() == {"from 0000000000000002: number": 1}
    assert part.get() == Number(2)


def test_what_comes_as_often_as_it_may_but_not_on_time_leaves_at_once() -> None:
    """Whatever the time between two is, if there are no more than the rate says."""
    part = Part()
    for step in range(100):
        part.now_ns += (9 if step % 2 else 11) * MS
        part.board.add_message(NUMBER, Number(step))
        assert len(part.collect()) == 1
    part.now_ns += 1 * MS  # but then there are
    part.board.add_message(NUMBER, Number(100))
    assert part.collect() == []


def test_a_thousand_ways_and_senders_fill_neither_memory_nor_the_status() -> None:
    part = Part(enter=())
    for number in range(1, 1001):
        slot = Slot(f"{'x' * 240}{number}", Number)
        part.exchange.receive_batch(batch(number, slot, host=number + 1))
        beat = Heartbeat(number + 1, 1, 1, 10**12, "y" * 255)
        part.exchange.receive_heartbeat(msgspec.msgpack.encode(beat))
    status = part.exchange.status()
    assert len(status.peers) == len(status.refused) == 50
    assert len(MIRROR.encoder.encode(status)) < MIRROR.capacity
    assert status.refused[0].what == "everything else"
    assert status.refused[0].count == 800


def test_a_batch_that_was_lost_is_asked_for() -> None:
    part = Part()
    part.exchange.receive_batch(batch(4, message=Number(1)))
    (question,) = part.exchange.queries()  # what was there before we knew each other
    assert part.exchange.queries() == []  # one at a time
    part.exchange.end_reply(question)
    part.exchange.receive_batch(batch(5, message=Number(1), time=10**12 + 1))
    assert part.exchange.queries() == []
    beat = Heartbeat(2, 1, 6, 10**12, "other")
    part.exchange.receive_heartbeat(msgspec.msgpack.encode(beat))  # number 6 has not come
    (question,) = part.exchange.queries()
    assert decoder(StateQuery).decode(question.data).known == (("number", Version(10**12 + 1, 2)),)
    assert part.exchange.status().peers[0].lost == 1
    part.now_ns += 10**9
    assert part.exchange.queries() == [question]  # no answer: once more


def test_a_reply_holds_what_is_newer_with_its_type() -> None:
    part = Part()
    part.exchange.receive_batch(batch(1, message=Number(5), time=10**12 + 7))
    known = StateQuery((("number", Version(10**12 + 6, 2)),))
    (answer,) = part.exchange.reply(msgspec.msgpack.encode(known))
    reply = decoder(Batch).decode(answer)
    assert [value.version.time for value in reply.values] == [10**12 + 7]
    assert reply.declarations[0].schema == NUMBER.schema
    known = StateQuery((("number", Version(10**12 + 7, 2)),))
    (answer,) = part.exchange.reply(msgspec.msgpack.encode(known))
    assert decoder(Batch).decode(answer).values == ()


def test_what_is_mirrored_is_not_read_by_that() -> None:
    """Nor does the mirror keep the handle with which somebody has read it."""
    part, other = Part(), Slot("other", Number)
    part.exchange.receive_batch(batch(message=Number(5)))
    part.board.add_message(other, Number(1))
    assert len(part.collect()) == 1
    assert part.board.read_slots() == set()
    for slot in (NUMBER, other):
        part.get(slot)
        part.board.forget(slot)
    gc.collect()
    assert part.board.read_slots() == set()


def test_a_rate_of_its_own_for_a_slot() -> None:
    part = Part(rates={"slow/*": 2.0})
    slow, fast = Slot("slow/map", Number), Slot("fast", Number)
    sent = {"slow/map": 0, "fast": 0}
    for step in range(200):
        for slot in (slow, fast):
            part.board.add_message(slot, Number(step))
        for data in part.collect():
            for value in decoder(Batch).decode(data).values:
                sent[value.slot] += 1
        part.now_ns += 10 * MS
    assert sent == {"slow/map": 4, "fast": 200}


def test_what_a_large_message_is_sent_with_is_not_delayed_by_it() -> None:
    part = Part()
    part.board.add_message(Slot("image", Text, capacity=1 << 20), Text("x" * 900_000))
    part.board.add_message(NUMBER, Number(1))
    first, second = [decoder(Batch).decode(data) for data in part.collect()]
    assert [value.slot for value in first.values] == ["number"]
    assert [value.slot for value in second.values] == ["image"]
    assert (first.number, second.number) == (1, 2)


def test_the_status_reports_the_rates_of_what_is_sent_and_received() -> None:
    part = Part()
    part.board.add_message(NUMBER, Number(1))
    sent = part.collect()
    received = [batch(1), batch(2, time=10**12 + 1)]
    for data in received:
        part.exchange.receive_batch(data)
    part.now_ns += 2 * 10**9
    status = part.exchange.status()
    assert (status.leave_rate, status.enter_rate) == (0.5, status.entered / 2)
    assert status.sent_rate == round(sum(map(len, sent)) / 2, 1)
    assert status.received_rate == round(sum(map(len, received)) / 2, 1)
    part.now_ns += 10**9
    status = part.exchange.status()
    assert (status.leave_rate, status.sent_rate, status.received_rate) == (0, 0, 0)
