"""The shared board among processes; what it shares with other kinds is in test_contract.py."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from llfsm.whiteboard import (
    BoardClosedError,
    BoardFullError,
    Slot,
    SlotTypeError,
    Whiteboard,
)
from llfsm.whiteboard.board_files import remove_board
from llfsm.whiteboard.messages.std_msgs import Int64, String

_shm = pytest.importorskip("llfsm.whiteboard._shm", reason="the extension is hidden")

RunPython = Callable[..., str]

NUMBER = Slot("number", Int64)
TEXT = Slot("text", String)

HEAD = """
import os, signal, sys
from llfsm.whiteboard import Slot, Whiteboard, WhiteboardError
from llfsm.whiteboard.messages.std_msgs import Int64, String
from llfsm.whiteboard.board_files import remove_board

NUMBER, TEXT = Slot("number", Int64), Slot("text", String)
directory, *arguments = sys.argv[1:]

def fork(child):
    pid = os.fork()
    if pid == 0:
        try:
            child()
        except BaseException as error:
            print(repr(error), file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)
    return pid

def join(pid):
    assert os.waitpid(pid, 0)[1] == 0
"""


@pytest.fixture
def wb(tmp_path: Path) -> Iterator[Whiteboard]:
    with Whiteboard("board", directory=tmp_path) as board:
        yield board


# ---- One board, many processes --------------------------------------------------------------


def test_another_process_adds(wb: Whiteboard, tmp_path: Path, run_python: RunPython) -> None:
    wb.add_message(NUMBER, Int64(1))
    child = HEAD + (
        "wb = Whiteboard('board', directory=directory, create=False)\n"
        "assert wb.get_message(NUMBER) == Int64(1)\n"
        "assert wb.add_message(NUMBER, Int64(2)) == 2\n"
        "wb.add_message(TEXT, String('hello'))\n"
        "print(os.getpid())\n"
    )
    process = int(run_python(child, tmp_path))
    sample = wb[NUMBER].sample()
    assert sample is not None
    assert (sample.message, sample.count, sample.writer) == (Int64(2), 2, process)
    assert wb.get_message(TEXT) == String("hello")


def test_a_wait_ends_when_another_process_adds(wb: Whiteboard, tmp_path: Path) -> None:
    child = HEAD + (
        "wb = Whiteboard('board', directory=directory)\n"
        "for count in range(20):\n"
        "    sample = wb[NUMBER].wait(after=count)\n"
        "    wb.add_message(TEXT, String(str(sample.message.data)))\n"
    )
    with subprocess.Popen([sys.executable, "-c", child, str(tmp_path)]) as process:
        for count in range(20):
            wb.add_message(NUMBER, Int64(count * count))
            answer = wb[TEXT].wait(after=count, timeout=60)
            assert answer is not None
            assert answer.message == String(str(count * count))
            assert answer.writer == process.pid
    assert process.returncode == 0


@pytest.mark.parametrize("added_before", [True, False], ids=["after an add", "before any add"])
def test_forked_processes_are_writers_of_their_own(
    added_before: bool, wb: Whiteboard, tmp_path: Path, run_python: RunPython
) -> None:
    script = HEAD + (
        """
wb = Whiteboard('board', directory=directory)
number = wb[NUMBER]
added = 0

def add():
    global added
    for _ in range(100):
        added = number.add(Int64(os.getpid()))
    if (sample := number.sample()).count == added:
        assert sample.writer == sample.message.data == os.getpid(), sample

def grandchild():
    add()

def child():
    if 'child' in arguments:
        add()
    join(fork(grandchild))
    add()

if 'parent' in arguments:
    add()
join(fork(child))
add()
first, second = fork(child), fork(child)
for _ in range(20):
    add()
join(first), join(second)
add()
print(number.count)
"""
    )
    arguments = ["parent", "child"] if added_before else []
    count = int(run_python(script, tmp_path, *arguments))
    by_parent, by_child_and_grandchild = 22 + added_before, 2 + added_before
    assert count == 100 * (by_parent + 3 * by_child_and_grandchild)
    assert wb[NUMBER].count == count


def test_processes_that_fork_never_share_a_writer_id(tmp_path: Path, run_python: RunPython) -> None:
    # With 256 ids and each process holding its own, 255 forks leave no place for one more.
    script = HEAD + (
        """
