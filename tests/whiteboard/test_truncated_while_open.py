"""A file that is truncated while it is open is an error of that board, and the program goes on."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from llfsm.whiteboard import BoardCorruptError, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32, String
from own_boards import own_board
from waiting import PATIENCE_S

NUMBER, OTHER = Slot("number", Int32), Slot("other", String)
DO: dict[str, Callable[[Whiteboard, Any], object]] = {
    "get": lambda board, bound: bound.get(),
    "sample": lambda board, bound: bound.sample(),
    "recent": lambda board, bound: bound.recent(),
    "add": lambda board, bound: bound.add(Int32(data=2)),
    "count": lambda board, bound: bound.count,
    "reserve": lambda board, bound: bound.reserve(),
    "wait": lambda board, bound: bound.wait(after=1, timeout=PATIENCE_S),
    "slots": lambda board, bound: board.slots(),
    "a new slot": lambda board, bound: board.add_message(OTHER, String(data="x")),
    "living": lambda board, bound: board.living(),
}


def do_twice(act: Callable[[], object]) -> None:
    act()  # what is still there may be read once more
    act()


@pytest.mark.parametrize("size", [0, 4096])
@pytest.mark.parametrize("what", DO)
def test_every_call_reports_it(what: str, size: int, tmp_path: Path) -> None:
    with (
        Whiteboard("cut", directory=tmp_path) as board,
        own_board() as name,
        Whiteboard(name) as other,
    ):
        bound = board[NUMBER]
        bound.add(Int32(data=1))
        other.add_message(NUMBER, Int32(data=7))
        os.truncate(board.path, size)
        with pytest.raises(BoardCorruptError, match=r"truncated|damaged"):
            do_twice(lambda: (DO[what](board, bound), board.slots()))
        assert not board.alive
        assert os.path.getsize(board.path) == size  # nothing was written there
        assert other.get_message(NUMBER) == Int32(data=7)


def test_a_call_that_is_under_way_ends_with_the_error(tmp_path: Path) -> None:
    with Whiteboard("cut", directory=tmp_path) as board:
        board.add_message(NUMBER, Int32(data=1))
        timer = threading.Timer(0.2, os.truncate, (board.path, 0))
        timer.start()
        with pytest.raises(BoardCorruptError, match="truncated"):
            add_for_ever(board)
        timer.join()


def add_for_ever(board: Whiteboard) -> None:
    while True:
        board[NUMBER].wait(after=board[NUMBER].count, timeout=0.05)
        board.add_message(NUMBER, Int32(data=1))


RUNNING = """
import sys
from llfsm.whiteboard import BoardCorruptError, Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Int32

board = Whiteboard("cut", directory=sys.argv[1])
bound = board[Slot("number", Int32)]
print("begun", flush=True)
try:
    while True:
        bound.add(Int32(data=1))
        bound.get()
        board.slots()
        Whiteboard("cut", directory=sys.argv[1]).close()
except BoardCorruptError:
    print("corrupt")
"""


def test_no_process_dies_of_it_whatever_it_was_about_to_do(tmp_path: Path) -> None:
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", RUNNING, str(tmp_path)], stdout=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
    os.truncate(next(tmp_path.iterdir()), 5000)
    for process in processes:
        printed, _ = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, printed) == (0, "corrupt\n")


FAULTS = """
#include "llfsm_whiteboard.h"

int main(int number, char **arguments)
{
    struct lwb_board board;
    struct lwb_slot slot;
    const struct lwb_schema schema = {"x", "X", "{}", 1, 8};
    struct lwb_meta meta;
    char data[8];
    lwb_catch_truncation();
    if (lwb_open(&board, arguments[1], true) || lwb_slot(&board, &slot, &schema) ||
        lwb_add(&slot, "abc", 3, NULL) || lwb_read(&slot, data, 8, &meta))
        return 1;
    if (number > 2) { /* a fault elsewhere */
        volatile char *map = mmap(NULL, 8192, PROT_READ, MAP_SHARED, board.fd, 0);
        if (truncate(arguments[1], 0))
            return 2;
        return map[4096];
    }
    if (truncate(arguments[1], 0))
        return 2;
    if (lwb_read(&slot, data, 8, &meta) != LWB_CORRUPT || lwb_linked(&board) ||
        lwb_add(&slot, "abc", 3, NULL) != LWB_CORRUPT)
        return 3;
    lwb_close(&board);
    if (truncate(arguments[1], 0) || unlink(arguments[1]) || lwb_open(&board, arguments[1], true))
        return 4;
    if (lwb_slot(&board, &slot, &schema) || lwb_add(&slot, "abc", 3, NULL))
        return 5; /* another board, perhaps in the same place */
    lwb_close(&board);
    return 0;
}
"""


@pytest.mark.compiler
def test_programs_in_c_get_a_status_and_other_faults_end_them(tmp_path: Path) -> None:
    compiler = shlex.split(os.environ.get("CC", "cc"))
    source, made = tmp_path / "faults.c", tmp_path / "faults"
    source.write_text(FAULTS)
    include = Path(__file__).parents[2] / "whiteboard" / "include"
    subprocess.run([*compiler, "-Wall", "-Wextra", "-I", include, source, "-o", made], check=True)
    assert subprocess.run([made, tmp_path / "board"], check=False).returncode == 0
    plain = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
    ended = subprocess.run([made, tmp_path / "other", "elsewhere"], check=False, env=plain)
    assert ended.returncode == -signal.SIGBUS
