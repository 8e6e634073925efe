"""Timelines: a picture of a trace with a row for each machine, and a bar for each stay in a state.

A stay begins with the first turn in a state and ends with the first in another one, when the
machine is unloaded, or with the last event, which may be an idle sleep. Bars of one machine take
the same few colours in the order in which it entered its states. The picture is of one width; below
it is a scale of seconds since the first turn, with four to ten marks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from llfsm.runtime.drawing import style
from llfsm.runtime.drawing.shapes import Line, Picture, Rectangle, Shape, Text
from llfsm.runtime.drawing.svg import write_svg
from llfsm.runtime.drawing.typeset import printable, text_width
from llfsm.runtime.engine.errors import DrawingError
from llfsm.runtime.engine.events import Accepting, Event, IdleSleep, Turn

_WIDTH = 720.0  # of the time, however long it is
_ROW, _BAR = 34.0, 24.0  # their heights
_FILLS = ("#d7ebe5", "#dfe6f5", "#f6e7cf", "#f3dbe0", "#e6e0f3", "#e3ecd2")


class Stay(NamedTuple):
    """A machine was in a state between two times of the arrangement's clock, in nanoseconds."""

    machine: str
    state: str
    begin_ns: int
    end_ns: int


class Timeline(tuple[Stay, ...]):
    """The stays of several machines, in order of time; a notebook shows their picture."""

    def to_svg(self) -> str:
        """Write the picture as the text of an SVG file."""
        return write_svg(_picture(self))

    _repr_svg_ = to_svg


def timeline(events: Iterable[Event]) -> Timeline:
    """Find the stays of machines in the events of a `Trace`, to draw them.

    A machine is in a state from its first turn there to its first turn in another one, to its end,
    or to the last event. Raise `DrawingError` if no machine had a turn.
    """
    stays: list[Stay] = []
    since: dict[str, tuple[str, int]] = {}
    now = 0

    def leave(machine: str) -> None:
        state, begin = since.pop(machine)
        stays.append(Stay(machine, state, begin, now))

    for event in events:
        now = event.time_ns
        match event:
            case Turn(machine=machine, state=state):
                if machine in since and since[machine][0] != state:
                    leave(machine)
                since.setdefault(machine, (state, now))
            case Accepting(machine=machine, action="unloaded") if machine in since:
                leave(machine)
            case IdleSleep(duration_ns=duration):
                now += duration
    for machine in [*since]:
        leave(machine)
    if not stays:
        raise DrawingError("there is nothing to draw: no machine had a turn in these events")
    return Timeline(sorted(stays, key=lambda stay: stay.begin_ns))


def _picture(stays: Timeline) -> Picture:
    machines = list(dict.fromkeys(stay.machine for stay in stays))
    begin = stays[0].begin_ns
    total = max(max(stay.end_ns for stay in stays) - begin, 1)
    left = style.MARGIN * 2 + max(text_width(name, style.TITLE_SIZE) for name in machines)
    top = style.MARGIN
    bottom = top + _ROW * len(machines)

    def x(time_ns: int) -> float:
        return left + (time_ns - begin) / total * _WIDTH

    def shapes() -> Iterator[Shape]:
        for name, row in zip(machines, range(len(machines)), strict=True):
            middle = top + _ROW * (row + 0.5)
            width = text_width(name, style.TITLE_SIZE)
            yield Text(
                style.MARGIN + width / 2, middle + 5, printable(name), style.TITLE_SIZE, style.INK
            )
            states = list(dict.fromkeys(stay.state for stay in stays if stay.machine == name))
            for stay in stays:
                if stay.machine == name:
                    fill = _FILLS[states.index(stay.state) % len(_FILLS)]
                    yield from _bar(stay, x(stay.begin_ns), x(stay.end_ns), middle, fill)
        yield Line([(left, bottom + 4), (left + _WIDTH, bottom + 4)], style.EDGE, 1.0)
        step = _step_ns(total)
        for time in range(0, total + 1, step):
            at = x(begin + time)
            yield Line([(at, bottom + 4), (at, bottom + 9)], style.EDGE, 1.0)
            yield Text(at, bottom + 23, f"{time / 1e9:.9g} s", style.LABEL_SIZE, style.LABEL)

    width = left + _WIDTH + 2 * style.MARGIN
    return Picture(
        f"the states of {printable(', '.join(machines))} over time", width, bottom + 36,
        style.BACKGROUND, [*shapes()],
    )  # fmt: skip


def _step_ns(total: int) -> int:
    """Choose 1, 2 or 5 times a power of ten: the step between four to ten marks."""
    power: int = 10 ** max(len(str(total)) - 2, 0)
    return next(power * factor for factor in (1, 2, 5, 10, 20) if total <= power * factor * 10)


def _bar(stay: Stay, left: float, right: float, middle: float, fill: str) -> Iterator[Shape]:
    width = max(right - left, 1.0)
    yield Rectangle(left, middle - _BAR / 2, width, _BAR, 3.0, fill, style.BORDER, 1.0)
    name = printable(stay.state)
    if text_width(name, style.LABEL_SIZE) + 6 < width:
        yield Text(left + width / 2, middle + 4, name, style.LABEL_SIZE, style.LABEL)
