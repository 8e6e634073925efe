"""A machine whose process dies without an end: guards post its safe values, once."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import driving
from driving import DRIVE, GO, LAMP, OFF, QUIET, SAFE, Runs, kill
from llfsm.runtime import Actuator, Arrangement, LiveEnvironment, Machine, OptionError, State
from llfsm.runtime.presence.guard import Guard, GuardThread
from llfsm.runtime.presence.will import execute
from llfsm.whiteboard import BoardFullError, Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    MIRROR,
    LastWill,
    MachineStatus,
    MirrorStatus,
    SafeValue,
    status_slot,
    will_slot,
)
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

WILL = will_slot("Drives")


@pytest.fixture
def name(tmp_path: Path) -> str:
    return f"will-{os.getpid()}-{tmp_path.name}"


@pytest.fixture
def board(name: str) -> Iterator[Whiteboard]:
    with Whiteboard(name) as board:
        yield board
        board.remove()


@pytest.fixture
def runs(board: Whiteboard) -> Iterator[Runs]:
    runs = Runs(board)
    yield runs
    runs.end()


def is_executed(board: Whiteboard) -> bool:
    will = board.get_message(WILL)
    return will is not None and will.state == "executed"


@pytest.fixture
def guard(board: Whiteboard) -> Iterator[Guard]:
    guard = Guard(board)
    yield guard
    guard.close()


def rounds(guard: Guard) -> Callable[[], None]:
    def look() -> None:
        guard.look()
        guard.wait(0)

    return look


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
        f"Drives: its process {process.pid} died without an end; "
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


def test_a_message_of_a_silent_process_is_a_sign_of_life(board: Whiteboard) -> None:
    board.add_message(DRIVE, GO)
    will = left(board, os.getpid(), silent_ms=500)
    outcome = execute(board, will, silent_ns=10**15)
    assert outcome == ([], ["drive"], {})
    assert board.get_message(DRIVE) == GO


def left(board: Whiteboard, pid: int, host: str = "", **fields: object) -> object:
    """Leave a will for the slot `drive` as a process would, and return its sample."""
    safe = (SafeValue("drive", DRIVE.encoder.encode(SAFE)),)
    will = LastWill(pid, born(pid), host or host_name(), pid_namespace(), safe)
    board.add_message(WILL, msgspec.structs.replace(will, **fields))
    return board[WILL].sample()


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


def test_a_value_that_cannot_be_posted_does_not_keep_others_back(
    board: Whiteboard, runs: Runs
) -> None:
    process = runs.start(once=True)
    kill(process)
    will = board[WILL].get()
    bad = (SafeValue("drive", b"\xff"), SafeValue("missing", b"\x91\x00"))
    sample = (
        board[WILL]
        .sample()
        ._replace(message=msgspec.structs.replace(will, values=(*bad, *will.values)))
    )
    outcome = execute(board, sample)
    assert outcome.posted == ["drive", "lamp"]
    assert list(outcome.failed) == ["drive", "missing"]
    assert board.get_message(DRIVE) == SAFE


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


def test_a_guard_survives_the_removal_of_its_board(name: str) -> None:
    with GuardThread(name):
        for _ in range(2):
            with Whiteboard(name) as board, ExitStack() as stack:
                runs = Runs(board)
                stack.callback(runs.end)
                kill(runs.start())
                wait_for(lambda board=board: is_executed(board), "the will is executed")
                assert board.get_message(DRIVE) == SAFE
                board.remove()


def test_a_machine_loaded_by_another_has_its_will_before_its_first_turn() -> None:
    seen = []

    class Loaded(Machine):
        drive = Actuator(DRIVE, at_end=SAFE)
        only = State()

        @only.on_entry
        def _(self) -> None:
            seen.append(board[will_slot("Loaded")].get().state)

    class Loads(Machine):
        a = State()
        b = State()
        a.to(b, after_ms=1)

        @a.on_entry
        def _(self) -> None:
            self.load(Loaded)

    board = Whiteboard.local()
    Arrangement([Loads], whiteboard=board).run()
    assert seen == ["left"]
    assert board[will_slot("Loaded")].get().state == "withdrawn"
    assert will_slot("Loads").name not in {info.name for info in board.slots()}


def test_how_long_a_process_may_be_silent_is_at_least_two_heartbeats() -> None:
    with pytest.raises(OptionError, match="500 or more"):
        LiveEnvironment(Whiteboard.local(), will_after_ms=499)


def test_a_process_that_cannot_be_looked_up_is_judged_by_its_statuses(
    board: Whiteboard, guard: Guard
) -> None:
    """As one in a container that shares the board, whose process ids mean others here."""
    board.add_message(MIRROR, MirrorStatus(pid=1, partition_s=0.5))
    board.add_message(DRIVE, GO)  # by the pid of this process, which is another's there
    left(board, os.getpid(), born=1, namespace=pid_namespace() + 1)
    status = MachineStatus(pid=os.getpid(), born=1, host=host_name())
    board.add_message(status_slot("Drives"), status)
    guard.look()
    assert board.get_message(DRIVE) == GO
    wait_for(lambda: is_executed(board), "the will is executed", between=rounds(guard))
    assert board.get_message(DRIVE) == SAFE


def test_a_board_without_room_for_the_bell_is_guarded(board: Whiteboard) -> None:
    _ = board[DRIVE]
    left(board, 2**22 + 1, born=1)  # no process has such an id
    with pytest.raises(BoardFullError):
        fill(board)
    with closing(Guard(board)) as guard:
        guard.look()
    assert is_executed(board)


class Elsewhere:
    """A machine of another host, as this host's daemon, this process, adds its messages."""

    def __init__(self, board: Whiteboard, partition_s: float) -> None:
        self.board = board
        board.add_message(MIRROR, MirrorStatus(pid=os.getpid(), partition_s=partition_s))
        board.add_message(DRIVE, GO)
        left(board, 4711, host="far", born=1)
        status = MachineStatus(pid=4711, born=1, host="far")
        board.add_message(status_slot("Drives"), status)


