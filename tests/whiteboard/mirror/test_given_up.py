"""Names that are given up on one host: they leave the others, and nothing grows with them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import msgspec
import pytest

from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.mirror.batches import Batch, StateQuery, Value, Version, decoder
from llfsm.whiteboard.mirror.groups import ENDED
from llfsm.whiteboard.shared import Board

from .part import NUMBER, Number, Part, batch


def numbered(number: int) -> Slot[Number]:
    return Slot(f"jobs/{number}", Number, capacity=64)


class SharedPart(Part):
    """A host whose board is in shared memory, where names are given up for others."""

    def __init__(self, folder: Path, host: int, **settings: object) -> None:
        super().__init__(host, **settings)
        self.board = self.store.board = Whiteboard(f"b{host}", directory=folder)  # type: ignore[assignment]
        self.watch = self.board.watcher()

    def living(self) -> set[str]:
        board: Board = self.board
        return set(board.living())

    def ends(self) -> list[bytes]:
        return [packet.data for packet in self.exchange.ends()]


@contextmanager
def parts(folder: Path, **settings: object) -> Iterator[tuple[SharedPart, SharedPart]]:
    ours, theirs = SharedPart(folder, 1), SharedPart(folder, 3, **settings)
    with closing(ours.board), closing(theirs.board):
        yield ours, theirs


def send(from_: SharedPart, to: SharedPart) -> None:
    for data in from_.collect() + from_.ends():
        to.exchange.receive_batch(data)


def test_a_name_that_is_given_up_leaves_the_other_host(tmp_path: Path) -> None:
    with parts(tmp_path) as (ours, theirs):
        ours.board.add_message(NUMBER, Number(1))
        send(ours, theirs)
        assert theirs.living() == {"number"}
        ours.board.vacate(NUMBER)
        send(ours, theirs)
        assert theirs.living() == ours.living() == set()
        assert theirs.ends() == []  # it is not reported again by who received it


def test_a_later_add_takes_the_name_back_on_both(tmp_path: Path) -> None:
    with parts(tmp_path) as (ours, theirs):
        for value in (1, 2, 3):
            ours.board.add_message(NUMBER, Number(value))
            send(ours, theirs)
            assert theirs.get() == Number(value)
            ours.board.vacate(NUMBER)
            send(ours, theirs)


def test_a_message_that_is_newer_than_the_end_stays(tmp_path: Path) -> None:
    with parts(tmp_path) as (ours, theirs):
        ours.board.add_message(NUMBER, Number(1))
        send(ours, theirs)
        ours.board.vacate(NUMBER)
        theirs.now_ns += 1
        theirs.board.add_message(NUMBER, Number(2))
        send(ours, theirs)
        assert "number" in theirs.living()
        send(theirs, ours)
        assert ours.get() == Number(2)
        assert "number" in ours.living()


def test_a_lost_report_is_made_up_for_by_a_query(tmp_path: Path) -> None:
    """Also when the name's room has another name by then, and the daemon was started again."""
    with parts(tmp_path) as (ours, theirs):
        ours.board.add_message(NUMBER, Number(1))
        send(ours, theirs)
        ours.board.vacate(NUMBER)
        ours.board.add_message(numbered(1), Number(1))
        ours.ends()
        query = theirs.exchange.query_for_all().data
        for data in ours.exchange.reply(query):
            theirs.exchange.receive_reply(data)
        assert theirs.living() == {"jobs/1"}
        assert ours.exchange.reply(theirs.exchange.query_for_all().data) != []
        values = decoder(Batch).decode(ours.exchange.reply(query, group=ENDED)[0]).values
        assert [value.slot for value in values] == ["number"]


def test_a_message_that_comes_back_to_its_host_does_not_revive_the_name(tmp_path: Path) -> None:
    with parts(tmp_path) as (ours, theirs):
        ours.board.add_message(NUMBER, Number(1))
        send(ours, theirs)
        ours.board.vacate(NUMBER)
        ours.board.add_message(numbered(1), Number(1))
        ours.collect()
        for data in theirs.exchange.reply(ours.exchange.query_for_all().data):
            ours.exchange.receive_reply(data)
        assert ours.living() == {"jobs/1"}


def test_of_a_message_of_another_host_only_that_one_reports_the_end(tmp_path: Path) -> None:
    with parts(tmp_path) as (ours, _):
        query = msgspec.msgpack.encode(StateQuery((("elsewhere", Version(1, 7)),)))
        values = decoder(Batch).decode(ours.exchange.reply(query)[0]).values
        assert values == ()


