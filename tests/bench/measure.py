"""How to measure on a machine that is never quiet.

Two neighbours are sampled in turns, A B B A. A sample of a third of a millisecond is much shorter
than a time slice, so nearly every pair runs wholly beside somebody else's work or wholly without
it, and its ratio is the same in both. (With samples as long as a time slice, one neighbour can
get all the bad slices, and ratios are off by a factor of two.)
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from timeit import Timer
from typing import Any, NamedTuple, TypeAlias

__all__ = [
    "Meter",
    "Pace",
    "Sampler",
    "Side",
    "Subject",
    "answering",
    "compiled",
    "counts",
    "in_turns",
    "process",
    "statement",
    "undisturbed",
    "wait_for",
]

_PAUSE_S = 0.02  # so that each message is alone, and no slot changes as often as it may leave
_PATIENCE_S = 30.0
_WAITED_NS = 20_000  # it takes less to get a processor that is free
_BEHIND_NS = 1_000_000  # a period

Sampler: TypeAlias = Callable[[], float]
"""Takes one sample: nanoseconds, or bytes."""
Proof: TypeAlias = tuple[Callable[[], Any], Callable[[Any, Any], bool]]


def counts(look: Callable[[], int], more: int = 1) -> Proof:
    """Make the proof that a number grows by so much with each execution."""
    return look, lambda before, after: after - before == more


class Pace(NamedTuple):
    """How long to measure."""

    samples: int  # of a statement
    sample_s: float
    processes: int  # samples of a whole process
    idle_s: float  # of waiting for a message
    schedule_s: float  # of keeping to a timetable
    bridge: tuple[int, float]  # rounds, and seconds of each
    through: tuple[int, float] | None  # likewise, through a bridge
    fleet_s: float | None  # of hosts that read of each other
    page_s: float  # of showing a page
    edits: int  # of each kind, on a page
    explorations: tuple[int, int | None]  # of a microwave; states of two ovens, None for all
    reversed_turns: tuple[int, int]  # turns of a recording, and places in it


@dataclass(frozen=True)
class Subject:
    """A statement to time, as a user would write it, and the names in it."""

    statement: str
    names: dict[str, object]
    operations: int = 1  # in one execution of the statement
    before: str | None = None  # untimed, before each execution
    proof: Proof | None = None
    """What is to be seen before an execution and after it, and how these have to differ."""

    def check(self) -> None:
        """Execute it once; raise AssertionError if it does not do its work."""
        assert self.proof is not None, f"{self.statement}: nothing shows that it does its work"
        look, differs = self.proof
        before = look()
        exec(self.before or "pass", self.names)
        exec(self.statement, self.names)
        after = look()
        assert differs(before, after), f"{self.statement}: {before} before, {after} after"


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
    subject.check()
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


@contextmanager
def compiled(source: str) -> Iterator[str | None]:
    """Compile a program in C that lies here, and yield its path; None without a compiler."""
    compiler = shlex.split(os.environ.get("CC", "cc"))
    if not shutil.which(compiler[0]):
        yield None
        return
    with TemporaryDirectory() as folder:
        program = str(Path(folder, "program"))
        path = str(Path(__file__).with_name(source))
        subprocess.run([*compiler, "-std=c11", "-O2", path, "-o", program], check=True)
        yield program


@contextmanager
def answering(*command: str) -> Iterator[Callable[[], str]]:
    """Start a process that answers each line by one; yield what returns its next answer."""
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, text=True, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL
    ) as process:
        asks, answers = process.stdin, process.stdout
        assert asks is not None
        assert answers is not None

        def ask() -> str:
            asks.write("\n")
            asks.flush()
            return answers.readline().strip()

        yield ask


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


def undisturbed(printed: list[int], starting: int) -> list[float]:
    """Return the lateness of the rounds for which no other process had the processor.

    Nor a while ago, so that this one was still behind: what is left is the program's own, and not
    what else runs here. `printed` are, for each round, the nanoseconds by which it was late, and
    for which the thread had waited for a processor by then. The first `starting` do not count.
    """
    late, waited = printed[0:-1:2], printed[1::2]
    found: list[float] = []
    behind = True
    for number in range(starting, len(late)):
        others = waited[number] - waited[number - 1] > _WAITED_NS
        behind = others or (behind and late[number] > _BEHIND_NS)
        if not behind:
            found.append(float(late[number]))
    return found
