"""Random machines run for real, in a world of its own pace: each turn is one that was explored.

A run has the host's clock, a board and a period. Beside it a thread posts messages and sends
requests as other processes do, a signal asks it to stop at any moment, and another process stops
and continues it. After each turn the explored states are followed that agree with what is seen;
there must be some. Runs without a period are of machines that do not ask for the time: in their
rounds time passes, which no exploration covers.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Literal, NamedTuple

from hypothesis import strategies as st

from agreement import DOMAINS, Turns, timetable_of, turns
from containment import Follower
from llfsm.errors import LlfsmError
from llfsm.runtime import Arrangement, ExecutionError, ObserverError
from llfsm.runtime.engine.events import Event, RoundEnd, Turn
from llfsm.runtime.engine.kernel import OnError
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.runtime.presence.remote import Directory
from llfsm.runtime.verification import UnsupportedError, explore
from llfsm.whiteboard import Slot
from llfsm.whiteboard.local import LocalBoard
from random_machines import (
    AGAIN,
    FRESH,
    LEFT,
    RIGHT,
    Ages,
    ages,
    built,
    resumptions,
    specs,
)

__all__ = ["RealRun", "assert_real_run_contained", "real_runs"]


_RUNS = 5  # at most, until one misses no period


class RealRun(NamedTuple):
    """Machines, as `built` makes them, how they run, and the seed of their world."""

    machines: Any
    unload_accepting: bool
    period_ms: Literal[2, 5]
    on_error: OnError
    seed: int
    stopped: bool = False
    """True if the process is stopped and continued meanwhile."""
    ages: Ages = FRESH
    resumed: Any = AGAIN
    """The options of the machines' states."""
    turns: Turns | None = None
    """If not None, when which machines have their turns, in the place of a period."""
    idle: bool = False
    """True for a run without either, of machines that do not ask for the time."""

    @property
    def schedule(self) -> dict[str, Any]:
        """Return the arguments of an `Arrangement` for the times of turns."""
        if self.idle:
            return {"idle_us": self.period_ms * 1_000}
        if self.turns is None or self.stopped:
            return {"period_us": self.period_ms * 1_000}
        return {"timetable": timetable_of(self.turns, len(self.machines))}


real_runs = st.builds(
    RealRun,
    specs,
    st.booleans(),
    st.sampled_from([2, 5]),
    st.sampled_from(["stop", "suspend"]),
    st.integers(0, 10**6),
    st.booleans(),
    ages,
    resumptions,
    st.none() | turns,
    st.sampled_from([False, False, True]),
)


def timeless(drawn: Any) -> Any:
    """Return drawn machines without what asks for the time."""
    return [
        [
            (
                {
                    section: [deed for deed in deeds if deed[0] != "late"]
                    for section, deeds in sections.items()
                },
                [
                    (target, None if guard and guard[0] == "after" else guard, None)
                    for target, guard, _ in transitions
                ],
            )
            for sections, transitions in states
        ]
        for states in drawn
    ]


def assert_real_run_contained(run: RealRun, *, most: int, rounds: int = 60) -> bool:
    """Run the machines for real; return False if there are too many states, or they are refused.

    A run that is not `stopped` must miss no whole period, as its exploration has none that is
    missed. On a busy machine it may; one that did and was not explored is made again.
    """
    if run.idle:
        run = run._replace(machines=timeless(run.machines), ages=FRESH)
    how: dict[str, Any] = {"unload_accepting": run.unload_accepting, "on_error": run.on_error}
    timetable = run.schedule.get("timetable")
    try:
        space = explore(
            built(run.machines, run.ages, run.resumed),
            period_ms=None if timetable or run.idle else run.period_ms,
            timetable=timetable,
            sensors=DOMAINS,
            stop=True,
            suspend="A",
            max_states=most,
            skips=run.stopped and not run.idle,
            **how,
        )
    except UnsupportedError:
        return False
    if not space.complete:
        return False
    for _ in range(_RUNS - 1):
        try:
            _follow(run, space, rounds, how)
        except _MissedPeriodError:
            continue
        return True
    _follow(run, space, rounds, how)
    return True


