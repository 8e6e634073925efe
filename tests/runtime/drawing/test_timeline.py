"""A timeline's bars are the states that machines were in, and when."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from itertools import pairwise

import pytest

from llfsm.runtime import Arrangement, DrawingError, Machine, ManualClock, State, Trace
from llfsm.runtime.drawing import Stay, timeline


class Blinker(Machine):
    blinks: int = 2

    off = State()
    on = State()
    done = State()

    off.to(on, after_ms=100)
    on.to(done, when=lambda self: self.blinks == 1, after_ms=300)
    on.to(off, after_ms=300)

    @on.on_exit
    def _(self) -> None:
        self.blinks -= 1


def traced(**blinks: int) -> Trace:
    """Return what blinkers did, each called as its argument."""
    trace = Trace()
    arrangement = Arrangement(clock=ManualClock(), observers=[trace])
    for name, number in blinks.items():
        arrangement.load(Blinker, name=name, variables={"blinks": number})
    arrangement.run()
    return trace


def test_bars_meet_and_have_the_states_times() -> None:
    stays = timeline(traced(a=2, b=1))
    for name, blinks in (("a", 2), ("b", 1)):
        mine = [stay for stay in stays if stay.machine == name]
        assert [stay.state for stay in mine] == ["off", "on"] * blinks + ["done"]
        for before, after in pairwise(mine):
            assert before.end_ns == after.begin_ns
        for stay in mine:
            length = (stay.end_ns - stay.begin_ns) / 1e6
            expected = {"off": 100, "on": 300, "done": 0}[stay.state]
            assert expected <= length <= expected + 20  # two idle sleeps


def test_a_machine_that_stays_lasts_to_the_last_event() -> None:
    class Still(Machine):
        here = State()
        there = State()
        here.to(there, after_ms=1e6)

    trace = Trace()
    Arrangement([Still], clock=ManualClock(), observers=[trace]).run(max_rounds=5)
    (stay,) = timeline(trace)
    assert stay == Stay("Still", "here", 0, trace[-1].time_ns)
    assert stay.end_ns > 0


def test_the_picture_has_a_bar_for_each_stay_within_its_frame() -> None:
    drawn = timeline(traced(**{"<a&b>": 2}))
    svg = drawn._repr_svg_()
    assert svg == drawn.to_svg()
    root = ET.fromstring(svg)
    bars = [each for each in root.iter("{http://www.w3.org/2000/svg}rect") if each.get("stroke")]
    assert len(bars) == len(drawn) == 5
    width = float(root.get("width", 0))
    for bar in bars:
        left, size = float(bar.get("x", -1)), float(bar.get("width", 0))
        assert 0 < left < left + size < width
    assert "&lt;a&amp;b&gt;" in svg


def test_without_turns_there_is_nothing_to_draw() -> None:
    with pytest.raises(DrawingError, match="no machine had a turn"):
        timeline([])
