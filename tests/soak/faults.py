"""Let what drives a turtle fail in many ways, and measure for how long the turtle moves on.

`llfsm turtlesim` is the robot, `llfsm guard` guards it, and `llfsm run` runs the machine of
`faulty.py`, each in a process of its own. The fault comes at a random moment; what counts is the
last position at which the turtle has a speed. All kinds are tried in random order, ROUNDS times
each. The exit status is 1 if a turtle moves for longer than its kind allows:

    PYTHONPATH=tests .venv/bin/python tests/soak/faults.py [--rounds 9] [--seed 1] [KIND...]

The table that it prints is that of docs/how-to/safety.md. Without a guard the turtle has to move on
for longer, or nothing was measured.
"""

from __future__ import annotations

import argparse
import fcntl
import os
import pty
import random
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Self

from llfsm.whiteboard import BoardFullError, Slot, Whiteboard
from llfsm.whiteboard.messages.llfsm import BELL, Bell, MachineRequest, request_slot
from llfsm.whiteboard.messages.std_msgs import Int32, String
from llfsm.whiteboard.messages.turtlesim import Pose
from soak.faulty import FAULT
from waiting import wait_for

POSE = Slot("turtle1/pose", Pose)
MACHINE = f"{Path(__file__).with_name('faulty.py')}:Drive"
LLFSM = [sys.executable, "-m", "llfsm.cli"]
STILL = 0.01  # the speed of a turtle that stands
OVER_NS = 400_000_000  # without a speed: then it has stopped


class World:
    """A turtle, its guards, and the machine that drives it."""

    def __init__(self, folder: Path, guards: int) -> None:
        self._stack = ExitStack()
        self.folder = folder
        self.name = f"faults-{os.getpid()}"
        self.where = ["-b", self.name, "--directory", str(folder)]
        self._start("turtlesim")
        wait_for(lambda: (folder / f"llfsm.{self.name}").exists(), "the turtle is there")
        self.board = self._stack.enter_context(Whiteboard(self.name, directory=folder))
        self._pose = self.board[POSE]
        self.guards = [self._start("guard") for _ in range(guards)]
        wait_for(lambda: self._pose.count > 10, "it has a pose")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.board.remove()
        self._stack.close()

    def _start(self, *command: str, **how: Any) -> subprocess.Popen[bytes]:
        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL} | how
        process = subprocess.Popen([*LLFSM, *command, *self.where], **quiet)
        self._stack.callback(_end, process)
        return process

    @property
    def moves(self) -> bool:
        """True while the turtle has a speed."""
        pose = self._pose.get()
        return pose is not None and pose.linear_velocity > STILL

    def moved_ms(self, kind: Kind, chance: random.Random) -> float:
        """Let the machine drive and fail once; return for how long the turtle moves after that."""
        options = [word.format(self.folder / "file") for word in kind.options]
        with suppress(FileNotFoundError):
            (self.folder / "file").unlink()
        with ExitStack() as terminal:
            how: dict[str, Any] = {}
            if kind.fault is close_terminal:
                self.terminal, inner = pty.openpty()
                how = {"stdin": inner, "stdout": inner, "stderr": inner, "start_new_session": True}
                how["preexec_fn"] = _take_terminal
                terminal.callback(os.close, inner)
            process = self._start("run", MACHINE, "-q", *options, **how)
        try:
            wait_for(lambda: self.moves, "the turtle moves")
            time.sleep(0.0 if kind.fault is at_once else chance.uniform(0.1, 0.6))
            self.begin_ns = time.monotonic_ns()
            kind.fault(self, process)
            last_ns, still_ns = self.begin_ns, OVER_NS + kind.silent_ms * 1_000_000
            end_ns = self.begin_ns + kind.most_ms * 1_000_000 + 2 * OVER_NS
            while (now_ns := time.monotonic_ns()) < end_ns and now_ns - last_ns < still_ns:
                sample = self._pose.sample()
                assert sample is not None
                if sample.message.linear_velocity > STILL:
                    last_ns = max(last_ns, sample.stamp_ns)
                time.sleep(0.002)
            return (last_ns - self.begin_ns) / 1e6
        finally:
            _end(process)
            wait_for(lambda: not self.moves, "the turtle has stopped")