wb = Whiteboard('board', directory=directory)
number = wb[NUMBER]
ready, proceed = os.pipe(), os.pipe()

def child():
    os.close(proceed[1])
    number.add(Int64(1))
    os.write(ready[1], b'.')
    os.read(proceed[0], 1)

children = [fork(child) for _ in range(255)]
for _ in children:
    os.read(ready[0], 1)
number.add(Int64(1))
try:
    Whiteboard('board', directory=directory).add_message(NUMBER, Int64(1))
except WhiteboardError as error:
    print(type(error).__name__, number.count)
os.close(proceed[1])
for pid in children:
    join(pid)
"""
    )
    assert run_python(script, tmp_path) == "BoardFullError 256\n"


def test_processes_that_make_one_board_and_its_slots_at_once_meet(
    tmp_path: Path, run_python: RunPython
) -> None:
    script = HEAD + (
        """
import random
from contextlib import suppress

def work():
    os.close(start[1])
    os.read(start[0], 1)  # until the parent closes its end
    wb = Whiteboard('race', directory=directory)
    for i in random.sample(range(50), 50):
        wb.add_message(Slot(f's{i}', Int64), Int64(i))

for _ in range(4):
    with suppress(WhiteboardError):
        remove_board('race', directory)
    start = os.pipe()
    children = [fork(work) for _ in range(8)]
    os.close(start[0]), os.close(start[1])
    for pid in children:
        join(pid)
    with Whiteboard('race', directory=directory, create=False) as wb:
        names = [info.name for info in wb.slots()]
        assert sorted(names) == sorted(f's{i}' for i in range(50)), names
        for i in range(50):
            slot = wb[Slot(f's{i}', Int64)]
            assert slot.count == 8
            assert slot.get() == Int64(i)
"""
    )
    run_python(script, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["llfsm.race"]


def test_a_process_killed_while_it_makes_boards_leaves_whole_ones_only(
    tmp_path: Path, run_python: RunPython
) -> None:
    script = HEAD + (
        """
import itertools

def make():
    for i in itertools.count():
        wb = Whiteboard(f'{turn}-{i}', directory=directory)
        wb.add_message(NUMBER, Int64(i))
        wb.close()

for turn in range(25):
    pid = fork(make)
    while len(os.listdir(directory)) < 2 * turn + 2:
        pass
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
"""
    )
    run_python(script, tmp_path)
    for path in tmp_path.iterdir():
        name = path.name.removeprefix("llfsm.")
        with Whiteboard(name, directory=tmp_path, create=False) as board:
            latest = board.get_message(NUMBER)
            assert latest is None or latest == Int64(int(name.partition("-")[2]))
            board.add_message(NUMBER, Int64(7))
            assert board.get_message(NUMBER) == Int64(7)


def test_messages_outlive_their_writers(tmp_path: Path) -> None:
    script = HEAD + (
        "wb = Whiteboard('board', directory=directory)\n"
        "for i in range(10):\n"
        "    wb.add_message(NUMBER, Int64(i))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    for turn in range(2):
        done = subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=False)
        assert done.returncode == -9
        with Whiteboard("board", directory=tmp_path, create=False) as wb:
            assert wb.get_message(NUMBER) == Int64(9)
            assert wb[NUMBER].count == 10 * (turn + 1)


def test_closing_ends_the_wait_of_another_thread(tmp_path: Path, run_python: RunPython) -> None:
    script = HEAD + (
        """
import threading
wb = Whiteboard('board', directory=directory)
other, *slots = [wb[Slot(f's{i}', Int64)] for i in range(9)]
ready = threading.Barrier(len(slots) + 1)
found = []

def wait(slot):
    ready.wait()
    try:
        slot.wait(after=0)
    except WhiteboardError as error:
        found.append(type(error).__name__)

threads = [threading.Thread(target=wait, args=(slot,)) for slot in slots]
for thread in threads:
    thread.start()
ready.wait()
other.wait(after=0, timeout=0.02)  # most of the threads wait by then
wb.close()
for thread in threads:
    thread.join()
