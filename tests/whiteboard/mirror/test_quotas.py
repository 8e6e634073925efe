"""Quotas of another host: slots, shared memory, and the daemon's time."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from llfsm.whiteboard import Slot
from llfsm.whiteboard.messages.llfsm import QuotaStatus
from llfsm.whiteboard.mirror.batches import (
    Batch,
    Declaration,
    Heartbeat,
    StateQuery,
    Value,
    Version,
    decoder,
    footprint,
)

from .part import NUMBER, Number, Part, batch

SECOND = 10**9


def declare(part: Part, slot: Slot[Any], number: int = 1) -> None:
    part.exchange.receive_batch(batch(number, slot, Number(number)))


def taken(part: Part) -> QuotaStatus:
    (quota,) = part.exchange.status().quotas
    return quota


def of_capacity(number: int, capacity: int) -> Slot[Number]:
    return Slot(f"slot{number}", Number, capacity)


def test_a_host_makes_no_more_slots_than_its_quota_whatever_ids_it_claims() -> None:
    part = Part(quota={"slots": 3})
    for host in range(2, 8):
        part.exchange.receive_batch(batch(1, Slot(f"slot{host}", Number), host=host))
    assert [info.name for info in part.board.slots()] == ["slot2", "slot3", "slot4"]
    assert taken(part).slots == taken(part).max_slots == 3
    assert sum(part.refused().values()) == 3
    part.board.add_message(Slot("slot7", Number), Number(0))  # made here, it costs no quota
    part.now_ns += SECOND
    part.exchange.receive_batch(batch(2, Slot("slot7", Number), Number(7), host=7, time=2 * 10**12))
    assert part.get(Slot("slot7", Number)) == Number(7)


def test_a_host_takes_no_more_shared_memory_than_its_quota() -> None:
    slots = [of_capacity(number, 1000) for number in range(4)]
    each = footprint(Declaration("slot", 1000, slots[0].schema))
    assert each > 4000  # as each writer has four buffers
    part = Part(quota={"bytes": 3 * each - 1})
    for slot in slots:
        declare(part, slot)
    assert [info.name for info in part.board.slots()] == ["slot0", "slot1"]
    assert taken(part).bytes == 2 * each
    declare(part, of_capacity(5, 10))
    assert len(part.board.slots()) == 3


def test_a_quota_may_be_taken_to_the_last_byte() -> None:
    slots = [of_capacity(number, 1000) for number in range(3)]
    part = Part(quota={"bytes": 3 * footprint(Declaration("slot", 1000, slots[0].schema))})
    for slot in slots:
        declare(part, slot)
    assert len(part.board.slots()) == 3


def test_a_slot_that_cannot_be_made_is_tried_once_and_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Otherwise a host could occupy the daemon with bad schemas, which take long."""
    part, tried = Part(quota={"slots": 5}), []
    declare_slot = part.store.declare
    monkeypatch.setattr(part.store, "declare", lambda d: tried.append(d.slot) or declare_slot(d))
    for number in range(1, 50):
        name = f"odd{number % 4}"
        value = Value(name, 7, Version(10**12, 2), b"\x90")
        declaration = Declaration(name, 10, {"type": "nonsense"})
        data = Batch(2, 1, number, 10**12, (value,), (declaration,))
        part.exchange.receive_batch(msgspec.msgpack.encode(data))
    assert sorted(tried) == sorted(set(tried))
    assert len(tried) == taken(part).slots == 4
    assert taken(part).bytes == 0


def test_messages_over_the_rate_are_dropped_and_asked_for_later() -> None:
    slots = [Slot(f"slot{number:02}", Number) for number in range(60)]
    declared = Declaration("slot00", slots[0].capacity, slots[0].schema)
    cost = 2 + len(msgspec.msgpack.encode(declared)) // 64  # with the message
    part = Part(quota={"messages": 50 * cost})
    for number, slot in enumerate(slots, 1):
        declare(part, slot, number)
    for number in range(61, 300):
        part.exchange.receive_batch(batch(number, message=Number(number), time=10**12 + number))
    assert part.exchange.status().entered == 51
    assert taken(part).over_rate == 9 + 239
    part.now_ns += SECOND
    part.exchange.receive_batch(batch(300, message=Number(300), time=10**12 + 300))
    assert part.get() == Number(300)
    assert [query.source.host for query in part.exchange.queries()] == [2]
    assert part.exchange.status().peers[0].lost == 248