def test_a_host_that_is_silent_for_long_counts_as_dead(board: Whiteboard, guard: Guard) -> None:
    Elsewhere(board, 0.5)
    wait_for(lambda: is_executed(board), "the will is executed", between=rounds(guard))
    assert board.get_message(DRIVE) == SAFE


def test_a_host_that_publishes_statuses_lives(board: Whiteboard, guard: Guard) -> None:
    Elsewhere(board, 1000)
    rounds(guard)()
    assert board.get_message(DRIVE) == GO


def test_a_host_that_is_silent_does_not_stop_what_another_one_commands(
    board: Whiteboard, guard: Guard
) -> None:
    Elsewhere(board, 0.5)
    other = LastWill(
        os.getpid(),
        born(os.getpid()),
        host_name(),
        pid_namespace(),
        (SafeValue("drive", DRIVE.encoder.encode(SAFE)),),
    )
    board.add_message(will_slot("Other"), other)
    wait_for(lambda: is_executed(board), "the will is executed", between=rounds(guard))
    assert board.get_message(DRIVE) == GO


class Writers:
    """Two processes that post to the slot `drive` when asked."""

    def __init__(self, board: Whiteboard) -> None:
        self.board = board
        self.processes = [
            subprocess.Popen(
                [sys.executable, driving.__file__, str(board.path.parent), board.name],
                text=True,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            for _ in range(2)
        ]

    def post(self, number: int, value: int) -> None:
        process = self.processes[number]
        process.stdin.write(f"{value}\n")
        process.stdin.flush()
        process.stdout.readline()

    def end(self) -> None:
        for process in self.processes:
            process.communicate()


@pytest.mark.timeout(180)
def test_only_a_latest_message_of_the_dead_is_replaced(board: Whiteboard) -> None:
    writers = Writers(board)
    dead = writers.processes[0].pid
    try:

        @settings(max_examples=60)
        @given(
            st.lists(st.tuples(st.integers(0, 1), st.integers(0, 2)), min_size=1, max_size=5),
            st.integers(1, 4),
        )
        def whatever_was_posted_before(posts: list[tuple[int, int]], guards: int) -> None:
            for number, value in posts:
                writers.post(number, value)
            # As its process has left it, and as if that had died.
            will = left(board, dead)._replace(writer=dead)
            count = board[DRIVE].count
            with ThreadPoolExecutor(guards) as pool:
                outcomes = list(pool.map(lambda _: execute(board, will), range(guards)))
            number, value = posts[-1]
            replaced = number == 0 and value != SAFE.data
            assert sum(outcome.posted == ["drive"] for outcome in outcomes) == replaced
            assert board[DRIVE].count == count + replaced
            assert board.get_message(DRIVE) == (SAFE if replaced else Int32(data=value))

        whatever_was_posted_before()
    finally:
        writers.end()
