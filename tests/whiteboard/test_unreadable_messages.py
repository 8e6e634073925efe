"""Subscriptions and streams of a slot with data that is not a message."""

from __future__ import annotations

import asyncio
import json
import os
import queue
from collections.abc import Callable
from pathlib import Path

import pytest

from llfsm.whiteboard import Message, MessageUnreadableError, Sample, Slot, Whiteboard
from waiting import PATIENCE_S, wait_for

_shm = pytest.importorskip("llfsm.whiteboard._shm", reason="the extension is hidden")


class Number(Message):
    value: int = 0


NUMBER = Slot("number", Number)
SLOTS = 33216 - 8 * 4096  # in the header, which is so long: offsets of records
WORD = 64  # in a record


@pytest.fixture
def add_junk(tmp_path: Path) -> Callable[[], int]:
    """Add what no decoder takes, as a program with an encoder of its own might."""

    def encode_into(_: Number, buffer: bytearray) -> None:
        buffer[:] = b"\xc1"

    core = _shm.Board(str(tmp_path / "llfsm.board"), True, -1)
    schema = json.dumps(NUMBER.schema, separators=(",", ":"))
    port = _shm.Port(
        core, NUMBER.name, NUMBER.type_name, schema, NUMBER.fingerprint, NUMBER.capacity,
        Number, (), encode_into, lambda _: Number(),
    )  # fmt: skip
    return lambda: port.add(Number())


@pytest.mark.parametrize("backlog", [1, 10])
def test_a_subscription_reports_it_once_and_goes_on(
    add_junk: Callable[[], int], tmp_path: Path, backlog: int, caplog: pytest.LogCaptureFixture
) -> None:
    received: queue.SimpleQueue[Sample[Number] | Exception] = queue.SimpleQueue()
    with Whiteboard("board", directory=tmp_path) as board:
        number = board[NUMBER]
        with number.subscribe(received.put, on_error=received.put, backlog=backlog) as subscription:
            for _ in range(3):
                count = add_junk()
                error = received.get(timeout=PATIENCE_S)
                assert isinstance(error, MessageUnreadableError)
                assert error.count == count
                assert f"that process {os.getpid()} wrote" in str(error)
                count = number.add(Number(count))
                sample = received.get(timeout=PATIENCE_S)
                assert isinstance(sample, Sample)
                assert sample.count == count
            assert subscription.missed == 3
    assert received.empty()
    assert len(caplog.records) == 3


def test_a_stream_raises_it_once_and_goes_on(add_junk: Callable[[], int], tmp_path: Path) -> None:
    async def main() -> None:
        with Whiteboard("board", directory=tmp_path) as board:
            async with board[NUMBER].stream() as stream:
                add_junk()
                with pytest.raises(MessageUnreadableError, match="is not a Number"):
                    await asyncio.wait_for(anext(stream), PATIENCE_S)
                board[NUMBER].add(Number(5))
                sample = await asyncio.wait_for(anext(stream), PATIENCE_S)
                assert sample.message == Number(5)
                assert stream.missed == 1

    asyncio.run(main())


def test_a_subscription_ends_if_the_slot_is_damaged(tmp_path: Path) -> None:
    """An error that no later message can mend is the end: reported once."""
    errors: queue.SimpleQueue[Exception] = queue.SimpleQueue()
    with Whiteboard("board", directory=tmp_path) as board:
        number = board[NUMBER]
        with number.subscribe(print, on_error=errors.put) as subscription:
            with board.path.open("r+b") as file:
                file.seek(SLOTS)
                file.seek(int.from_bytes(file.read(8), "little") + WORD)
                file.write((1 << 16 | 0xFFF << 4).to_bytes(8, "little"))  # a writer of no board
            assert "damaged" in str(errors.get(timeout=PATIENCE_S))
            wait_for(lambda: not subscription.active)
    assert errors.empty()
