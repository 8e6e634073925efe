"""With each frame a page knows what is in the snapshot, and nothing is sent twice."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.view.frames import FrameEncoder
from llfsm.bridges.view.page_source import Change, Note, PageSource, Snapshot
from llfsm.whiteboard import Message, Sample, Slot
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.liveness import host_name, pid_namespace
from llfsm.whiteboard.messages.llfsm import (
    Commander,
    Commanders,
    MachineStatus,
    commanders_slot,
    status_slot,
)


class Number(Message):
    value: float


class Fake(PageSource):
    """A source whose history and machines the test sets."""

    title = "fake"

    def __init__(self) -> None:
        self.live = True
        self.changes: dict[str, list[Change]] = {}

    def snapshot(self) -> Snapshot:
        raise NotImplementedError

    def close(self) -> None:
        pass

    def is_live(self, sample: Sample[MachineStatus]) -> bool:
        return self.live

    def history(self) -> Mapping[str, Sequence[Change]]:
        return self.changes

    def notes(self) -> Sequence[Note]:
        return ()


def _info(slot: Slot[Any]) -> SlotInfo:
    return SlotInfo(slot.name, slot.type_name, slot.schema, slot.capacity)


def _snapshot(
    samples: Mapping[str, Sample[Any]], now_ns: int = 0, epoch: int = 1, **more: Any
) -> Snapshot:
    slots = {
        name: _info(
            status_slot(name.rpartition("/")[2])
            if isinstance(sample.message, MachineStatus)
            else Slot(name, Number)
        )
        for name, sample in samples.items()
    }
    return Snapshot(now_ns, epoch, slots, samples, **more)


def _frame(encoder: FrameEncoder, snapshot: Snapshot) -> Any:
    frame = encoder.encode(snapshot, beat=False)
    return None if frame is None else json.loads(frame)


class _Page:
    """Do with frames what the page does."""

    def __init__(self) -> None:
        self.names: dict[int, str] = {}
        self.values: dict[str, tuple[int, float]] = {}

    def take(self, frame: Any) -> None:
        if frame is None:
            return
        if frame.get("reset"):
            self.__init__()  # type: ignore[misc]
        for number, name, *_ in frame.get("slots", []):
            self.names[number] = name
        for number, *rest in frame.get("samples", []):
            if rest:
                self.values[self.names[number]] = (rest[0], rest[3][0])
            else:
                del self.values[self.names[number]]


boards = st.dictionaries(st.sampled_from("abcde"), st.integers(1, 4), max_size=5)


@given(st.lists(st.tuples(boards, st.integers(1, 2))))
def test_a_page_that_has_each_frame_knows_what_is_on_the_board(
    snapshots: list[tuple[dict[str, int], int]],
) -> None:
    encoder, page = FrameEncoder(Fake()), _Page()
    for now_ns, (counts, epoch) in enumerate(snapshots):
        samples = {
            name: Sample(Number(count + epoch / 10), count, now_ns, 1)
            for name, count in counts.items()
        }
        page.take(_frame(encoder, _snapshot(samples, now_ns, epoch)))
        assert page.values == {name: (count, count + epoch / 10) for name, count in counts.items()}


def test_what_has_not_changed_is_not_sent_again() -> None:
    encoder = FrameEncoder(Fake())
    snapshot = _snapshot({"a": Sample(Number(1.0), 1, 0, 7)})
    assert {"slots", "samples", "reset", "speed"} <= _frame(encoder, snapshot).keys()
    assert _frame(encoder, snapshot) is None
    beat = encoder.encode(snapshot, beat=True)
    assert beat is not None
    assert json.loads(beat) == {"now": 0.0}
    later = snapshot._replace(samples={"a": Sample(Number(2.0), 2, 5_000_000_000, 8)})
    assert _frame(encoder, later) == {"now": 0.0, "samples": [[0, 2, 5.0, 8, [2.0]]]}


def test_in_trouble_what_was_there_stays() -> None:
    encoder = FrameEncoder(Fake())
    _frame(encoder, _snapshot({"a": Sample(Number(1.0), 1, 0, 7)}))
    frame = _frame(encoder, Snapshot(1, 1, {}, {}, trouble="the board is gone"))
    assert frame.keys() == {"now", "trouble"}


def test_a_machine_is_running_suspended_failed_hung_silent_or_ended() -> None:
    source = Fake()
    encoder = FrameEncoder(source)
    name = status_slot("M").name

    def condition(now_s: float, status: MachineStatus) -> Any:
        sample = Sample(status, round(now_s * 10) + 1, 0, 1)
        frame = _frame(encoder, _snapshot({name: sample}, round(now_s * 1e9)))
        machine = frame["machines"]["M"]
        assert (machine["error"], machine["error_state"]) == (status.error, status.error_state)
        return machine["condition"]

    assert condition(0, MachineStatus("a")) == "running"
    assert condition(0.1, MachineStatus("a", suspended=True)) == "suspended"
    failed = MachineStatus("s", suspended=True, failed=True, error="a, OnEntry", error_state="a")
    assert condition(0.2, failed) == "failed"
    assert condition(0.3, MachineStatus("a", hung=True, error="a, OnEntry")) == "hung"
    assert condition(1.5, MachineStatus("a")) == "silent"
    source.live = False
    assert condition(1.6, MachineStatus("a")) == "ended"


def test_a_slot_with_several_commanders_is_reported_while_they_are_published() -> None:
    source = Fake()
    encoder = FrameEncoder(source)
    both = [Commander(f"M{pid}", pid, 1, host_name(), pid_namespace(), 0) for pid in (5, 6)]
    claims = {commanders_slot("cmd").name: Sample(Commanders("cmd", tuple(both)), 1, 0, 1)}
    statuses = {
        status_slot(each.machine).name: Sample(
            MachineStatus("a", pid=each.pid, born=1, host=each.host, namespace=each.namespace),
            1,
            0,
            each.pid,
        )
        for each in both
    }
    sentence = "cmd has two commanders: M5 (pid 5), M6 (pid 6)"
    assert _frame(encoder, _snapshot(claims))["contested"] == []
    assert _frame(encoder, _snapshot(claims | statuses))["contested"] == [sentence]
    assert _frame(encoder, _snapshot(claims | statuses)) is None
    source.live = False
    assert _frame(encoder, _snapshot(claims | statuses))["contested"] == []


def test_history_is_sent_once_in_order_even_if_its_beginning_was_forgotten() -> None:
    source = Fake()
    encoder = FrameEncoder(source)
    snapshot = _snapshot({})
    source.changes["M"] = [Change(1, "a", False), Change(2, "b", False)]
    assert [c[1] for c in _frame(encoder, snapshot)["history"]["M"]] == ["a", "b"]
    assert _frame(encoder, snapshot) is None
    source.changes["M"] = [Change(2, "b", False), Change(3, "c", True)]
    assert _frame(encoder, snapshot)["history"] == {"M": [[3e-9, "c", True, "", 0, False, False]]}