class _MissedPeriodError(Exception):
    """A run was not explored, and has missed a whole period."""


def _follow(run: RealRun, space: Any, rounds: int, how: dict[str, Any]) -> None:
    """Run the machines for real, and find each of their turns in what was explored."""
    environment = _Observed(LocalBoard())
    environment.whiteboard.add_message(RIGHT, DOMAINS[RIGHT][0])
    follower = Follower(space, environment)
    turn = ""

    def look(event: Event) -> None:
        nonlocal turn
        if isinstance(event, Turn | RoundEnd):
            if turn:
                follower.follow_seen(turn)
            turn = event.machine if isinstance(event, Turn) else ""

    arrangement = Arrangement(
        built(run.machines, run.ages, run.resumed),
        environment=environment,
        **run.schedule,
        observers=[look],
        **how,
    )
    with (
        _world(environment.whiteboard, run.seed),
        _stops(os.getpid(), wanted=run.stopped),
        _signals(arrangement, run.seed),
    ):
        try:
            arrangement.run(max_rounds=rounds, grace_s=0.05)
        except ExecutionError:
            follower.follow(turn, lambda state: state & space.search.tables.failed.mask)
        except ObserverError as error:
            if not (run.stopped or run.idle) and _worst_us(arrangement) >= run.period_ms * 1_000:
                raise _MissedPeriodError(str(error)) from error
            raise


def _worst_us(arrangement: Arrangement) -> float:
    """Return by how much the latest turn of a run began after it was due."""
    each = arrangement.statistics()
    return max((of.late_us.max for of in each if of.late_us is not None), default=0.0)


class _Observed(LiveEnvironment):
    """A live environment whose machines are kept, also those that have left."""

    def __init__(self, board: LocalBoard) -> None:
        super().__init__(board)
        self.machines: dict[str, Any] = {}
        self._arrangement: Arrangement | None = None

    def enter(self, arrangement: Arrangement) -> None:
        super().enter(arrangement)
        self._arrangement = arrangement

    def loaded(self, machine: str, path: str) -> None:
        super().loaded(machine, path)
        assert self._arrangement is not None
        self.machines[machine] = self._arrangement.machine(machine)

    def content(self, slot: Slot[Any]) -> Any:
        return self.whiteboard.get_message(slot)


@contextmanager
def _world(board: Any, seed: int) -> Iterator[None]:
    """Post and ask at random, on a thread, until this is left."""
    drawn, over = random.Random(seed), threading.Event()

    def act() -> None:
        while not over.wait(drawn.expovariate(1) * 1e-3):
            slot = drawn.choice([LEFT, RIGHT])
            message = drawn.choice(DOMAINS[slot])
            if message is not None:
                board.add_message(slot, message)
            if drawn.random() < 0.2:
                with suppress(LlfsmError):
                    Directory(board).find("A").request(
                        drawn.choice(["suspend", "resume", "restart"])
                    )

    thread = threading.Thread(target=act)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def _signals(arrangement: Arrangement, seed: int) -> Iterator[None]:
    """Ask for a stop by a signal, at a random moment in most runs."""
    drawn = random.Random(seed + 1)
    before = signal.signal(signal.SIGALRM, lambda *_: arrangement.stop("a signal"))
    signal.setitimer(signal.ITIMER_REAL, drawn.choice([0.0, 0.003, 0.01, 0.03]) * drawn.random())
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


# Whoever ends it closes its input, and does not kill it: it would leave the other one stopped.
_STOPPER = """
import os, random, select, signal, sys, time
pid = int(sys.argv[1])
while not select.select([0], [], [], random.expovariate(200))[0]:
    os.kill(pid, signal.SIGSTOP)
    time.sleep(random.choice([0.0005, 0.004, 0.02]))
    os.kill(pid, signal.SIGCONT)
"""


@contextmanager
def _stops(pid: int, *, wanted: bool) -> Iterator[None]:
    """Let another process stop and continue this one, again and again."""
    if not wanted:
        yield
        return
    command = [sys.executable, "-c", _STOPPER, str(pid)]
    with subprocess.Popen(command, stdin=subprocess.PIPE):  # its end closes that, and waits
        yield
