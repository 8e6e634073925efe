"""A last will: when it is on the board, and which of its values are posted."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import driving
from driving import DRIVE, GO, SAFE, Runs, kill
from forked import Forked
from llfsm.runtime import Actuator, Arrangement, LiveEnvironment, Machine, OptionError, State
from llfsm.runtime.presence.will import Will, execute
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import SafeValue, will_slot
from llfsm.whiteboard.messages.std_msgs import Int32
from thoroughness import examples

from .wills import WILL, left


def test_a_message_of_a_silent_process_is_a_sign_of_life(board: Whiteboard) -> None:
    board.add_message(DRIVE, GO)
    will = left(board, os.getpid(), silent_ms=500)
    outcome = execute(board, will, silent_ns=10**15)
    assert outcome == ([], ["drive"], {})
    assert board.get_message(DRIVE) == GO


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


class Writers:
    """Two processes that post to the slot `drive` when asked."""

    def __init__(self, board: Whiteboard) -> None:
        self.board = board
        self.processes = [
            Forked(
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

        @settings(max_examples=examples(20))
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


def test_who_keeps_a_name_has_its_will_there_once_the_other_one_has_gone(
    board: Whiteboard,
) -> None:
    """Two processes that claim one name at the same moment leave their wills in one slot."""
    mine = Will(board, "Drives", [(DRIVE, SAFE)], 0)
    mine.leave()
    own = board[WILL].get()
    left(board, os.getppid())
    mine.keep()
    theirs = board[WILL].get()
    assert theirs.pid == os.getppid()
    board.add_message(WILL, msgspec.structs.replace(theirs, state="withdrawn"))
    mine.keep()
    assert board[WILL].get() == own
