"""What safe values, last wills, a guard and a watchdog cost, beside the same without them."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

from measure import Meter, Sampler, Subject, counts

from llfsm.runtime import Actuator, Arrangement, Machine, State
from llfsm.runtime.engine.environment import BoardEnvironment
from llfsm.runtime.engine.watchdog import Watchdog
from llfsm.runtime.presence.will import Will
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3
from llfsm.whiteboard.messages.llfsm import will_slot

__all__ = ["guarded", "watched"]

_CMD_VEL = Slot("turtle1/cmd_vel", Twist)
_GO, _ZERO = Twist(Vector3(1.0)), Twist()
_ROUNDS = 20_000  # some tenths of a second, in which a watchdog looks several times


class Plain(Machine):
    """Post in every turn."""

    drive = Actuator(_CMD_VEL)

    here = State()
    there = State()

    @here.internal
    def _(self) -> None:
        self.drive(_GO)

    here.to(there, when=lambda m: False)


class Safe(Plain):
    """Have safe values, too."""

    drive = Actuator(_CMD_VEL, at_suspend=_ZERO, at_end=_ZERO, at_failure=_ZERO, exclusive=True)


class Guarded:
    """Boards with and without what is measured."""

    def __init__(self, stack: ExitStack):
        folders = [stack.enter_context(tempfile.TemporaryDirectory(dir="/dev/shm")) for _ in "ab"]
        boards = [stack.enter_context(Whiteboard("bench", directory=each)) for each in folders]
        # As a run leaves it: what the guard watches while the calls below are timed.
        Will(boards[0], "Safe", [(_CMD_VEL, _ZERO)], 0).leave()
        self._guard = stack.enter_context(_guard(folders[0]))
        self._guarded = boards[0]
        safe, plain = Safe(), Plain()
        arrangements = [
            stack.enter_context(Arrangement([safe], whiteboard=boards[0])),
            stack.enter_context(Arrangement([plain], environment=BoardEnvironment(boards[1]))),
        ]
        added = [counts(partial(_count, board)) for board in boards]
        self.ringlets = [
            Subject("arrangement.round()", {"arrangement": each}, proof=proof)
            for each, proof in zip(arrangements, added, strict=True)
        ]
        self.adds = [
            Subject("add(message)", {"add": add, "message": _GO}, proof=proof)
            for add, proof in zip((safe.drive, boards[1][_CMD_VEL].add), added, strict=True)
        ]

    def is_guarded(self) -> bool:
        """Return whether there is a will that the guard has to watch."""
        will = self._guarded.get_message(will_slot("Safe"))
        return will is not None and will.state == "left" and bool(will.values)

    def percent(self, seconds: float) -> float:
        """Let a machine post for so long; return the part of a core that the guard takes."""
        before_ns, begin_ns = self._cpu_ns(), time.monotonic_ns()
        arrangement = self.ringlets[0].names["arrangement"]
        assert isinstance(arrangement, Arrangement)
        rounds = round(seconds * 100)  # with 10 ms between them
        arrangement.run(max_rounds=arrangement.rounds + rounds)
        return 100 * (self._cpu_ns() - before_ns) / (time.monotonic_ns() - begin_ns)

    def _cpu_ns(self) -> int:
        tasks = Path(f"/proc/{self._guard.pid}/task").glob("*/schedstat")
        return sum(int(task.read_text().split()[0]) for task in tasks)


def _count(board: Whiteboard) -> int:
    return board[_CMD_VEL].count


@contextmanager
def guarded() -> Iterator[Guarded]:
    """Yield a board with a guard and a machine with safe values, and one with neither."""
    with ExitStack() as stack:
        yield Guarded(stack)


@contextmanager
def _guard(folder: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "llfsm.cli", "guard", "--directory", folder, "-b", "bench"]
    guard = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert guard.stderr is not None
        assert "guarding" in guard.stderr.readline()
        yield guard
    finally:
        guard.kill()
        guard.communicate()


def watched() -> list[Meter]:
    """Return what takes the processor's time for a ringlet beside a watchdog, and without."""

    def sampler(limit_s: float | None) -> Sampler:
        arrangement = Arrangement([Plain()], whiteboard=Whiteboard.local())

        def sample() -> float:
            watchdog = None if limit_s is None else Watchdog(arrangement.kernel, limit_s)
            if watchdog is not None:
                watchdog.start()
            begin_ns = time.process_time_ns()
            for _ in range(_ROUNDS):
                arrangement.round()
            taken_ns = time.process_time_ns() - begin_ns
            if watchdog is not None:
                watchdog.stop()
            return taken_ns / _ROUNDS

        return sample

    call = "arrangement.round(), time of the processor"
    return [Meter("llfsm", call, sampler(0.1)), Meter("unwatched", call, sampler(None))]
