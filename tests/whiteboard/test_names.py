"""Names of slots come and go: a record serves one name after the other, a message only one."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from llfsm.whiteboard import BoardVersionError, Slot, SlotNotFoundError, SlotTypeError, Whiteboard
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.messages.std_msgs import Int32, Int64
from own_boards import own_board
from thoroughness import examples
from waiting import PATIENCE_S

pytestmark = pytest.mark.compiler


@pytest.fixture
def board() -> Iterator[Whiteboard]:
    with own_board() as name, Whiteboard(name) as board:
        yield board


def numbered(number: int) -> Slot[Int64]:
    return Slot(f"name/{number}", Int64)


def names(board: Whiteboard) -> list[str]:
    return [info.name for info in board.slots()]


def test_two_thousand_names_take_the_room_of_one(board: Whiteboard) -> None:
    watch, seen = board.watcher(), []
    for number in range(2_000):
        slot = numbered(number)
        assert board.get_message(slot) is None
        assert board.add_message(slot, Int64(number)) == 1
        assert board.get_message(slot) == Int64(number)
        board.vacate(slot)
        if number == 10:
            size = board.path.stat().st_size
        if number % 200 == 0:
            seen += watch(0)
    assert board.path.stat().st_size == size
    assert names(board) == ["name/1999"]
    assert seen[-1] == "name/1800"


def test_what_was_bound_to_a_name_that_is_given_up_is_released(board: Whiteboard) -> None:
    """By slots of the same name, too; else a program with ever new names would grow."""
    slots = [numbered(1), numbered(1)]
    bound = board[slots[0]]
    assert board[slots[1]] is bound
    references = [weakref.ref(slot) for slot in slots]
    board.vacate(slots.pop())
    slots.clear()
    assert [reference() for reference in references] == [None, None]
    assert board[numbered(1)] is not bound


def test_a_handle_of_a_former_name_is_empty_and_makes_its_slot_anew(board: Whiteboard) -> None:
    old, new = board.publisher(numbered(1)), board.publisher(numbered(2))
    for number in range(3):
        old.add(Int64(number))
    board.vacate(numbered(2))
    board.vacate(numbered(1))
    other = board.publisher(numbered(3))  # takes the record of the first
    other.add(Int64(33))
    assert names(board) == ["name/3", "name/2"]
    assert (old.get(), old.sample(), old.encoded(), old.count, old.recent()) == (
        None, None, None, 0, [])  # fmt: skip
    assert old.wait(after=0, timeout=0) is None  # who waits makes it
    assert names(board) == ["name/3", "name/1"]
    assert (old.add(Int64(7)), old.count, old.get()) == (1, 1, Int64(7))
    assert [count for count, *_ in old.recent()] == [1]
    assert other.get() == Int64(33)
    assert new.get() is None
    assert new.add(Int64(8)) == 1
    assert names(board) == ["name/3", "name/1", "name/2"]


def test_a_handle_counts_what_others_add_to_its_name_in_other_room(board: Whiteboard) -> None:
    old = board.publisher(numbered(1))
    old.add(Int64(1))
    board.vacate(numbered(1))
    board.publisher(numbered(2)).add(Int64(2))  # takes its room
    again = board.publisher(numbered(1))
    for number in (1, 2):
        again.add(Int64(number))
        assert old.count == number


def test_a_slot_whose_name_is_damaged_is_listed_with_its_problem(board: Whiteboard) -> None:
    for number in (1, 2):
        board.publisher(numbered(number)).add(Int64(number))
    at = board.path.read_bytes().index(b"name/1")
    with board.path.open("r+b") as damaged:
        damaged.seek(at)
        damaged.write(b"same/1")
    first, second = board.slots()
    assert "damaged" in first.problem
    assert (second.name, second.problem) == ("name/2", "")


def test_the_living_are_those_that_nobody_has_given_up(board: Whiteboard) -> None:
    for number in (1, 2):
        board.publisher(numbered(number)).add(Int64(number))
    board.vacate(numbered(1))
    assert board.living() == ["name/2"]
    board[numbered(1)].reserve()
    assert sorted(board.living()) == ["name/1", "name/2"]


@pytest.mark.parametrize("kind", ["shared", "local"])
def test_a_handle_that_is_to_make_nothing_makes_nothing(board: Whiteboard, kind: str) -> None:
    either = board if kind == "shared" else LocalBoard()
    with pytest.raises(SlotNotFoundError, match="has no slot 'name/1'"):
        either.publisher(numbered(1), make=False)
    assert either.slots() == []
    either.add_message(numbered(1), Int64(1))
    assert either.publisher(numbered(1), make=False).get() == Int64(1)


@pytest.mark.parametrize("kind", ["shared", "local"])
def test_who_only_looks_takes_no_name_back(board: Whiteboard, kind: str) -> None:
    either = board if kind == "shared" else LocalBoard()
    with pytest.raises(SlotNotFoundError, match="has no slot 'name/1'"):
        either.present(numbered(1))
    own = either.publisher(numbered(1))
    own.add(Int64(1))
    assert either.present(numbered(1)) is either.present(numbered(1))
    assert either.present(numbered(1)).get() == Int64(1)
    if kind == "shared":
        either.vacate(numbered(1))
        looks = board.publisher(numbered(1), make=False)
        looks.reserve()
        assert board.living() == []
        own.reserve()  # the maker's
        assert board.living() == ["name/1"]
        board.vacate(numbered(1))
        board.publisher(numbered(2)).add(Int64(2))  # takes its room
        looks.reserve()
        assert board.living() == ["name/2"]


def test_adding_or_reserving_keeps_a_name_that_was_given_up(board: Whiteboard) -> None:
    for keep in (lambda bound: bound.add(Int64(2)), lambda bound: bound.reserve()):
        bound = board[numbered(1)]
        count = bound.add(Int64(1))
        board.vacate(numbered(1))
        keep(bound)
        board.publisher(numbered(2)).add(Int64(9))
        assert bound.count >= count
        assert bound.get() != Int64(9)
        assert names(board) == ["name/1", "name/2"]


def test_a_compare_and_swap_counts_from_the_beginning_of_the_name(board: Whiteboard) -> None:
    first = board.publisher(numbered(1))
    assert [first.add(Int64(1)), first.add(Int64(2))] == [1, 2]
    board.vacate(numbered(1))
    second = board.publisher(numbered(2))
    assert (second.add_after(Int64(3), 2), second.add_after(Int64(4), 0)) == (0, 1)
    assert first.add_after(Int64(5), 2) == 0
    assert second.get() == Int64(4)


def test_another_type_gets_a_record_of_its_own(board: Whiteboard) -> None:
    old = board.publisher(numbered(1))
    board.vacate(numbered(1))
    board.publisher(Slot("other", Int32)).add(Int32(1))
    assert names(board) == ["name/1", "other"]
    board.publisher(numbered(2))
    board.publisher(Slot("name/1", Int32)).add(Int32(5))
    with pytest.raises(SlotTypeError, match=r"'name/1' has another type by now.*bind it again"):
        old.add(Int64(1))
    with pytest.raises(SlotTypeError, match="another type by now"):
        old.get()


@pytest.mark.parametrize("many", [False, True])
def test_who_waits_for_a_name_gets_its_next_message(board: Whiteboard, many: bool) -> None:
    """The waiter sleeps in another thread while the record gets another name."""
    bound = board[numbered(1)]
    bound.add(Int64(1))
    bound.add(Int64(2))
    seen: dict[Any, int] = {bound: 2}
    got: list[object] = []

    def wait() -> None:
        if many:
            assert board.waiter().wait(seen, PATIENCE_S) == [bound]
            got.append(bound.get())
        else:
            sample = bound.wait(after=2, timeout=PATIENCE_S)
            got.append(None if sample is None else sample.message)

    thread = threading.Thread(target=wait)
    thread.start()
    with Whiteboard(board.name) as elsewhere:
        elsewhere.vacate(numbered(1))
        elsewhere.add_message(numbered(2), Int64(22))
        elsewhere.add_message(numbered(1), Int64(3))
        thread.join()
    assert got == [Int64(3)]


def test_a_forked_child_takes_no_record_that_its_parent_is_naming(board: Whiteboard) -> None:
    board.publisher(numbered(1))
    board.vacate(numbered(1))
    pid = os.fork()
    if not pid:
        try:
            os._exit(board.publisher(numbered(2)).add(Int64(2)) - 1)
        finally:
            os._exit(9)
    assert os.waitpid(pid, 0)[1] == 0
    assert board.get_message(numbered(2)) == Int64(2)
    assert names(board) == ["name/2"]


def test_a_board_of_the_former_protocol_is_named_as_such(board: Whiteboard, tmp_path: Path) -> None:
    """Its header as its version made it: only the version's number and the checksum differ."""
    data = bytearray(board.path.read_bytes())
    data[8] = 1
    total = 0xCBF29CE484222325
    for byte in data[:32]:
        total = (total ^ byte) * 0x100000001B3 % 2**64
    data[32:40] = total.to_bytes(8, "little")
    (tmp_path / "llfsm.old").write_bytes(data)
    with pytest.raises(BoardVersionError, match="made by another version of llfsm"):
        Whiteboard("old", directory=tmp_path)


