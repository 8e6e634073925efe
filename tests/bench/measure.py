"""How to measure on a machine that is never quiet.

Two neighbours are sampled in turns, A B B A. A sample of a third of a millisecond is much shorter
than a time slice, so nearly every pair runs wholly beside somebody else's work or wholly without
it, and its ratio is the same in both. (With samples as long as a time slice, one neighbour can
get all the bad slices, and ratios are off by a factor of two.)
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from timeit import Timer
from typing import NamedTuple, TypeAlias

__all__ = [
    "Meter",
    "Pace",
    "Sampler",
    "Side",
    "Subject",
    "in_turns",
    "process",
    "statement",
    "wait_for",
]

_PAUSE_S = 0.02  # so that each message is alone, and no slot changes as often as it may leave
_PATIENCE_S = 30.0

Sampler: TypeAlias = Callable[[], float]
"""Takes one sample: nanoseconds, or bytes."""


class Pace(NamedTuple):
    """How long to measure."""

    samples: int  # of a statement
    sample_s: float
    processes: int  # samples of a whole process
    idle_s: float  # of waiting for a message
    schedule_s: float  # of keeping to a timetable
    bridge: tuple[int, float]  # rounds, and seconds of each
    page_s: float  # of showing a page


@dataclass(frozen=True)
class Subject:
    """A statement to time, as a user would write it, and the names in it."""

    statement: str
    names: dict[str, object]
    operations: int = 1  # in one execution of the statement
    before: str | None = None  # untimed, before each execution


class Meter(NamedTuple):
    """Who is measured, and how; there is no sampler for a peer that is not installed."""

    who: str
    call: str
    sample: Sampler | None


class Side(NamedTuple):
    """Who was measured, and what came out."""

    who: str
    call: str
    samples: list[float]


def statement(who: str, subject: Subject | None, sample_s: float) -> Meter:
    """Time a statement for about `sample_s` seconds a sample: nanoseconds an operation."""
    if subject is None:
        return Meter(who, "", None)
    timer = Timer(subject.statement, subject.before or "pass", globals=subject.names)

    def seconds(times: int) -> float:
        if subject.before is None:
            return timer.timeit(times)
        return sum(timer.timeit(1) for _ in range(times))

    times = 1
    while (taken := min(seconds(times) for _ in range(5))) < sample_s / 4:
        times *= 2
    times = max(1, round(times * sample_s / taken))
    return Meter(
        who,
        subject.statement,
        lambda: seconds(times) / (times * subject.operations) * 1e9,
    )


def process(who: str, *command: str) -> Meter:
    """Run a whole process: nanoseconds from before its start to after its end."""

    def sample() -> float:
        begin_ns = time.perf_counter_ns()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter_ns() - begin_ns

    return Meter(who, " ".join(command[1:]), sample)


def wait_for(arrived: Callable[[], object]) -> None:
    """Wait for a message, looking so rarely that this is not in its way."""
    begin = time.monotonic()
    while not arrived():
        time.sleep(_PAUSE_S)
        if time.monotonic() - begin > _PATIENCE_S:
            raise TimeoutError("a message did not arrive")


def in_turns(meters: list[Meter], times: int) -> list[Side]:
    """Take so many samples with each meter, in turns."""
    sides = [Side(meter.who, meter.call, []) for meter in meters]
    turn = list(zip(meters, sides, strict=True))
    for _ in range(times):
        for meter, side in turn:
            if meter.sample is not None:
                side.samples.append(meter.sample())
        turn.reverse()
    return sides
