"""What a page is told: with every frame it knows what the look knew, and nothing comes twice."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from llfsm.bridges.view.feed import Feed
from llfsm.bridges.view.source import Change, Look, Source
from llfsm.whiteboard import Message, Sample, Slot
from llfsm.whiteboard.board import SlotInfo
from llfsm.whiteboard.messages.llfsm import MachineStatus, status_slot


class Number(Message):
    value: float


class Fake(Source):
    """Tell what a test says."""

    title = "fake"

    def __init__(self) -> None:
        self.live = True
        self.changes: dict[str, list[Change]] = {}

    def look(self) -> Look:
        raise NotImplementedError

    def close(self) -> None:
        pass

    def is_live(self, sample: Sample[MachineStatus]) -> bool:
        return self.live

    def history(self) -> Mapping[str, Sequence[Change]]:
        return self.changes


def _info(slot: Slot[Any]) -> SlotInfo:
    return SlotInfo(slot.name, slot.type_name, slot.schema, slot.capacity)


def _look(samples: Mapping[str, Sample[Any]], now_ns: int = 0, epoch: int = 1, **more: Any) -> Look:
    slots = {
        name: _info(
            status_slot(name.rpartition("/")[2])
            if isinstance(sample.message, MachineStatus)
            else Slot(name, Number)
        )
        for name, sample in samples.items()
    }
    return Look(now_ns, epoch, slots, samples, **more)


def _frame(feed: Feed, look: Look) -> Any:
    frame = feed.frame(look, beat=False)
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
    looks: list[tuple[dict[str, int], int]],
) -> None:
    feed, page = Feed(Fake()), _Page()
    for now_ns, (counts, epoch) in enumerate(looks):
        samples = {
            name: Sample(Number(count + epoch / 10), count, now_ns, 1)
            for name, count in counts.items()
        }
        page.take(_frame(feed, _look(samples, now_ns, epoch)))
        assert page.values == {name: (count, count + epoch / 10) for name, count in counts.items()}


def test_what_has_not_changed_is_not_told_again() -> None:
    feed = Feed(Fake())
    look = _look({"a": Sample(Number(1.0), 1, 0, 7)})
    assert {"slots", "samples", "reset", "speed"} <= _frame(feed, look).keys()
    assert _frame(feed, look) is None
    beat = feed.frame(look, beat=True)
    assert beat is not None
    assert json.loads(beat) == {"now": 0.0}
    later = look._replace(samples={"a": Sample(Number(2.0), 2, 5_000_000_000, 8)})
    assert _frame(feed, later) == {"now": 0.0, "samples": [[0, 2, 5.0, 8, [2.0]]]}


def test_in_trouble_what_was_there_stays() -> None:
    feed = Feed(Fake())
    _frame(feed, _look({"a": Sample(Number(1.0), 1, 0, 7)}))
    frame = _frame(feed, Look(1, 1, {}, {}, trouble="the board is gone"))
    assert frame.keys() == {"now", "trouble"}


def test_a_machine_is_running_suspended_silent_or_ended() -> None:
    source = Fake()
    feed = Feed(source)
    name = status_slot("M").name

    def told(now_s: float, status: MachineStatus) -> Any:
        sample = Sample(status, round(now_s * 10) + 1, 0, 1)
        frame = _frame(feed, _look({name: sample}, round(now_s * 1e9)))
        return frame["machines"]["M"]["condition"]

    assert told(0, MachineStatus("a")) == "running"
    assert told(0.1, MachineStatus("a", suspended=True)) == "suspended"
    assert told(1.5, MachineStatus("a")) == "silent"
    source.live = False
    assert told(1.6, MachineStatus("a")) == "ended"


def test_history_is_told_once_in_order_even_if_its_beginning_was_forgotten() -> None:
    source = Fake()
    feed = Feed(source)
    look = _look({})
    source.changes["M"] = [Change(1, "a", False), Change(2, "b", False)]
    assert [c[1] for c in _frame(feed, look)["history"]["M"]] == ["a", "b"]
    assert _frame(feed, look) is None
    source.changes["M"] = [Change(2, "b", False), Change(3, "c", True)]
    assert _frame(feed, look)["history"] == {"M": [[3e-9, "c", True, "", 0, False]]}