@pytest.mark.parametrize(
    "settings", [{"enter": ["other"]}, {"read_only": True}, {"access": {"robot": ["other"]}}]
)
def test_who_may_not_add_may_not_end(tmp_path: Path, settings: dict[str, object]) -> None:
    with parts(tmp_path, **settings) as (_, theirs):
        theirs.board.add_message(NUMBER, Number(1))
        theirs.collect()
        end = Value("number", 0, Version(2 * 10**12, 5), b"")
        theirs.exchange.receive_batch(
            msgspec.msgpack.encode(Batch(5, 1, 1, 10**12, (end,))), "robot"
        )
        assert theirs.living() == {"number"}


def test_a_message_that_the_report_has_passed_does_not_take_the_name_back(tmp_path: Path) -> None:
    """As an answer to a query may: it is made before the name's end, and arrives after it."""
    with parts(tmp_path) as (ours, theirs):
        ours.board.add_message(NUMBER, Number(1))
        (message,) = ours.collect()
        ours.board.vacate(NUMBER)
        for data in (*ours.ends(), message):
            theirs.exchange.receive_batch(data)
        assert theirs.living() == set()
        ours.now_ns += 1
        ours.board.add_message(NUMBER, Number(2))
        send(ours, theirs)
        assert theirs.get() == Number(2)


def test_what_is_added_after_an_end_is_newer_whatever_the_clocks(tmp_path: Path) -> None:
    with parts(tmp_path) as (_, theirs):
        theirs.board.add_message(NUMBER, Number(1))
        (data,) = theirs.collect()
        before = decoder(Batch).decode(data).values[0].version
        end = Version(before.time + 10**10, 5)  # of a host whose clock is ahead
        ended = Batch(5, 1, 1, end.time, (Value("number", 0, end, b""),))
        theirs.exchange.receive_batch(msgspec.msgpack.encode(ended))
        assert theirs.living() == set()
        theirs.board.add_message(NUMBER, Number(2))
        (data,) = theirs.collect()
        assert decoder(Batch).decode(data).values[0].version > end


def test_a_message_that_is_held_back_does_not_take_the_name_back(tmp_path: Path) -> None:
    with parts(tmp_path) as (_, theirs):
        for number, payload in enumerate((Number(1), Number(2), Number(3), Number(4), b""), 1):
            time = 10**12 + min(number, 4)
            theirs.exchange.receive_batch(batch(number, message=payload, time=time))
        assert theirs.exchange.status().held_back > 0
        theirs.now_ns += 10**9
        theirs.exchange.enter_held()
        assert theirs.living() == set()


def test_an_end_too_far_ahead_is_refused(tmp_path: Path) -> None:
    with parts(tmp_path) as (_, theirs):
        theirs.exchange.receive_batch(batch(1))
        theirs.exchange.receive_batch(batch(2, message=b"", time=10**15))
        assert theirs.living() == {"number"}


def test_a_life_of_names_takes_the_room_and_the_quota_of_those_that_live(tmp_path: Path) -> None:
    with parts(tmp_path, quota={"slots": 20}) as (ours, theirs):
        for number in range(2000):
            ours.board.add_message(numbered(number), Number(number))
            if number >= 10:
                ours.board.vacate(numbered(number - 10))
            ours.now_ns = theirs.now_ns = ours.now_ns + 10**8
            send(ours, theirs)
            assert theirs.get(numbered(number)) == Number(number)
        assert theirs.refused() == {}
        for part in (ours, theirs):
            assert len(part.living()) == 10
            assert len(part.board.slots()) < 20
            status = part.exchange.status()
            assert status.slots == 10
        (quota,) = theirs.exchange.status().quotas
        assert quota.slots < 20


def test_room_of_another_type_is_not_given_back(tmp_path: Path) -> None:
    """Its memory stays taken: who makes slots of many types fills the board, whatever it ends."""
    with parts(tmp_path, quota={"slots": 5}) as (_, theirs):
        for number in range(8):
            slot = Slot(f"jobs/{number}", Number, capacity=64 + 8 * number)
            theirs.exchange.receive_batch(batch(2 * number + 1, slot))
            theirs.exchange.receive_batch(batch(2 * number + 2, slot, b""))
        assert theirs.living() == set()
        assert len(theirs.board.slots()) == 5
