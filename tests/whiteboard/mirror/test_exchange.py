"""How one host handles whatever another one sends, in virtual time and without a network."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.llfsm import MIRROR
from llfsm.whiteboard.mirror.batches import (
    Batch,
    Declaration,
    Heartbeat,
    StateQuery,
    Value,
    decoder,
)
from llfsm.whiteboard.mirror.exchange import Exchange
from llfsm.whiteboard.mirror.merge import Version
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.store import Store
from llfsm.whiteboard.mirror.version_log import NoVersionLog, VersionLog

MS = 1_000_000


class Number(Message, type_name="test/Number"):
    value: int = 0
    text: str = ""


class Text(Message, type_name="test/Text"):
    text: str = ""


NUMBER = Slot("number", Number, capacity=64)


class Part:
    """A host in a test."""

    def __init__(self, host: int = 1, versions: VersionLog | None = None, **settings: Any) -> None:
        self.now_ns = 10**12
        self.board = LocalBoard("board", now_ns=lambda: self.now_ns)
        self.watch = self.board.watcher()
        self.set_ns = 0  # by how much its clock was set
        chosen = Settings(**settings)
        wall_ns = lambda: self.now_ns + self.set_ns  # noqa: E731
        self.store = Store(
            self.board,
            host,
            lambda stamp_ns: stamp_ns + self.set_ns,
            versions or NoVersionLog(),
            lambda: wall_ns() + chosen.ahead_ns,
        )
        self.exchange = Exchange(self.store, chosen, lambda: self.now_ns, wall_ns)

    def collect(self) -> list[bytes]:
        return self.exchange.collect(self.watch(0))

    def get(self, slot: Slot[Any] = NUMBER) -> Any:
        return self.board.get_message(slot)

    def refused(self) -> dict[str, int]:
        return {refusal.what: refusal.count for refusal in self.exchange.status().refused}


def batch(
    number: int = 1,
    slot: Slot[Any] = NUMBER,
    message: Message | bytes | None = None,
    *,
    time: int = 10**12,
    host: int = 2,
    declare: bool = True,
) -> bytes:
    """What another host sends."""
    payload = (
        message if isinstance(message, bytes) else msgspec.msgpack.encode(message or slot.type())
    )
    declaration = Declaration(slot.name, slot.capacity, slot.schema)
    value = Value(slot.name, slot.fingerprint, Version(time, host), payload)
    return msgspec.msgpack.encode(
        Batch(host, 1, number, time, (value,), (declaration,) if declare else ())
    )


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


class RacingVersionLog(NoVersionLog):
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


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"enter": ("robot/*",)}, "not listed"),
        ({"read_only": True}, "the board is read-only"),
    ],
)
def test_what_may_not_enter_is_refused_counted_and_reported_once(
    settings: dict[str, Any], reason: str, caplog: pytest.LogCaptureFixture
) -> None:
    part = Part(**settings)
    for number in range(1, 20):
        part.exchange.receive_batch(batch(number, time=10**12 + number))
    assert part.board.slots() == []
    assert part.refused() == {f"{reason}: number": 19}
    assert [r.getMessage() for r in caplog.records] == [f"refused: slot 'number': {reason}"]


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


def test_a_message_that_is_none_is_refused() -> None:
    part = Part()
    part.exchange.receive_batch(batch(1, message=Number(5)))
    part.now_ns += 10**9
    for number, payload in enumerate((b"", b"\xc1", b"\x90", b"\x92\xa1x\xa0", bytes(70)), 2):
        part.exchange.receive_batch(batch(number, message=payload, time=10**12 + number))
    assert part.get() == Number(5)
    assert part.refused() == {"from 0000000000000002: number": 5}
    part.exchange.receive_batch(batch(9, message=Number(6), time=10**12 + 9))
    assert part.get() == Number(6)


def test_a_slot_that_is_too_large_is_refused() -> None:
    part = Part(largest=1000)
    part.exchange.receive_batch(batch(slot=Slot("number", Number, capacity=1001)))
    assert part.board.slots() == []
    assert part.refused() == {"from 0000000000000002: number": 1}


@pytest.mark.parametrize(
    "schema", [{}, {"type": "object"}, {"title": "X", "type": "object", "properties": 3}]
)
def test_a_slot_whose_schema_is_none_is_refused(schema: dict[str, Any]) -> None:
    part = Part()
    value = Value("odd", 7, Version(10**12, 2), b"\x90")
    data = Batch(2, 1, 1, 10**12, (value,), (Declaration("odd", 10, schema),))
    part.exchange.receive_batch(msgspec.msgpack.encode(data))
    assert part.board.slots() == []
    assert sum(part.refused().values()) == 1


def test_another_type_is_refused_with_both_described(caplog: pytest.LogCaptureFixture) -> None:
    part = Part()
    part.board.add_message(Slot("number", Text), Text("mine"))
    part.exchange.receive_batch(batch(1, declare=False))  # its sender is asked what it is
    assert [question.host for question in part.exchange.queries()] == [2]
    assert part.refused() == {}
    part.exchange.receive_reply(batch(0))
    part.exchange.receive_batch(batch(2, declare=False))
    assert part.refused() == {"from 0000000000000002: number": 2}
    (record,) = caplog.records
    assert "holds test/Text here, test/Number at the sender" in record.getMessage()
    assert "text (type:string)" in record.getMessage() or "value" in record.getMessage()
    assert part.get(Slot("number", Text)) == Text("mine")


@settings(max_examples=300, deadline=None)
@given(data=st.binary(max_size=200))
def test_no_bytes_do_harm(data: bytes) -> None:
    logging.getLogger("llfsm.mirror").disabled = True
    part = Part()
    part.exchange.receive_batch(batch(message=Number(5)))
    part.exchange.receive_batch(data)
    part.exchange.receive_heartbeat(data)
    part.exchange.receive_reply(data)
    part.exchange.reply(data)
    assert part.get() == Number(5)
    logging.getLogger("llfsm.mirror").disabled = False


SCALARS = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.text() | st.binary()
ANYTHING = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.text(), inner, max_size=3),
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(values=st.lists(ANYTHING, max_size=7), schema=st.dictionaries(st.text(), ANYTHING))
def test_nothing_that_is_encoded_does_harm(values: list[Any], schema: dict[str, Any]) -> None:
    logging.getLogger("llfsm.mirror").disabled = True
    part = Part()
    for data in (values, [2, 1, 1, 5, [values]], [2, 1, 1, 5, [], [["s", 5, schema]]],
                 [2, 1, 1, 5, [["s", 1, 5, 2, b"\x90"]], [["s", 5, schema]]]):  # fmt: skip
        encoded = msgspec.msgpack.encode(data)
        part.exchange.receive_batch(encoded)
        part.exchange.receive_heartbeat(encoded)
        part.exchange.reply(encoded)
    part.exchange.receive_batch(batch(message=Number(5)))
    assert part.get() == Number(5)
    logging.getLogger("llfsm.mirror").disabled = False


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


def test_a_bad_message_of_a_batch_does_not_take_the_others_with_it() -> None:
    """Nor does a bad declaration, whatever is wrong with it."""
    part, slots = Part(), [Slot(f"slot{i}", Number) for i in range(4)]
    values: list[Any] = [
        [slot.name, slot.fingerprint, [10**12, 2], msgspec.msgpack.encode(Number(7))]
        for slot in slots
    ]
    declarations: list[Any] = [[slot.name, 64, slot.schema] for slot in slots]
    values[0][2] = [2**62, 2]
    values[1] = ["", 5]
    declarations[2][1] = -1
    data = [2, 1, 1, 10**12, values, declarations]
    part.exchange.receive_batch(msgspec.msgpack.encode(data))
    assert [part.get(slot) for slot in slots if part.store.has(slot.name)] == [Number(7)]
    assert part.refused() == {"malformed message": 2, "malformed declaration": 1}


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
    assert [query.host for query in part.exchange.queries()] == [2]


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


def test_a_host_that_restarts_with_its_clock_set_back_is_asked_for_what_it_lost() -> None:
    part = Part()

    def beat(born: int, number: int) -> list[int]:
        beat = Heartbeat(2, born, number, 10**12, "other")
        part.exchange.receive_heartbeat(msgspec.msgpack.encode(beat))
        queries = part.exchange.queries()
        for query in queries:
            part.exchange.end_reply(query)
        return [query.host for query in queries]

    assert beat(born=10**12, number=5) == [2]
    assert beat(born=10**11, number=3) == [2]  # its messages before this heartbeat
    assert beat(born=10**11, number=4) == [2]  # one batch was lost
    assert beat(born=10**11, number=4) == []


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