def _take_terminal() -> None:
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()  # also one that is stopped, which would drive on if it was continued before
    process.wait()


Fault = Callable[[World, "subprocess.Popen[bytes]"], object]


class Kind(NamedTuple):
    """A way to fail, the options of `llfsm run`, and for how long the turtle may move on."""

    name: str
    fault: Fault
    options: tuple[str, ...] = ()
    most_ms: int = 250
    silent_ms: int = 0
    """For how long nothing may happen before."""
    guards: int = 1
    fresh: bool = False
    """True if what is left of the world is not as before."""


def by_signal(number: int) -> Fault:
    return lambda world, process: process.send_signal(number)


def by_its_code(deed: str) -> Fault:
    return lambda world, process: world.board.add_message(FAULT, String(f"{deed}:{process.pid}"))


def by_request(action: str) -> Fault:
    def ask(world: World, process: object) -> None:
        world.board.add_message(request_slot("Drive"), MachineRequest(action))  # type: ignore[arg-type]
        world.board.add_message(BELL, Bell("Drive"))

    return ask


def at_once(world: World, process: subprocess.Popen[bytes]) -> None:
    process.kill()


def close_terminal(world: World, process: object) -> None:
    os.close(world.terminal)


def with_a_guard(world: World, process: subprocess.Popen[bytes]) -> None:
    world.guards[0].kill()
    process.kill()


def after_a_guard(world: World, process: subprocess.Popen[bytes]) -> None:
    world.guards[0].kill()
    time.sleep(0.05)
    world.begin_ns = time.monotonic_ns()
    process.kill()


def beside_a_stopped_guard(world: World, process: subprocess.Popen[bytes]) -> None:
    world.guards[0].send_signal(signal.SIGSTOP)
    process.kill()


def on_a_full_board(world: World, process: subprocess.Popen[bytes]) -> None:
    with suppress(BoardFullError):
        for number in range(5000):
            world.board.add_message(Slot(f"full{number}", Int32), Int32(number))
    world.begin_ns = time.monotonic_ns()
    process.kill()


