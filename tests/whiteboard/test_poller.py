"""One poll reads all that has changed on a board, and a slot of nonsense is one slot."""

from __future__ import annotations

from pathlib import Path

import pytest

from llfsm.whiteboard import BoardClosedError, Message, Slot, SlotNotFoundError, Whiteboard
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.llfsm import (
    JournalPart,
    MachineStatus,
    journal_slot,
    status_slot,
)
from llfsm.whiteboard.messages.std_msgs import Bool, Int32
from llfsm.whiteboard.poller import BoardPoller, PolledSlot
from llfsm.whiteboard.schema import describe

from .conftest import OpenBoard

A, B = Slot("a", Int32), Slot("b", Bool)


class Odd(Message):
    """A message whose field, in another process, is something else."""

    value: int


def values(polled: list[PolledSlot]) -> dict[str, object]:
    return {each.name: each.sample and each.sample.message.data for each in polled}  # type: ignore[attr-defined]


def test_each_change_is_returned_once_with_the_newest_message(open_board: OpenBoard) -> None:
    board = open_board()
    board.add_message(A, Int32(1))
    poller = BoardPoller(board)
    assert values(poller.poll()) == {"a": 1}
    assert poller.poll() == []
    for number in range(2, 5):
        board.add_message(A, Int32(number))
    (polled,) = poller.poll()
    assert values([polled]) == {"a": 4}
    sample = board[A].sample()
    assert sample is not None
    assert polled.sample is not None
    assert polled.sample[1:] == sample[1:]
    assert (polled.count, polled.problem) == (4, "")
    assert poller.poll() == []


def test_a_new_slot_is_found_at_the_next_poll_and_is_there_before_its_first_message(
    open_board: OpenBoard,
) -> None:
    board = open_board()
    poller = BoardPoller(board)
    assert poller.poll() == []
    board[B]
    assert poller.poll() == []
    assert poller.slots["b"].sample is None
    assert poller.slots["b"].info.schema == B.schema
    board.add_message(A, Int32(7))
    board.add_message(B, Bool(True))
    assert values(poller.poll()) == {"b": True, "a": 7}
    assert [*poller.slots] == ["b", "a"]  # in the order in which they were made


def test_a_name_that_was_given_up_since_it_was_listed_is_not_made_anew() -> None:
    class Late(LocalBoard):
        """List a slot that is gone."""

        def slots(self) -> list[SlotInfo]:
            return [*super().slots(), SlotInfo("gone", A.type_name, A.schema, A.capacity)]

    board = Late()
    board.add_message(B, Bool(True))
    poller = BoardPoller(board)
    assert values(poller.poll()) == {"b": True}
    assert [*poller.slots] == ["b"]
    with pytest.raises(SlotNotFoundError):
        board.find("gone")


def test_new_slots_are_looked_for_at_an_interval_and_when_asked() -> None:
    board = Whiteboard.local()
    poller = BoardPoller(board, discovery_s=float("inf"))
    assert poller.poll() == []
    board.add_message(A, Int32(7))
    assert poller.poll() == []
    poller.discover()
    assert values(poller.poll()) == {"a": 7}


def test_journals_and_what_is_not_wanted_are_left_out() -> None:
    board = Whiteboard.local()
    board.add_message(A, Int32(7))
    board.add_message(B, Bool(True))
    board.add_message(journal_slot(0), JournalPart(1, 2, "", 0, 3, True, 0))
    assert values(BoardPoller(board).poll()) == {"a": 7, "b": True}
    assert values(BoardPoller(board, wants="b".__eq__).poll()) == {"b": True}
    everything = BoardPoller(board, wants=lambda _: True)
    assert [each.name for each in everything.poll()] == ["a", "b", journal_slot(0).name]


def test_machines_have_their_own_class_unless_the_slot_has_another_schema() -> None:
    board = Whiteboard.local()
    board.add_message(status_slot("M"), MachineStatus(state="s"))
    board.add_message(Slot("llfsm/machine/odd", Odd), Odd(3))
    ours, odd = BoardPoller(board).poll()
    assert ours.sample is not None
    assert ours.sample.message == MachineStatus(state="s")
    assert odd.sample is not None
    assert not isinstance(odd.sample.message, MachineStatus)
    assert odd.sample.message.value == 3  # type: ignore[attr-defined]


def test_slots_of_one_type_share_a_class() -> None:
    board = Whiteboard.local()
    for name in "xy":
        board.add_message(Slot(name, Odd), Odd(1))
    x, y = BoardPoller(board).poll()
    assert x.slot is not None
    assert y.slot is not None
    assert x.slot.type is y.slot.type


@pytest.mark.parametrize(
    "info",
    [
        SlotInfo("bad", "Bad", {}, 64, problem="its record is damaged"),
        SlotInfo("bad", "Bad", {"title": "Bad", "properties": {"a": {}}}, 64),
        SlotInfo("bad", "Bad", {"title": 7, "properties": {}}, 64),
        SlotInfo("no name", "Bad", describe(Odd), 64),
        SlotInfo("clash", "Bad", describe(Odd), 64),
        SlotInfo("clash", "Bad", describe(Odd), -1),
    ],
)
def test_a_slot_of_nonsense_is_one_slot(monkeypatch: pytest.MonkeyPatch, info: SlotInfo) -> None:
    board = Whiteboard.local()
    board.add_message(Slot("clash", Int32), Int32(1))
    board.add_message(A, Int32(7))
    good = [each for each in board.slots() if each.name == "a"]
    monkeypatch.setattr(board, "slots", lambda: [info, *good])
    poller = BoardPoller(board)
    bad, found = poller.poll()
    assert (bad.name, bad.slot, bad.sample) == (info.name, None, None)
    assert bad.problem
    assert values([found]) == {"a": 7}
    assert poller.poll() == []  # once


def test_a_message_of_nonsense_is_a_problem_until_the_next_one(tmp_path: Path) -> None:
    with Whiteboard("board", directory=tmp_path) as board:
        board.add_message(A, Int32(7))
        wrong = board.path.read_bytes().rindex(Slot("a", Int32).encoder.encode(Int32(7)))
        board.add_message(B, Bool(True))
        poller = BoardPoller(board)
        with board.path.open("r+b") as file:
            file.seek(wrong)
            file.write(b"\xc1")  # which MessagePack never uses
        polled = {each.name: each for each in poller.poll()}
        assert polled["a"].sample is None
        assert "Int32" in polled["a"].problem
        assert values([polled["b"]]) == {"b": True}
        assert poller.poll() == []
        board.add_message(A, Int32(8))
        (again,) = poller.poll()
        assert (values([again]), again.problem) == ({"a": 8}, "")


def test_a_closed_board_is_an_error_and_no_slots_problem(open_board: OpenBoard) -> None:
    board = open_board()
    board.add_message(A, Int32(7))
    poller = BoardPoller(board, discovery_s=float("inf"))
    poller.poll()
    board.close()
    with pytest.raises(BoardClosedError):
        poller.poll()
    with pytest.raises(BoardClosedError):
        poller.discover()
    assert poller.slots["a"].problem == ""


def test_a_removed_board_is_read_to_the_end(tmp_path: Path) -> None:
    with Whiteboard("board", directory=tmp_path) as board:
        poller = BoardPoller(board)
        with Whiteboard("board", directory=tmp_path) as other:
            other.add_message(A, Int32(7))
            other.remove()
        assert not board.alive
        assert values(poller.poll()) == {"a": 7}
