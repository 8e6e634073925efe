"""What is timed of llfsm."""

from __future__ import annotations

import operator
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from measure import Sampler, Subject, counts

from llfsm.machines import RosWallTurttleBot
from llfsm.runtime import (
    Arrangement,
    Machine,
    ManualClock,
    MonotonicClock,
    State,
    TimeSlot,
    Timetable,
)
from llfsm.runtime.bundles import Bundle, BundleState, BundleTransition, Fragment, compile_bundle
from llfsm.runtime.debugging import Debugger
from llfsm.runtime.engine.schedule import Pacer
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3

sys.path.append(str(Path(__file__).parents[1]))
from definition import Defined

__all__ = ["MANY", "nonstop", "subjects"]

MANY = 1000
_WALLS = 100
_NONSTOP = 10_000  # rounds: some of the times at which others see the machines, too
_READERS = 100
_BUILD = "Twist(Vector3(1.0, 2.0, 3.0), Vector3(4.0, 5.0, 6.0))"


class Firing(Machine):
    """Go to and fro."""

    ping = State()
    pong = State()
    ping.to(pong)
    pong.to(ping)


class Guarded(Machine):
    """Go to and fro, each time because a guard says so."""

    ping = State()
    pong = State()

    @ping.to(pong)
    def served(self) -> bool:
        return True

    @pong.to(ping)
    def returned(self) -> bool:
        return True


class Staying(Machine):
    """Stay, because a guard says so."""

    here = State()
    there = State()

    @here.to(there)
    def leaving(self) -> bool:
        return False

    there.to(here)

    def empty(self) -> None:
        """Cost what any method call costs on this machine."""


class Counting(Machine):
    """Count turns; the bundle below says the same."""

    count: int = 0

    here = State()
    there = State()

    @here.internal
    def _(self) -> None:
        self.count += 1

    @here.to(there)
    def full(self) -> bool:
        return self.count < 0


class Ticking(Machine):
    """Wait for a second, again and again, for a minute."""

    seconds: int = 0

    even = State()
    odd = State()
    done = State()
    even.to(done, when=lambda self: self.seconds >= 60)
    even.to(odd, after_ms=1000)
    odd.to(even, after_ms=1000)

    @odd.on_entry
    def _(self) -> None:
        self.seconds += 2


class Polled(Arrangement):
    """Run each round, also those that can change nothing."""

    analysis = None


_FULL = BundleTransition("there", Fragment("count < 0\n"))
COUNTING = Bundle(
    "CountingBundle",
    (
        BundleState("here", {"Internal": Fragment("count += 1\n")}, (_FULL,)),
        BundleState("there"),
    ),
    variables=Fragment("count: int = 0\n"),
)


@contextmanager
def subjects() -> Iterator[dict[str, Subject]]:
    """Make a board and machines to time, by a name for each."""
    name = f"bench-{os.getpid()}"
    with Whiteboard(name) as board, Whiteboard(name) as elsewhere:
        try:
            yield (
                _on_board(board, elsewhere) | _machines() | _paced() | _walls(board) | _minutes()
            )
        finally:
            board.remove()


def _on_board(board: Whiteboard, elsewhere: Whiteboard) -> dict[str, Subject]:
    slot = Slot("turtle1/cmd_vel", Twist)
    cmd = board[slot]
    # Handles of their own, so that each of them has the news still before it after one add.
    readers = [board.publisher(slot) for _ in range(_READERS)]
    names = {
        "board": board,
        "CMD_VEL": slot,
        "cmd": cmd,
        "sender": elsewhere[slot],
        "readers": readers,
        "Twist": Twist,
        "Vector3": Vector3,
        "twist": Twist(Vector3(1.0, 2.0, 3.0), Vector3(4.0, 5.0, 6.0)),
    }
    board.add_message(slot, Twist())
    made: dict[int, Twist | None] = {}  # by identity; they are kept, so that none has another's

    def messages() -> int:
        made.update({id(each): each for each in (reader.get() for reader in readers)})
        return len(made)

    added = counts(lambda: cmd.count)
    nothing_new = cmd.get, operator.is_
    return {
        "get": Subject("cmd.get()", names, proof=nothing_new),
        "get_message": Subject("board.get_message(CMD_VEL)", names, proof=nothing_new),
        # One untimed add, then a hundred readers of the slot get it: nothing but gets is timed,
        # and each of them notices the news, copies it, makes a new message of six new floats,
        # and drops the message before it. The peers run the same loop.
        "get news": Subject(
            "for reader in readers: reader.get()",
            names,
            _READERS,
            before="sender.add(twist)",
            proof=counts(messages, _READERS),
        ),
        "add": Subject("cmd.add(twist)", names, proof=added),
        "build and add": Subject(f"cmd.add({_BUILD})", names, proof=added),
    }


def _turns(arrangement: Arrangement) -> Subject:
    """Time a round of an arrangement, a turn of each machine."""
    machines = len(arrangement.machines)
    turns = counts(lambda: _turns_of(arrangement), machines)
    return Subject("arrangement.round()", {"arrangement": arrangement}, machines, proof=turns)


def _turns_of(arrangement: Arrangement) -> int:
    return sum(seat.ringlets for seat in arrangement.roster)