print(*set(found), len(found))
"""
    )
    assert run_python(script, tmp_path) == "BoardClosedError 8\n"


# ---- Limits ---------------------------------------------------------------------------------


def test_more_writers_than_a_board_has_places_for(tmp_path: Path) -> None:
    handles = [Whiteboard("board", directory=tmp_path) for _ in range(257)]
    try:
        for count, handle in enumerate(handles[:256], 1):
            assert handle.add_message(NUMBER, Int64(count)) == count
        last = handles[256]
        for _ in range(2):
            with pytest.raises(BoardFullError, match=r"too many processes write .*256 at most"):
                last.add_message(NUMBER, Int64(0))
            assert last.get_message(NUMBER) == Int64(256)
        handles[100].close()
        assert last.add_message(NUMBER, Int64(0)) == 257
        for reader in (handles[0], handles[255], last):
            assert reader.get_message(NUMBER) == Int64(0)
    finally:
        for handle in handles:
            handle.close()


def test_more_slots_than_a_board_has_places_for(wb: Whiteboard, tmp_path: Path) -> None:
    for i in range(4096):
        wb[Slot(f"s{i}", Int64)]
    with pytest.raises(BoardFullError, match=r"no room for another slot .*4096 at most"):
        wb[Slot("one-more", Int64)]
    with Whiteboard("board", directory=tmp_path) as other:
        assert [info.name for info in other.slots()] == [f"s{i}" for i in range(4096)]
        for i in (0, 2048, 4095):
            slot = Slot(f"s{i}", Int64)
            other.add_message(slot, Int64(i))
            assert wb.get_message(slot) == Int64(i)


def test_large_messages(wb: Whiteboard, tmp_path: Path) -> None:
    image = Slot("image", String, capacity=8 << 20)
    with Whiteboard("board", directory=tmp_path) as other:
        for letter in "abc":
            large = String(letter * ((8 << 20) - 10))
            wb.add_message(image, large)
            assert other.get_message(image) == large
        wb.add_message(image, String("small"))
        assert other.get_message(image) == String("small")


def test_a_board_grows_while_others_have_it_open(wb: Whiteboard, tmp_path: Path) -> None:
    mine = wb[NUMBER]
    mine.add(Int64(0))
    size = wb.path.stat().st_size
    slots = [Slot(f"text{i}", String, capacity=1 << 18) for i in range(12)]
    with Whiteboard("board", directory=tmp_path) as other:
        for i, slot in enumerate(slots, 1):
            other.add_message(slot, String("x" * i))
            other.add_message(NUMBER, Int64(i))
            assert mine.get() == Int64(i)
            assert wb.get_message(slot) == String("x" * i)
            assert mine.add(Int64(-i)) == 2 * i + 1
            assert other.get_message(NUMBER) == Int64(-i)
    assert wb.path.stat().st_size > size + (10 << 20)


def test_a_process_that_uses_a_hundred_slots_is_small(
    tmp_path: Path, run_python: RunPython
) -> None:
    script = HEAD + (
        """
with Whiteboard('board', directory=directory) as wb:
    for i in range(100):
        slot = Slot(f's{i}', String)
        wb.add_message(slot, String('x' * 1000))
        assert wb.get_message(slot) == String('x' * 1000)
    status = open('/proc/self/status').read()
    print(next(line.split()[1] for line in status.splitlines() if line.startswith('VmRSS')))
"""
    )
    assert int(run_python(script, tmp_path)) < 40 << 10  # KiB


def test_a_wait_ends_when_the_board_is_removed(wb: Whiteboard) -> None:
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(wb[NUMBER].wait, after=0)
        remove_board(wb.name, wb.path.parent)
        with pytest.raises(BoardClosedError, match="removed"):
            waiting.result(timeout=60)


def test_a_slot_without_a_json_schema_has_a_problem(wb: Whiteboard) -> None:
    """As a program in C might make it."""
    core = _shm.Board(str(wb.path), False, -1)
    _shm.Port(core, "odd", "T", "{", 1, 64, Int64, (), lambda *_: None, lambda _: Int64())
    assert wb.slots()[-1].problem.startswith("its schema is not a JSON object: ")
    with pytest.raises(SlotTypeError, match="slot 'odd' holds something else, not our"):
        wb.add_message(Slot("odd", Int64), Int64())