UNGUARDED = "SIGKILL without a guard: a turtle stops by itself after a second"
SIGNALS = "KILL SEGV ABRT BUS ILL FPE QUIT HUP USR1 USR2 XCPU ALRM"
GRACE_MS = 1300  # a machine that does not accept has a second to do so
WATCHED = ("--watchdog", "100")
HEIRS = ("--will-after", "500")
KINDS = [
    *(Kind(f"SIG{name}", by_signal(signal.Signals[f"SIG{name}"])) for name in SIGNALS.split()),
    Kind("SIGINT", by_signal(signal.SIGINT), (), GRACE_MS),
    Kind("SIGTERM", by_signal(signal.SIGTERM), (), GRACE_MS),
    Kind("SIGKILL as soon as it drives", at_once),
    Kind("SIGKILL, --period 20000", by_signal(signal.SIGKILL), ("--period", "20000")),
    Kind("SIGKILL, --record", by_signal(signal.SIGKILL), ("--record", "{}")),
    Kind("SIGKILL, --keep", by_signal(signal.SIGKILL), ("--keep", "{}")),
    Kind("its terminal closes", close_terminal),
    Kind("a C function crashes", by_its_code("segfault")),
    Kind("a C function crashes in a thread", by_its_code("segfault in a thread")),
    Kind("abort", by_its_code("abort")),
    Kind("_exit(0)", by_its_code("exit 0")),
    Kind("_exit(1)", by_its_code("exit 1")),
    Kind("sys.exit", by_its_code("sys.exit")),
    Kind("an exception", by_its_code("raise")),
    Kind("an exception, --on-error suspend", by_its_code("raise"), ("--on-error", "suspend")),
    Kind("KeyboardInterrupt", by_its_code("interrupt"), (), GRACE_MS),
    Kind("GeneratorExit", by_its_code("leave")),
    Kind("endless recursion", by_its_code("recursion")),
    Kind("no more memory", by_its_code("no memory")),
    Kind("no more files", by_its_code("no files")),
    Kind("execv", by_its_code("exec")),
    Kind("a fork, and SIGKILL", by_its_code("fork")),
    Kind("the machine accepts", by_its_code("end")),
    Kind("an endless loop, --watchdog 100", by_its_code("loop"), WATCHED),
    Kind("a long wait, --watchdog 100", by_its_code("sleep"), WATCHED),
    Kind("a deadlock, --watchdog 100", by_its_code("deadlock"), WATCHED),
    Kind("a wait for a child, --watchdog 100", by_its_code("wait for a child"), WATCHED),
    Kind("an endless loop, --will-after 500", by_its_code("loop"), HEIRS, 800, 500),
    Kind("the lock held in C, --will-after 500", by_its_code("hold the lock"), HEIRS, 800, 500),
    Kind("SIGSTOP, --will-after 500", by_signal(signal.SIGSTOP), HEIRS, 800, 500),
    Kind("suspended by another process", by_request("suspend")),
    Kind("stopped by another process", by_request("stop"), (), GRACE_MS),
    Kind("SIGKILL, and of one of two guards", with_a_guard, guards=2, fresh=True),
    Kind("SIGKILL 50 ms after one of two guards", after_a_guard, guards=2, fresh=True),
    Kind("SIGKILL beside a stopped guard of two", beside_a_stopped_guard, guards=2, fresh=True),
    Kind("SIGKILL on a full whiteboard", on_a_full_board, fresh=True),
    Kind(UNGUARDED, by_signal(signal.SIGKILL), (), 1300, guards=0, fresh=True),
]  # fmt: skip


def main() -> int:
    """Try all kinds; print a table; return 1 if a turtle has moved for too long."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("kinds", nargs="*", metavar="KIND")
    options = parser.parse_args()
    chance = random.Random(options.seed)
    kinds = [each for each in KINDS if not options.kinds or each.name in options.kinds]
    order = [each for each in kinds for _ in range(options.rounds)]
    chance.shuffle(order)
    found: dict[str, list[float]] = {each.name: [] for each in kinds}
    with TemporaryDirectory(dir="/dev/shm") as folder:
        Path(folder, "fresh").mkdir()
        Path(folder, "usual").mkdir()
        usual: World | None = None
        for kind in order:
            if kind.fresh:
                with World(Path(folder, "fresh"), kind.guards) as world:
                    found[kind.name].append(world.moved_ms(kind, chance))
                continue
            usual = usual or World(Path(folder, "usual"), 1)
            print(kind.name, end="  \r", file=sys.stderr)
            found[kind.name].append(usual.moved_ms(kind, chance))
        if usual is not None:
            usual.__exit__()
    print("| fault | times | median | worst | at most |\n|---|---|---|---|---|")
    for kind in kinds:
        times = found[kind.name]
        figures = f"{median(times):.0f} ms | {max(times):.0f} ms | {kind.most_ms} ms"
        print(f"| {kind.name} | {len(times)} | {figures} |")
    if min(found.get(UNGUARDED, [1e3])) < 500:
        raise AssertionError("without a guard the turtle stops as soon: nothing was measured")
    late = [
        f"{each.name} ({time_ms:.0f} ms)"
        for each in kinds
        for time_ms in found[each.name]
        if time_ms > each.most_ms
    ]
    print(f"{len(order)} faults of {len(kinds)} kinds; too late: {', '.join(late) or 'none'}")
    return bool(late)


if __name__ == "__main__":
    sys.exit(main())