class Names(RuleBasedStateMachine):
    """Two processes' boards, and a model: a name has a count and a message, or nothing."""

    some_name = st.integers(0, 5)
    which = st.integers(0, 1)

    def __init__(self) -> None:
        super().__init__()
        self.context = own_board()
        name = self.context.__enter__()
        self.boards = [Whiteboard(name), Whiteboard(name)]
        self.handles: dict[tuple[int, int], Any] = {}
        self.latest: dict[int, tuple[int, int]] = {}  # count and value
        self.vacant: set[int] = set()  # whose message is there, or lost
        self.values = iter(range(1, 10**6))

    @rule(which=which, number=some_name)
    def add(self, which: int, number: int) -> None:
        handle = self.handle(which, number)
        value = next(self.values)
        count = handle.add(Int64(value))
        before, _ = self.latest.get(number, (0, 0))
        allowed = {before + 1, 1} if number in self.vacant else {before + 1}
        assert count in allowed
        self.vacant.discard(number)
        self.latest[number] = count, value

    @rule(which=which, number=some_name)
    def vacate(self, which: int, number: int) -> None:
        self.boards[which].vacate(numbered(number))
        if number in self.latest:
            self.vacant.add(number)

    @rule(which=which, number=some_name)
    def drop(self, which: int, number: int) -> None:
        self.handles.pop((which, number), None)

    def handle(self, which: int, number: int) -> Any:
        if (which, number) not in self.handles:
            self.handles[which, number] = self.boards[which].publisher(numbered(number))
        return self.handles[which, number]

    @invariant()
    def handles_read_what_was_added_under_their_names(self) -> None:
        for (_, number), handle in self.handles.items():
            count, value = self.latest.get(number, (0, 0))
            sample = handle.sample()
            found = (0, 0) if sample is None else (sample.count, sample.message.data)
            assert found == (count, value) or (number in self.vacant and found == (0, 0))
            assert handle.count == found[0]

    @invariant()
    def no_name_is_listed_twice_and_there_is_no_record_too_many(self) -> None:
        listed = names(self.boards[0])
        assert len(listed) == len(set(listed)) <= 6

    def teardown(self) -> None:
        for board in self.boards:
            board.close()
        self.context.__exit__(None, None, None)


TestNames = Names.TestCase
TestNames.settings = settings(max_examples=examples(15), stateful_step_count=30, deadline=None)
