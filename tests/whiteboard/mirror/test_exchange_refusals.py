"""Messages of another host that are refused, and without harm to others."""

from __future__ import annotations

import logging
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from llfsm.whiteboard import Slot
from llfsm.whiteboard.mirror.batches import Batch, Declaration, Value, Version
from thoroughness import examples

from .part import Number, Part, Text, batch


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


def test_a_message_that_is_none_is_refused() -> None:
    part = Part()
    part.exchange.receive_batch(batch(1, message=Number(5)))
    part.now_ns += 10**9
    for number, payload in enumerate((b"\xc1", b"\x90", b"\x92\xa1x\xa0", bytes(70)), 2):
        part.exchange.receive_batch(batch(number, message=payload, time=10**12 + number))
    assert part.get() == Number(5)
    assert part.refused() == {"from 0000000000000002: number": 4}
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
    assert [question.source.host for question in part.exchange.queries()] == [2]
    assert part.refused() == {}
    part.exchange.receive_reply(batch(0))
    part.exchange.receive_batch(batch(2, declare=False))
    assert part.refused() == {"from 0000000000000002: number": 2}
    (record,) = caplog.records
    assert "holds test/Text here, test/Number at the sender" in record.getMessage()
    assert "text (type:string)" in record.getMessage() or "value" in record.getMessage()
    assert part.get(Slot("number", Text)) == Text("mine")


def test_another_type_made_since_the_names_were_read_is_described(
    caplog: pytest.LogCaptureFixture,
) -> None:
    part = Part()
    part.exchange.receive_batch(batch(1, slot=Slot("another", Number)))  # now the names are read
    part.board.add_message(Slot("number", Text), Text("mine"))
    part.exchange.receive_batch(batch(2))
    (record,) = caplog.records
    assert "holds test/Text here, test/Number at the sender" in record.getMessage()
    assert part.get(Slot("number", Text)) == Text("mine")


@settings(max_examples=examples(100), deadline=None)
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


@settings(max_examples=examples(25), deadline=None, suppress_health_check=[HealthCheck.too_slow])
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
    assert [info.name for info in part.board.slots()] == ["slot3"]
    assert part.get(slots[3]) == Number(7)
    assert part.refused() == {"malformed message": 2, "malformed declaration": 1}
