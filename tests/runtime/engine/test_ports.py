"""Sensors give one snapshot per ringlet; actuators post at once, and once more at the end."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import pytest

from llfsm.runtime import (
    Actuator,
    Arrangement,
    ExecutionError,
    LoadError,
    Machine,
    ManualClock,
    NotLoadedError,
    Reason,
    Sensor,
    State,
)
from llfsm.whiteboard import Message, Slot, Whiteboard


class Number(Message):
    value: int = 0


SENSED = Slot("sensed", Number)
POSTED = Slot("posted", Number)
STOP = Number(value=-1)


class Echo(Machine):
    """Note what is sensed in each piece of code, and add one to it in between."""

    number = Sensor(SENSED)
    sure = Sensor(SENSED, default=Number(value=7))
    post = Actuator(SENSED)
    seen: list[int | None] = []  # noqa: RUF012

    a = State()
    b = State()
    asleep = State(suspend=True)

    def note(self) -> None:
        value = None if self.number is None else self.number.value
        self.seen.append(value)
        self.post(Number(value=(value or 0) + 1))

    @a.on_entry
    @a.on_exit
    @a.internal
    @a.on_suspend
    @asleep.internal
    @asleep.on_entry
    def noting(self) -> None:
        self.note()

    @a.to(b)
    def seen_enough(self) -> bool:
        self.note()
        return len(self.seen) > 5


@pytest.fixture
def board() -> Whiteboard:
    return Whiteboard.local()


def test_all_code_of_a_ringlet_sees_one_snapshot(board: Any):
    echo = Echo()
    arrangement = Arrangement([echo], whiteboard=board)
    arrangement.round()
    assert echo.seen == [None, None, None]  # OnEntry, guard, Internal
    arrangement.round()
    assert echo.seen[3:] == [1, 1]  # guard, Internal
    arrangement.round()
    assert echo.seen[5:] == [2, 2]  # guard, OnExit


def test_the_snapshot_is_the_same_object_while_nothing_is_added(board: Any):
    class Look(Machine):
        number = Sensor(SENSED)
        a = State()
        a.to(a, when=lambda m: False)

    look = Look()
    arrangement = Arrangement([look], whiteboard=board)
    board.add_message(SENSED, Number(value=1))
    arrangement.round()
    first = look.number
    arrangement.round()
    assert look.number is first


def test_a_default_stands_in_before_the_first_message(board: Any):
    echo = Echo()
    assert echo.sure == Number(value=7)
    arrangement = Arrangement([echo], whiteboard=board)
    arrangement.round()
    assert echo.sure == Number(value=7)
    board.add_message(SENSED, Number(value=9))
    arrangement.round()
    assert echo.sure == Number(value=9)


def test_the_snapshot_is_taken_after_the_request_is_applied_and_before_any_code(board: Any):
    echo = Echo()
    arrangement = Arrangement([echo], whiteboard=board)
    arrangement.round()
    echo.seen.clear()
    arrangement.suspend("Echo")
    arrangement.round()
    assert echo.seen == [1, 1, 1]  # OnSuspend of a, OnEntry and Internal of asleep


def test_a_nested_ringlet_has_its_own_snapshot_and_the_outer_one_keeps_its(board: Any):
    class Quitter(Echo):
        @Echo.a.internal
        def _(self) -> None:
            self.seen.clear()
            self.note()
            self.abandon(self.name)
            self.note()

    quitter = Quitter()
    Arrangement([quitter], whiteboard=board).round()
    # 1 was posted before; the nested ringlet's sections see it, the outer one does not
    assert quitter.seen == [None, 1, 1, 1, None]


def test_actuators_post_at_once_and_return_the_count(board: Any):
    class Poster(Machine):
        post = Actuator(POSTED)
        counts: list[int] = []  # noqa: RUF012
        a = State()

        @a.on_entry
        def _(self) -> None:
            self.counts.append(self.post(Number(value=5)))
            self.counts.append(self.post(Number(value=6)))

    poster = Poster()
    Arrangement([poster], whiteboard=board).round()
    assert poster.counts == [1, 2]
    assert board.get_message(POSTED) == Number(value=6)


def test_an_unloaded_machine_cannot_post():
    with pytest.raises(NotLoadedError, match="Echo cannot post to 'sensed'"):
        Echo().post(Number())


def test_ports_need_a_whiteboard():
    with pytest.raises(LoadError, match="Echo uses slot 'sensed': give the Arrangement a white"):
        Arrangement([Echo()])


def test_a_failed_load_leaves_nothing_behind():
    arrangement = Arrangement()
    with pytest.raises(LoadError):
        arrangement.load(Echo)
    assert arrangement.control.number_of_machines == 0
    assert arrangement.machines == ()


# At the end


class Driver(Machine):
    drive = Actuator(POSTED, at_end=STOP)
    fail: bool = False

    moving = State()
    parked = State()

    @moving.internal
    def _(self) -> None:
        self.drive(Number(value=100))
        if self.fail:
            raise ZeroDivisionError("boom")

    @moving.to(parked)
    def stopped(self) -> bool:
        return self.stopping


class Forever(Machine):
    a = State()
    a.to(a, when=lambda m: False)


def count(board: Any) -> int:
    return int(board[POSTED].count)


def by_exception(board: Any) -> None:
    with pytest.raises(ExecutionError):
        Arrangement([Driver(fail=True)], whiteboard=board).run()


def by_exception_in_a_single_round(board: Any) -> None:
    arrangement = Arrangement([Driver(fail=True)], whiteboard=board)
    with pytest.raises(ExecutionError):
        arrangement.round()
    assert arrangement.reason is Reason.FAILED


def by_interrupt(board: Any) -> None:
    def interrupt(event: object) -> None:
        if type(event).__name__ == "RoundEnd":
            raise KeyboardInterrupt

    arrangement = Arrangement([Driver()], whiteboard=board, observers=[interrupt])
    with pytest.raises(KeyboardInterrupt):
        arrangement.run()
    assert arrangement.reason is Reason.INTERRUPTED


def by_stop(board: Any) -> None:
    arrangement = Arrangement([Driver()], whiteboard=board, clock=ManualClock())
    arrangement.round()
    arrangement.stop()
    assert arrangement.run() is Reason.ACCEPTING


def by_max_rounds(board: Any) -> None:
    arrangement = Arrangement([Driver()], whiteboard=board, clock=ManualClock())
    assert arrangement.run(max_rounds=2) is Reason.MAX_ROUNDS


def by_end_of_the_block(board: Any) -> None:
    with Arrangement([Driver()], whiteboard=board) as arrangement:
        arrangement.round()
    assert arrangement.reason is Reason.CLOSED


def by_exception_in_the_block(board: Any) -> None:
    arrangement = Arrangement([Driver()], whiteboard=board)
    arrangement.round()
    with pytest.raises(ZeroDivisionError), arrangement:
        raise ZeroDivisionError
    assert arrangement.reason is Reason.FAILED


def by_unloading(board: Any) -> None:
    arrangement = Arrangement([Driver(), Forever()], whiteboard=board)
    arrangement.round()
    arrangement.unload("Driver")


def by_accepting(board: Any) -> None:
    arrangement = Arrangement([Driver(), Forever()], whiteboard=board)
    arrangement.round()
    arrangement.stop()
    arrangement.round()
    arrangement.round()
    assert [m.name for m in arrangement.machines] == ["Forever"]


@pytest.mark.parametrize(
    "ending",
    [
        by_exception,
        by_exception_in_a_single_round,
        by_interrupt,
        by_stop,
        by_max_rounds,
        by_end_of_the_block,
        by_exception_in_the_block,
        by_unloading,
        by_accepting,
    ],
)
def test_the_last_message_is_posted_however_it_ends(board: Any, ending: Callable[[Any], None]):
    ending(board)
    assert board.get_message(POSTED) == STOP


def test_the_last_message_is_posted_once(board: Any):
    arrangement = Arrangement([Driver(), Forever()], whiteboard=board, clock=ManualClock())
    arrangement.round()
    arrangement.unload("Driver")
    posted = count(board)
    arrangement.run(max_rounds=5)
    arrangement.end()
    assert count(board) == posted


def test_the_last_message_is_posted_once_also_if_the_machine_is_unloaded_after_the_end(board: Any):
    arrangement = Arrangement([Driver()], whiteboard=board)
    arrangement.end()
    arrangement.unload("Driver")
    assert count(board) == 1


def test_nothing_is_posted_after_the_last_message_of_a_machine_that_unloads_itself(board: Any):
    class Leaver(Driver):
        @Driver.moving.on_entry
        def _(self) -> None:
            self.unload(self.name)  # Internal, which drives, is still to come

    Arrangement([Leaver(), Forever()], whiteboard=board).round()
    assert count(board) == 2
    assert board.get_message(POSTED) == STOP


def test_a_closed_board_takes_no_last_message_and_the_others_still_get_theirs(
    board: Any, caplog: pytest.LogCaptureFixture
):
    arrangement = Arrangement([Driver(), Driver()], whiteboard=board)
    arrangement.round()
    board.close()
    with caplog.at_level(logging.WARNING, "llfsm.runtime"):
        arrangement.end()
    assert [r.args[0] for r in caplog.records] == ["Driver", "Driver.0"]
    assert "the safe value of drive was not posted" in caplog.text
