"""The event log has all that is known to have happened, the newest first, and finds words in it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.view.app import log_page
from llfsm.bridges.view.page_source import Change, Note, Notes
from llfsm.whiteboard import Sample, Whiteboard
from llfsm.whiteboard.messages.llfsm import (
    DEFINITIONS,
    DefinedState,
    DefinedTransition,
    MachineDefinition,
    MachineRequest,
    MachineStatus,
    OverriddenSensor,
    request_slot,
    status_slot,
)
from waiting import PATIENCE_S, wait_for

from .conftest import Server

MS = 1_000_000


def test_an_event_says_what_has_happened() -> None:
    transition = DefinedTransition("B", "near_wall")
    definition = MachineDefinition("", (DefinedState("A", (), (transition,)), DefinedState("B")))
    changes = [
        Change(1, "A", False),
        Change(2, "B", False, "A", 0),
        Change(3, "B", True),
        Change(5, "B", False),
        Change(6, "A", False, "B", 0, skipped=True),
        Change(7, "B", True, failed=True),
        Change(8, "", False),
    ]
    notes = [Note(4, "M", "request", "request: resume"), Note(7, "M", "failed", "failed: why")]
    samples = {DEFINITIONS + "M": Sample(definition, 1, 0, 1)}
    page = log_page({"M": changes}, notes, samples)
    assert [(e.stamp_ns, e.kind, e.text) for e in page.events] == [
        (8, "ended", "ended"),
        (7, "failed", "failed: why"),
        (6, "transition", "… B → A"),
        (5, "resumed", "resumed in B"),
        (4, "request", "request: resume"),
        (3, "suspended", "suspended in B"),
        (2, "transition", "A → B  near_wall"),
        (1, "state", "in A"),
    ]
    assert page.complete
    found = log_page({"M": changes}, notes, samples, words="m WALL", until_ns=7)
    assert [e.stamp_ns for e in found.events] == [2]


@given(
    st.dictionaries(st.sampled_from("ABC"), st.sets(st.integers(0, 400), max_size=400)),
    st.sets(st.integers(0, 400)),
    st.integers(-1, 401),
    st.integers(1, 8),
    st.sampled_from(["", "a", "request"]),
)
def test_a_page_of_the_log_is_the_newest_part_of_all(
    stamps: dict[str, set[int]], requests: set[int], until_ns: int, most: int, words: str
) -> None:
    history = {m: [Change(t, "s", False) for t in sorted(each)] for m, each in stamps.items()}
    notes = [Note(t, "A", "request", "request: stop") for t in sorted(requests)]
    page = log_page(history, notes, {}, words=words, until_ns=until_ns, most=most)
    all_of = [Note(t, m, "state", "in s") for m, each in stamps.items() for t in each] + notes
    old = sorted((e for e in all_of if e.stamp_ns <= until_ns), key=lambda e: -e.stamp_ns)
    wanted = [e for e in old if words in f"{e.machine} {e.kind} {e.text}".lower()]
    # It looks at fifty times as many, and leaves out nothing of these.
    assert [e.stamp_ns for e in page.events] == [e.stamp_ns for e in wanted][: len(page.events)]
    assert {*page.events} <= {*wanted}
    if page.complete:
        assert len(page.events) == len(wanted)
    else:
        assert len(page.events) == most or len(old) > 50 * most


def _note(notes: Notes, ms: int, machine: str = "M", **status: object) -> None:
    status = {"state": "A", "pid": 7, **status}
    sample = Sample(MachineStatus(**status), ms, ms * MS, 7)  # type: ignore[arg-type]
    notes.take_status(machine, sample)


def test_what_is_new_in_a_status_is_noted_once() -> None:
    notes = Notes()
    _note(notes, 0)
    _note(notes, 100, paused="breakpoint M:A")
    _note(notes, 120, "Other", paused="breakpoint M:A")  # of the same process
    _note(notes, 350, paused="breakpoint M:A", overridden=(OverriddenSensor("pose"),))
    _note(notes, 600)
    _note(notes, 900, failed=True, error="A, OnEntry: no plan", error_s=0.25)
    _note(notes, 1150, failed=True, error="A, OnEntry: no plan", error_s=0.5)
    _note(notes, 1200, loaded=False)
    assert [(note.stamp_ns // MS, note.text) for note in notes.all] == [
        (100, "paused: breakpoint M:A"),
        (350, "pose is overridden"),
        (600, "continued"),
        (600, "pose is released"),
        (650, "failed: A, OnEntry: no plan"),
    ]


def test_a_request_is_noted_unless_it_only_renews_a_pause() -> None:
    notes = Notes()
    requests = [MachineRequest("suspend"), MachineRequest("renew"), MachineRequest("break", "M:A")]
    for count, request in enumerate(requests, 1):
        for _ in range(2):
            notes.take_request("M", Sample(request, count, count * MS, 1))
    assert [each.text for each in notes.all] == ["request: suspend", "request: break M:A"]


def test_a_page_is_given_the_events_of_a_live_board(board: str, start: Callable[..., Any]) -> None:
    with Whiteboard(board) as wb:
        wb.add_message(status_slot("M"), MachineStatus("A", paused="pause"))
        wb.add_message(request_slot("M"), MachineRequest("step", "round"))
        server = start(Server, board)
        with server.live():

            def events(query: str = "") -> Any:
                return server.get("/log", f"{server.query}&{query}").json()["events"]

            kinds = {"paused", "request"}
            wait_for(lambda: kinds <= {each[2] for each in events()}, "both were seen")
            stamp_s, *request = events("words=step")[0]
            assert request == ["M", "request", "request: step round"]
            assert abs(stamp_s - time.time()) < 10 * PATIENCE_S  # the time of day
            assert len(events("most=1")) == 1
            assert events(f"until={stamp_s - 3600}") == []
        for query in ("most=0", "most=many", "most=99999", "until=nan", "until=1e300"):
            answer = server.get("/log", f"{server.query}&{query}")
            assert answer.status_code == 400
            assert "invalid request" in answer.json()["problem"]