def test_the_rest_of_a_batch_over_the_rate_is_dropped() -> None:
    part = Part(quota={"messages": 100})
    values = [["", n] for n in range(4096)]
    head = [2, 1, 1, 10**12]
    part.exchange.receive_batch(msgspec.msgpack.encode([*head, values]))
    assert part.refused() == {"malformed message": 201}  # as it may be ahead, and in debt
    assert taken(part).over_rate == 1
    declarations = [["", n, "x" * 640] for n in range(4096)]
    part.now_ns += 10 * SECOND
    part.exchange.receive_batch(msgspec.msgpack.encode([*head, [], declarations]))
    assert part.refused()["malformed declaration"] == 19


def test_traffic_over_the_rate_is_dropped() -> None:
    part = Part(quota={"traffic": 10_000}, largest=1 << 20)
    large = Slot("large", Number, 1 << 16)
    for number in range(1, 30):
        message = Number(number, "x" * 20_000)
        part.exchange.receive_batch(batch(number, large, message, time=10**12 + number))
        part.now_ns += SECOND
    assert 10 <= part.board[large].count <= 16
    assert taken(part).over_rate == 29 - part.board[large].count


def test_what_a_host_makes_this_one_send_counts() -> None:
    part = Part(quota={"messages": 1000})
    for number in range(100):
        part.board.add_message(Slot(f"slot{number}", Number), Number(number))
    query = msgspec.msgpack.encode(StateQuery(()))
    replies = [part.exchange.reply(query) for _ in range(100)]
    assert sum(bool(reply) for reply in replies) == 11
    assert taken(part).over_rate == 89


def test_a_host_that_pretends_to_lose_messages_is_not_queried_all_the_time() -> None:
    part, queried = Part(quota={"messages": 1000}), 0
    for number in range(100):
        part.board.add_message(Slot(f"slot{number}", Number), Number(number))
    for number in range(1, 1000):
        beat = Heartbeat(2, number, number, 10**12, "liar")
        part.exchange.receive_heartbeat(msgspec.msgpack.encode(beat))
        for query in part.exchange.queries():
            part.exchange.end_reply(query)
            queried += 1
    assert queried == 11


def test_unknown_names_do_not_make_the_board_be_read_for_each(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    part, reads = Part(), []
    read = part.board.slots
    monkeypatch.setattr(part.board, "slots", lambda: reads.append(1) or read())
    values = tuple(Value(f"slot{n}", 1, Version(10**12, 2), b"\x90") for n in range(4096))
    part.exchange.receive_batch(msgspec.msgpack.encode(Batch(2, 1, 1, 10**12, values)))
    assert len(reads) == 1
    part.board.add_message(NUMBER, Number(1))
    part.now_ns += SECOND
    part.exchange.receive_batch(batch(2, message=Number(2), time=2 * 10**12, declare=False))
    assert part.get() == Number(2)


def test_a_batch_of_more_messages_than_a_board_has_slots_is_malformed() -> None:
    """And takes no memory for them."""
    part = Part()
    head = msgspec.msgpack.encode([2, 1, 1, 10**12])[1:]
    number = 10**6
    data = b"\x95" + head + b"\xdd" + number.to_bytes(4, "big") + bytes(number)
    part.exchange.receive_batch(data)
    assert part.refused() == {"malformed batch": 1}


def test_a_declaration_that_is_too_long_is_refused() -> None:
    part = Part()
    schema = {**NUMBER.schema, "description": "x" * (1 << 20)}
    value = Value("number", 7, Version(10**12, 2), b"\x90")
    data = Batch(2, 1, 1, 10**12, (value,), (Declaration("number", 10, schema),))
    part.exchange.receive_batch(msgspec.msgpack.encode(data))
    assert part.board.slots() == []
    assert part.refused() == {"a declaration that is too long": 1}


def test_a_message_of_another_type_than_declared_does_not_enter() -> None:
    part = Part()
    value = Value("number", 7, Version(10**12, 2), msgspec.msgpack.encode(Number(1)))
    declaration = Declaration("number", 64, NUMBER.schema)
    data = Batch(2, 1, 1, 10**12, (value,), (declaration,))
    part.exchange.receive_batch(msgspec.msgpack.encode(data))
    assert part.board[NUMBER].count == 0
    assert part.refused() == {"from 0000000000000002: number": 1}


def test_what_this_host_sends_is_within_what_another_accepts() -> None:
    sender, receiver = Part(1), Part(2)
    for number in range(500):
        sender.board.add_message(Slot(f"slot{number}", Number), Number(number, "x" * 200))
    for data in sender.collect():
        assert len(decoder(Batch).decode(data).values) <= 4096
        receiver.exchange.receive_batch(data)
    assert receiver.refused() == {}
    assert taken(receiver).over_rate == 0
    assert receiver.exchange.status().entered == 500
