"""A board without room for all machines shows those for which there is room."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from llfsm.runtime import Actuator, Arrangement, Machine, Reason, State
from llfsm.whiteboard import BoardFullError, Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import (
    BELL,
    RECORDER,
    VIEWER,
    definition_slot,
    request_slot,
    status_slot,
    variables_slot,
    will_slot,
)
from llfsm.whiteboard.messages.std_msgs import Bool

SHARED = (BELL, VIEWER, RECORDER)
STATE_SLOTS = (status_slot, request_slot)


class Busy(Machine):
    on: bool = False

    a, b = State(), State()
    a.to(b, when=lambda m: True)
    b.to(a, when=lambda m: True)


class A(Busy):
    pass


class B(Busy):
    pass


class Fails(Machine):
    a = State()

    @a.internal
    def _(self) -> None:
        raise ValueError("broken")

    a.to(a, when=lambda m: False)


class Stops(Busy):
    stop = Actuator(Slot("stop", Bool), at_failure=Bool(True))


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Whiteboard]:
    with Whiteboard("board", directory=tmp_path) as board:
        yield board


def fill(board: Whiteboard, *kept: Slot) -> None:
    """Make these slots, and then all others that there is room for."""
    for slot in kept:
        board.publisher(slot).reserve()
    made = 0
    while True:
        try:
            board.publisher(Slot(f"other{made}", Bool, capacity=1))
        except BoardFullError:
            break
        made += 1
    assert made


def run(board: Whiteboard, *machines: type[Machine], rounds: int = 5, **options: str) -> Reason:
    return Arrangement(machines, whiteboard=board, **options).run(max_rounds=rounds)


def published(board: Whiteboard, name: str) -> int:
    """Return how many statuses a machine has published; 0 if it has no slot for them."""
    names = {info.name for info in board.slots()}
    slot = status_slot(name)
    return board[slot].count if slot.name in names else 0


def test_one_machine_without_room_hides_no_other(
    board: Whiteboard, caplog: pytest.LogCaptureFixture
) -> None:
    fill(board, *SHARED, *(slot("B") for slot in STATE_SLOTS))
    assert run(board, A, B) is Reason.MAX_ROUNDS
    assert (published(board, "A"), published(board, "B") > 0) == (0, True)
    assert board.get_message(status_slot("B")).loaded is False  # at the end, as always
    assert caplog.text.count("A cannot be published on the whiteboard") == 1
    assert caplog.text.count("B is published without its diagram") == 1
    assert "B cannot be published" not in caplog.text


def test_without_room_for_anything_machines_run_unpublished(
    board: Whiteboard, caplog: pytest.LogCaptureFixture
) -> None:
    fill(board)
    assert run(board, A, B) is Reason.MAX_ROUNDS
    assert caplog.text.count("machines cannot be published on the whiteboard") == 1


def test_without_room_for_its_will_a_machine_is_published_and_it_is_logged(
    board: Whiteboard, caplog: pytest.LogCaptureFixture
) -> None:
    slots = [slot("Stops") for slot in (*STATE_SLOTS, definition_slot, variables_slot)]
    fill(board, *SHARED, *slots, Slot("stop", Bool))
    assert run(board, Stops) is Reason.MAX_ROUNDS
    assert published(board, "Stops")
    assert caplog.text.count("Stops has no last will") == 1


def test_a_machine_that_is_hidden_leaves_no_last_will(board: Whiteboard) -> None:
    fill(board, *SHARED, status_slot("Stops"), will_slot("Stops"), Slot("stop", Bool))
    assert run(board, Stops) is Reason.MAX_ROUNDS
    will = board.get_message(will_slot("Stops"))
    assert will is None or will.state == "withdrawn"


def test_nobody_can_resume_a_hidden_machine_so_its_failure_ends_the_run(board: Whiteboard) -> None:
    fill(board, *SHARED, *(slot("B") for slot in STATE_SLOTS))

    class Ends(Machine):
        a, b = State(), State()
        a.to(b, when=lambda m: True)

    assert Arrangement([Fails, Ends], whiteboard=board, on_error="suspend").run() is Reason.FAILED
