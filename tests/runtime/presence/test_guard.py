"""A machine whose process dies without shutting down: guards post its safe values, once."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from contextlib import ExitStack, closing
from pathlib import Path

import msgspec
import pytest

from driving import DRIVE, GO, LAMP, OFF, QUIET, SAFE, Runs, kill
from llfsm.runtime.presence.guard import Guard, GuardThread
from llfsm.runtime.presence.will import execute
from llfsm.whiteboard import BoardFullError, Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import WILL_BELL, Bell, SafeValue, status_slot, will_slot
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

from .wills import WILL, is_executed, left, rounds


@pytest.mark.parametrize("guards", [1, 3])
@pytest.mark.timeout(180)
def test_the_values_of_a_killed_process_are_posted_once(
    board: Whiteboard, runs: Runs, guards: int
) -> None:
    chance = random.Random(guards)
    with ExitStack() as stack:
        for _ in range(guards):
            stack.enter_context(GuardThread(board.name))
        for _ in range(5):
            process = runs.start()
            after = board[DRIVE].count + chance.randrange(20)
            wait_for(lambda after=after: board[DRIVE].count >= after, "it has driven so long")
            kill(process)
            wait_for(lambda: is_executed(board), "the will is executed")
            count = board[DRIVE].count
            latest = board[DRIVE].sample()
            assert latest.message == SAFE
            assert board.get_message(LAMP) == OFF
            assert board.get_message(QUIET) is None
            assert board.get_message(Slot("unsafe", Int32)) == GO
            with closing(Guard(board)) as late:
                late.look()
            assert latest.count == count == board[DRIVE].count


def test_one_message_is_added_however_many_guards_race(board: Whiteboard, runs: Runs) -> None:
    process = runs.start(once=True)
    before = board[DRIVE].count, board[LAMP].count
    with ExitStack() as stack:
        for _ in range(4):
            stack.enter_context(GuardThread(board.name))
        kill(process)
        wait_for(lambda: is_executed(board), "the will is executed")
    assert (board[DRIVE].count, board[LAMP].count) == (before[0] + 1, before[1] + 1)


def test_a_process_that_died_before_the_guard_came_is_dead_as_well(
    board: Whiteboard, runs: Runs, guard: Guard, caplog: pytest.LogCaptureFixture
) -> None:
    process = runs.start()
    kill(process)
    guard.look()
    assert board.get_message(DRIVE) == SAFE
    assert caplog.messages == [
        f"Drives: process {process.pid} died without shutting down; "
        f"posted its safe values to drive, lamp"
    ]


LAST_PID = Path("/proc/sys/kernel/ns_last_pid")


@pytest.mark.skipif(not os.access(LAST_PID, os.W_OK), reason="only root can choose a process's id")
@pytest.mark.parametrize("sees_the_death", [True, False])
def test_another_process_of_the_same_id_is_not_taken_for_it(
    board: Whiteboard, runs: Runs, guard: Guard, sees_the_death: bool
) -> None:
    process, look = runs.start(), rounds(guard)
    if sees_the_death:
        look()
    kill(process)
    for _ in range(1000):  # others start processes, too
        LAST_PID.write_text(str(process.pid - 1))
        with subprocess.Popen(["sleep", "1000"]) as heir:
            try:
                if heir.pid == process.pid:
                    wait_for(lambda: is_executed(board), "the will is executed", between=look)
                    break
            finally:
                heir.kill()
    else:
        pytest.fail("the process's id was not to be had")
    assert board.get_message(DRIVE) == SAFE


def test_a_process_that_executes_another_program_has_died(
    board: Whiteboard, runs: Runs, guard: Guard, caplog: pytest.LogCaptureFixture
) -> None:
    process = runs.start()
    look = rounds(guard)
    look()
    process.send_signal(signal.SIGUSR1)
    wait_for(lambda: is_executed(board), "the will is executed", between=look)
    assert process.poll() is None
    assert board.get_message(DRIVE) == SAFE
    assert caplog.messages == [
        f"Drives: process {process.pid} executes another program; "
        f"posted its safe values to drive, lamp"
    ]


def test_a_successor_that_posts_is_not_stopped(board: Whiteboard, runs: Runs, guard: Guard) -> None:
    guard.look()
    first = runs.start()
    guard.look()
    kill(first)
    board.add_message(DRIVE, Int32(data=7))  # of this process, which takes over
    look = rounds(guard)
    wait_for(lambda: is_executed(board), "the will is executed", between=look)
    assert board.get_message(DRIVE) == Int32(data=7)
    assert board.get_message(LAMP) == OFF


def test_a_successor_of_the_same_name_executes_the_will_that_it_replaces(
    board: Whiteboard, runs: Runs
) -> None:
    first = runs.start(once=True)
    kill(first)
    count = board[DRIVE].count
    second = runs.start(once=True)
    # The safe value, and what the successor posts.
    wait_for(lambda: board[DRIVE].count == count + 2, "both are posted")
    assert board.get_message(DRIVE) == GO
    assert board.get_message(WILL).pid == second.pid
    look = rounds(guard := Guard(board))
    for _ in range(3):
        look()
    guard.close()
    assert board[DRIVE].count == count + 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_clean_end_leaves_nothing_to_do(
    board: Whiteboard, runs: Runs, guard: Guard, number: signal.Signals
) -> None:
    process = runs.start()
    guard.look()
    process.send_signal(number)
    process.wait()
    assert board.get_message(LAMP) == OFF
    assert board.get_message(WILL).state == "withdrawn"
    counts = board[DRIVE].count, board[LAMP].count
    rounds(guard)()
    guard.look()
    assert (board[DRIVE].count, board[LAMP].count) == counts
    assert board.get_message(DRIVE) == GO  # it has no value for the end
    assert board.get_message(WILL).state == "withdrawn"


def test_a_stopped_process_keeps_its_will_unless_asked(
    board: Whiteboard, runs: Runs, guard: Guard
) -> None:
    process = runs.start()
    process.send_signal(signal.SIGSTOP)
    silent = board[status_slot("Drives")]
    count = silent.count
    assert silent.wait(after=count + 1, timeout=1.5) is None
    rounds(guard)()
    assert board.get_message(DRIVE) == GO
    assert not is_executed(board)


def test_a_stopped_process_is_dead_if_asked_and_goes_on_later(
    board: Whiteboard, runs: Runs, guard: Guard
) -> None:
    process = runs.start(will_after_ms=500)
    look = rounds(guard)
    process.send_signal(signal.SIGSTOP)
    wait_for(lambda: is_executed(board), "the will is executed", between=look)
    assert board.get_message(DRIVE) == SAFE
    count = board[DRIVE].count
    look()
    assert board[DRIVE].count == count
    process.send_signal(signal.SIGCONT)
    wait_for(lambda: board[DRIVE].count > count, "it goes on")
    wait_for(lambda: board.get_message(WILL).state == "left", "it leaves its will again")
    kill(process)
    log = process.stderr.read()
    assert f"the last will of Drives was executed by process {os.getpid()}" in log
    wait_for(lambda: is_executed(board), "the will is executed again", between=look)
    assert board.get_message(DRIVE) == SAFE


def test_a_guard_that_dies_halfway_leaves_the_rest_to_others(
    board: Whiteboard, runs: Runs, guard: Guard
) -> None:
    process = runs.start(once=True)
    kill(process)
    before = board[DRIVE].count, board[LAMP].count
    will = board[WILL].sample()
    half = msgspec.structs.replace(will.message, values=will.message.values[:1])
    assert execute(board, will._replace(message=half)).posted == ["drive"]  # and then it died
    guard.look()
    assert is_executed(board)
    assert (board[DRIVE].count, board[LAMP].count) == (before[0] + 1, before[1] + 1)


def test_a_value_that_cannot_be_posted_yet_is_tried_again(
    board: Whiteboard, runs: Runs, guard: Guard
) -> None:
    process = runs.start(once=True)
    kill(process)
    will = board.get_message(WILL)
    late = Slot("late", Int32)
    values = (*will.values, SafeValue(late.name, late.encoder.encode(Int32(1))))
    board.add_message(WILL, msgspec.structs.replace(will, values=values))
    guard.look()
    assert board.get_message(DRIVE) == SAFE
    assert not is_executed(board)  # there is no such slot
    board.add_message(
        late, Int32(7)
    )  # by this process, as by the daemon that has mirrored the will
    wait_for(lambda: is_executed(board), "the will is executed", between=rounds(guard))
    assert board.get_message(late) == Int32(1)


def fill(board: Whiteboard) -> None:
    for number in range(5000):
        _ = board[Slot(f"fill/{number}", Int32)]


def test_a_board_that_fills_up_is_guarded(runs: Runs, board: Whiteboard, guard: Guard) -> None:
    process = runs.start()
    guard.look()
    with pytest.raises(BoardFullError):
        fill(board)
    kill(process)
    wait_for(lambda: is_executed(board), "the will is executed", between=rounds(guard))
    assert board.get_message(DRIVE) == SAFE


def test_a_guard_survives_the_removal_of_its_board(board_name: str) -> None:
    with GuardThread(board_name):
        for _ in range(2):
            with Whiteboard(board_name) as board, ExitStack() as stack:
                runs = Runs(board)
                stack.callback(runs.end)
                kill(runs.start())
                wait_for(lambda board=board: is_executed(board), "the will is executed")
                assert board.get_message(DRIVE) == SAFE
                board.remove()


def test_a_board_without_room_for_the_bell_is_guarded(board: Whiteboard) -> None:
    _ = board[DRIVE]
    left(board, 2**22 + 1, born=1)  # no process has such an id
    with pytest.raises(BoardFullError):
        fill(board)
    with closing(Guard(board)) as guard:
        guard.look()
    assert is_executed(board)


def test_a_guard_that_is_to_wait_posts_nothing_before(board: Whiteboard, runs: Runs) -> None:
    kill(runs.start())
    begin = time.monotonic()
    with GuardThread(board.name, after_s=0.3):
        wait_for(lambda: is_executed(board), "the will is executed")
    assert time.monotonic() - begin >= 0.3


def test_many_machines_of_one_process_cost_two_descriptors(board: Whiteboard, guard: Guard) -> None:
    guard.look()
    before = len(os.listdir("/proc/self/fd"))
    will = left(board, os.getpid()).message
    for number in range(50):
        board.add_message(will_slot(f"M{number}"), will)
    board.add_message(WILL_BELL, Bell())
    guard.look()
    assert len(os.listdir("/proc/self/fd")) == before + 2
    withdrawn = msgspec.structs.replace(will, state="withdrawn")
    for number in range(50):
        board.add_message(will_slot(f"M{number}"), withdrawn)
    board.add_message(WILL, withdrawn)
    guard.look()
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_will_of_an_impossible_process_keeps_no_other_from_being_executed(
    board: Whiteboard, runs: Runs, guard: Guard
) -> None:
    impossible = msgspec.structs.replace(left(board, os.getpid()).message, pid=2**60, born=1)
    board.add_message(will_slot("A"), impossible)
    process = runs.start()
    guard.look()
    kill(process)
    wait_for(lambda: is_executed(board), "the will is executed", between=rounds(guard))
    assert board.get_message(DRIVE) == SAFE


@pytest.mark.usefixtures("board")  # without shared memory, the line says that
def test_a_board_that_cannot_be_opened_is_logged_in_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "llfsm.other").write_bytes(b"no whiteboard")
    with GuardThread("other", tmp_path):
        wait_for(lambda: caplog.records, "the problem is logged")
    (record,) = caplog.records
    assert not record.exc_info
    assert "cannot be guarded" in record.getMessage()
    assert "llfsm.other: not a whiteboard of this user" in record.getMessage()