def _machines() -> dict[str, Subject]:
    many = [Staying() for _ in range(MANY)]
    bundle = compile_bundle(COUNTING)
    classes, watched, others = ([Counting() for _ in range(MANY)] for _ in range(3))
    debugged, released = ([Counting() for _ in range(MANY)] for _ in range(2))
    bundles = [bundle() for _ in range(MANY)]
    ten, ten_timed = ([Counting() for _ in range(10)] for _ in range(2))
    observed = Arrangement(watched, observers=[lambda event: None])
    with_breakpoints = Arrangement(debugged)
    Debugger(with_breakpoints).break_at(*(f"Counting.{i}:there->" for i in range(20)))
    without_breakpoints = Arrangement(released)
    Debugger(without_breakpoints).break_at("Counting:there")
    Debugger.of(without_breakpoints).break_at()
    return {
        "firing": _turns(Arrangement([Firing])),
        "guarded": _turns(Arrangement([Guarded])),
        "class": _turns(Arrangement(classes)),
        "bundle": _turns(Arrangement(bundles)),
        "observed": _turns(observed),
        "breakpoints": _turns(with_breakpoints),
        "no breakpoints": _turns(without_breakpoints),
        "timed": _turns(Arrangement(others, timed=True)),
        "ten": _turns(Arrangement(ten)),
        "ten timed": _turns(Arrangement(ten_timed, timed=True)),
        "many": _turns(Arrangement(many)),
        "many, defined": _turns(Defined([Staying() for _ in range(MANY)])),
        "firing, defined": _turns(Defined([Firing])),
        "empty method": Subject(
            "machine.empty()", {"machine": Staying()}, proof=(int, operator.eq)
        ),
    }


class Hurried(MonotonicClock):
    """A clock of which nobody waits for a time."""

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at once."""


class Unmeasured(Pacer):
    """Wait for turns, and measure nothing."""

    def wait(self, due_ns: int, deadline_ns: int, lateness: object) -> bool:
        """Sleep until a turn is due; return False if it is not wanted."""
        return self.sleep_until(due_ns)


def _paced() -> dict[str, Subject]:
    """Make ten machines whose turns are due at once, with a stopwatch and with none."""
    names = [f"machine{number}" for number in range(10)]
    slots = Timetable([TimeSlot(name, start, 1) for start, name in enumerate(names)], 1000)
    found = {}
    for what, plan in (("period", {"period_us": 1000}), ("timetable", {"timetable": slots})):
        for suffix in ("", ", untimed"):
            arrangement = Arrangement(clock=Hurried(), **plan)
            for name in names:
                arrangement.load(Counting(), name=name)
            if suffix:
                arrangement.kernel.stopwatch = None
                arrangement.kernel.pacer.__class__ = Unmeasured
            found[what + suffix] = _turns(arrangement)
    return found


def _walls(board: Whiteboard) -> dict[str, Subject]:
    """Make a hundred of the machine that ships, as it drives: it waits for a second at a time."""

    def driving(kind: type[Arrangement]) -> Subject:
        arrangement = kind([RosWallTurttleBot() for _ in range(_WALLS)], whiteboard=board)

        def restart() -> None:
            for machine in arrangement.machines:
                arrangement.restart(machine.name)
            arrangement.round()

        names = {"round": arrangement.round, "restart": restart}
        turns = counts(lambda: _turns_of(arrangement), 2 * _WALLS)  # a restart has a round, too
        return Subject("round()", names, _WALLS, "restart()", turns)

    return {"wall": driving(Arrangement), "wall, defined": driving(Defined)}


def _minutes() -> dict[str, Subject]:
    """Run a simulated minute of ten machines that wait for a second at a time."""

    def minute(kind: type[Arrangement]) -> Subject:
        seconds = [0]

        def run() -> None:
            machines = [Ticking() for _ in range(10)]
            kind(machines, clock=ManualClock()).run()
            seconds[0] += sum(machine.seconds for machine in machines)

        return Subject("run()", {"run": run}, proof=counts(lambda: seconds[0], 600))

    return {"minute": minute(Arrangement), "minute, polled": minute(Polled)}


class Timing(Machine):
    """Note the processor's time at the first turn and at the last."""

    turns: int = 0
    begin_ns: int = 0
    end_ns: int = 0

    timing = State()
    done = State()

    @timing.on_entry
    def _(self) -> None:
        self.begin_ns = time.process_time_ns()

    @timing.internal
    def _(self) -> None:
        self.turns += 1

    @timing.to(done)
    def over(self) -> bool:
        return self.turns == _NONSTOP

    @done.on_entry
    def _(self) -> None:
        self.end_ns = time.process_time_ns()


@contextmanager
def nonstop() -> Iterator[Sampler]:
    """Make a board, and what runs a hundred machines there without a rest.

    With all that a run does between rounds: others see the machines and may make requests. A sample
    is the processor's nanoseconds of a ringlet.
    """

    def sample() -> float:
        timing, walls = Timing(), [RosWallTurttleBot() for _ in range(_WALLS)]
        arrangement = Arrangement([timing, *walls], whiteboard=board, idle_us=0)
        arrangement.run(max_rounds=_NONSTOP + 2)
        return (timing.end_ns - timing.begin_ns) / (_NONSTOP * _WALLS)

    with Whiteboard(f"bench-{os.getpid()}-nonstop") as board:
        try:
            yield sample
        finally:
            board.remove()
