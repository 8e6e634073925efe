"""A live board as a source: looked at, whatever happens to it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from llfsm.bridges.view.live_source import LiveSource, StateHistory
from llfsm.runtime import Arrangement, Machine, State
from llfsm.whiteboard import Sample, Slot, Whiteboard
from llfsm.whiteboard.liveness import born, host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    MIRROR,
    VIEWER,
    JournalPart,
    MachineStatus,
    MirrorStatus,
    journal_slot,
    status_slot,
)
from llfsm.whiteboard.messages.std_msgs import Bool
from waiting import PATIENCE_S, wait_for

from .conftest import Server

LAMP = Slot("lamp", Bool)
SLOTS = 448  # in the file, by llfsm_whiteboard.h


class Blink(Machine):
    n: int = 0
    on = State()
    off = State()
    on.to(off, after_ms=20)
    off.to(on, after_ms=20)


@pytest.fixture
def source(board: str) -> Iterator[LiveSource]:
    source = LiveSource(board)
    yield source
    source.close()


def test_it_waits_for_a_board_and_notices_its_end(board: str, source: LiveSource) -> None:
    look = source.snapshot()
    assert "no whiteboard" in look.trouble
    assert board in look.trouble
    assert source.board() is None
    epochs = []
    for value in (True, False):
        with Whiteboard(board) as wb:
            wb.add_message(LAMP, Bool(value))
            wait_for(lambda: "lamp" in source.snapshot().samples, "the slot was seen")
            look = source.snapshot()
            assert look.trouble == ""
            assert look.samples["lamp"].message.data is value  # type: ignore[attr-defined]
            epochs.append(look.epoch)
            wb.remove()
        assert "was removed" in source.snapshot().trouble
        assert source.snapshot().samples == {}
    assert epochs[0] < epochs[1]


def test_a_snapshot_adds_nothing_but_the_request_for_variables(
    board: str, source: LiveSource
) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(LAMP, Bool(True))
        source.snapshot()
        assert [info.name for info in wb.slots()] == ["lamp", VIEWER.name]
        viewer = wb.get_message(VIEWER)
        assert viewer is not None
        assert viewer.pid == os.getpid()


def test_of_a_host_that_cannot_be_reached_it_says_why(board: str) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(LAMP, Bool(True))
        look = LiveSource(board, given=wb, host="robot7").snapshot()
        assert "no daemon mirrors this whiteboard" in look.trouble
        assert LAMP.name not in look.slots
        wb.add_message(MIRROR, MirrorStatus(name="robot7"))
        look = LiveSource(board, given=wb, host="robot7").snapshot()
        assert (look.trouble, LAMP.name in look.samples) == ("", True)


def test_the_slots_are_the_same_object_while_there_is_no_new_one(
    board: str, source: LiveSource
) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(LAMP, Bool(True))
        wait_for(lambda: len(source.snapshot().slots) == 2, "both slots were seen")
        assert source.snapshot().slots is source.snapshot().slots


def test_the_history_is_of_the_states_that_were_seen() -> None:
    history, pid = StateHistory(), os.getpid()

    def note(now_ms: int, state: str, *, in_ms: int, suspended: bool = False) -> None:
        status = MachineStatus(
            state,
            suspended,
            in_state_s=in_ms / 1e3,
            pid=pid,
            born=born(pid),
            host=host_name(),
            namespace=pid_namespace(),
        )
        sample = Sample(status, 1, now_ms * 1_000_000, pid)
        history.add({status_slot("M").name: sample}, now_ms * 1_000_000, lambda _: alive)

    alive = True
    note(1000, "a", in_ms=400)
    note(1100, "a", in_ms=500)
    note(1200, "b", in_ms=50)
    note(1300, "b", in_ms=10, suspended=True)
    alive = False
    note(1400, "b", in_ms=0)
    alive = True
    note(9000, "c", in_ms=100)  # after a long gap
    note(20_000, "c", in_ms=11_100)
    assert [(c.stamp_ns // 1_000_000, c.state, c.suspended) for c in history.changes["M"]] == [
        (600, "a", False),
        (1150, "b", False),
        (1300, "b", True),
        (1400, "", False),
        (8900, "c", False),
        (9000, "", False),
        (9000, "c", False),
    ]
    stamps = [c.stamp_ns for c in history.changes["M"]]
    assert stamps == sorted(set(stamps))


def test_a_failure_is_a_change_of_the_history_and_ends_with_a_resume() -> None:
    history = StateHistory()
    name = status_slot("M").name
    suspended = MachineStatus("rest", suspended=True)
    failed = MachineStatus("rest", suspended=True, failed=True, error="a, OnEntry")
    for number, status in enumerate([suspended, failed, failed, MachineStatus("a"), failed], 1):
        now_ns = number * 100_000_000
        history.add({name: Sample(status, number, now_ns, 1)}, now_ns, lambda _: True)
    assert [(c.state, c.failed) for c in history.changes["M"]] == [
        ("rest", False),
        ("rest", True),
        ("a", False),
        ("rest", True),
    ]


def test_a_page_that_never_answers_is_sent_two_frames_and_then_the_newest(
    board: str, start: Callable[..., Any]
) -> None:
    with Whiteboard(board) as wb:
        counter = Slot("count", VIEWER.type)
        add = wb[counter].add
        add(VIEWER.type(0))
        server = start(Server, board)
        with server.live() as live:
            frames = [json.loads(live.recv(PATIENCE_S))]
            until = 0
            while len(frames) < 2:
                until += 1
                add(VIEWER.type(until))
                try:
                    frames.append(json.loads(live.recv(0.02)))
                except TimeoutError:
                    continue
            for number in range(until + 1, until + 200):
                add(VIEWER.type(number))
            with pytest.raises(TimeoutError):
                live.recv(0.3)
            live.send('{"type": "seen"}')
            newest = json.loads(live.recv(PATIENCE_S))
            assert [s[4] for s in newest["samples"] if s[1] > 100] == [[until + 199, False]]


def test_machines_publish_their_variables_while_they_are_viewed(
    board: str, source: LiveSource
) -> None:
    with Whiteboard(board) as wb:
        arrangement = Arrangement([Blink], whiteboard=wb)
        seen = []

        def look(_: object) -> None:
            seen.append(source.snapshot())
            if any(name.startswith("llfsm/variables/") for name in seen[-1].samples):
                arrangement.stop()

        arrangement.attach(look)
        arrangement.run(grace_s=0, max_rounds=2000)
        assert "llfsm/variables/Blink" in seen[-1].samples
        assert len(source.history()["Blink"]) > 1


def test_a_damaged_board_is_trouble_until_it_is_whole(board: str, source: LiveSource) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(LAMP, Bool(True))
        with wb.path.open("r+b") as file:  # where its second slot is
            file.seek(SLOTS + 8)
            file.write(b"\xff" * 8)
        assert "cannot be read" in source.snapshot().trouble
        wb.remove()
    with Whiteboard(board) as wb:
        wb.add_message(LAMP, Bool(True))
        wait_for(lambda: "lamp" in source.snapshot().samples, "the new board was seen")
        assert source.snapshot().trouble == ""


def test_states_that_were_not_seen_are_marked_as_skipped() -> None:
    history, pid = StateHistory(), os.getpid()
    stamps = iter(range(1, 100))

    def note(state: str, source: str, entered_ms: int, transition: int = 0) -> tuple[str, bool]:
        status = MachineStatus(
            state=state,
            source=source,
            transition=transition,
            entered_ns=entered_ms * 1_000_000,
            pid=pid,
            born=born(pid),
            host=host_name(),
            namespace=pid_namespace(),
        )
        now_ns = next(stamps) * 100_000_000
        history.add({"llfsm/machine/M": Sample(status, 1, now_ns, 1)}, now_ns, lambda _: True)
        last = history.changes["M"][-1]
        return last.state, last.skipped

    assert note("a", "", 1) == ("a", False)
    assert note("b", "a", 2) == ("b", False)
    assert history.changes["M"][-1][3:5] == ("a", 0)
    assert note("d", "c", 4) == ("d", True)  # c was between them
    assert note("d", "c", 4) == ("d", True)
    assert len(history.changes["M"]) == 3
    assert note("d", "e", 6, transition=2) == ("d", True)  # and back again
    assert history.changes["M"][-1][3:6] == ("e", 2, True)
    assert note("a", "", 0) == ("a", False)  # restarted, and no turn there yet
    assert note("a", "", 7) == ("a", False)
    assert len(history.changes["M"]) == 5


def test_journals_are_not_shown(board: str, source: LiveSource) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(LAMP, Bool(True))
        wb.add_message(journal_slot(0), JournalPart(1, 2, "", 0, 3, True, 0, data=bytes(100_000)))
        assert "lamp" in source.snapshot().samples
        assert [*source.snapshot().slots] == ["lamp"]
        wb.remove()
