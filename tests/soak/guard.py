"""Kill or stop a driving machine's process again and again, and measure until it is made safe.

A guard, `llfsm guard`, runs in a process of its own, as does each machine, which posts at every
turn and gets SIGKILL or SIGSTOP at a random moment. What has to hold:

* after SIGKILL, the safe value is on the board within 100 ms at the 99th percentile, and 250 ms at
  worst;
* after SIGSTOP, it is there within 300 ms more than the process may be silent; after SIGCONT the
  process leaves its last will again and drives on;
* it is posted once, also where three guards run, and not after another process has taken over;
* the guard takes less than 0.5 % of a processor.

The exit status is 1 if something does not hold.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

from driving import DRIVE, GO, SAFE, Runs
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.messages.llfsm import will_slot
from llfsm.whiteboard.messages.std_msgs import Int32
from waiting import wait_for

_P99_MS, _WORST_MS, _CPU_PERCENT = 100.0, 250.0, 0.5
_IDLE_S = 20.0
_SILENT_MS, _MORE_MS = 500, 300.0
_OTHERS = Int32(data=7)  # what the process posts that takes over


def main() -> int:
    """Measure with one guard, then with three; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--stops", type=int, default=200)
    options = parser.parse_args()
    name = f"soak-guard-{os.getpid()}"
    with Whiteboard(name) as board:
        try:
            return max(
                _measure(board, 1, options.kills),
                _measure(board, 3, max(1, options.kills // 10)),
                _measure_stops(board, 1, options.stops),
                _measure_stops(board, 3, max(1, options.stops // 10)),
                _measure_successors(board, max(1, options.kills // 4), max(1, options.stops // 4)),
            )
        finally:
            board.remove()


def _measure(board: Whiteboard, guards: int, kills: int) -> int:
    chance = random.Random(guards)
    runs = Runs(board)
    with ExitStack() as stack:
        stack.callback(runs.end)
        started = [_guard(stack, board.name) for _ in range(guards)]
        took, twice = [], 0
        for _ in range(kills):
            milliseconds, added = _kill(board, runs, chance.uniform(0, 0.3))
            took.append(milliseconds)
            twice += added != 1
        p99, worst = _print(f"{guards} guard(s), {kills} kills: safe value", took, twice)
        fast = p99 <= _P99_MS and worst <= _WORST_MS
        percent = 0.0
        if guards == 1:
            percent = _cpu_percent(board, runs, started[0].pid)
            print(f"a guard beside a driving machine: {percent:.2f} % of a processor", flush=True)
    return int(not fast or twice > 0 or percent >= _CPU_PERCENT)


def _measure_stops(board: Whiteboard, guards: int, stops: int) -> int:
    """Stop one process and let it go on, again and again."""
    chance = random.Random(guards)
    runs, drive, will = Runs(board), board[DRIVE], board[will_slot("Drives")]
    with ExitStack() as stack:
        stack.callback(runs.end)
        for _ in range(guards):
            _guard(stack, board.name)
        process = runs.start(will_after_ms=_SILENT_MS)
        took, again, twice = [], [], 0
        for _ in range(stops):
            wait_for(lambda: will.get().state == "left", "it leaves its last will")
            time.sleep(chance.uniform(0, 0.3))
            process.send_signal(signal.SIGSTOP)
            begin = time.perf_counter()
            wait_for(lambda: drive.get() == SAFE, "the safe value")
            took.append((time.perf_counter() - begin) * 1e3)
            count = drive.count
            wait_for(lambda: will.get().state == "executed", "the will is executed")
            time.sleep(0.06)  # a look of every guard
            twice += drive.count != count
            begin = time.perf_counter()
            process.send_signal(signal.SIGCONT)
            wait_for(lambda: drive.get() == GO, "it drives again")
            again.append((time.perf_counter() - begin) * 1e3)
    what = f"{guards} guard(s), {stops} stops, {_SILENT_MS} ms silent: safe value"
    _, worst = _print(what, took, twice)
    _print("  after SIGCONT, its own value again", again)
    return int(worst > _SILENT_MS + _MORE_MS or twice > 0)


def _measure_successors(board: Whiteboard, kills: int, stops: int) -> int:
    """Let another process post at about the time at which a guard does: that must stay."""
    chance = random.Random(0)
    runs, drive, will = Runs(board), board[DRIVE], board[will_slot("Drives")]
    replaced = first = 0
    with ExitStack() as stack:
        stack.callback(runs.end)
        for _ in range(3):
            _guard(stack, board.name)
        for number in range(kills + stops):
            is_killed = number < kills
            process = runs.start(will_after_ms=None if is_killed else _SILENT_MS)
            until_s = chance.uniform(0, 0.02) if is_killed else chance.gauss(_SILENT_MS / 1e3, 0.02)
            process.send_signal(signal.SIGKILL if is_killed else signal.SIGSTOP)
            time.sleep(until_s)
            drive.add(_OTHERS)
            count = drive.count
            first += will.get().state == "left"
            wait_for(lambda: will.get().state == "executed", "the will is executed")
            time.sleep(0.06)
            replaced += drive.count != count or drive.get() != _OTHERS
            process.kill()
            process.wait()
    print(
        f"3 guards, {kills} kills and {stops} stops with a successor, {first} times before the "
        f"will was executed: its value replaced {replaced} times",
        flush=True,
    )
    return int(replaced > 0)


def _print(what: str, took: list[float], twice: int | None = None) -> tuple[float, float]:
    """Print how many milliseconds it took; return the 99th percentile and the worst."""
    took.sort()
    p50, p99, worst = took[len(took) // 2], took[int(len(took) * 0.99)], took[-1]
    line = f"{what} after p50 {p50:.1f} ms, p99 {p99:.1f} ms, worst {worst:.1f} ms"
    print(line if twice is None else f"{line}; not posted once: {twice}", flush=True)
    return p99, worst


def _kill(board: Whiteboard, runs: Runs, after_s: float) -> tuple[float, int]:
    """Kill a machine's process; return the milliseconds to the value, and how often it came."""
    process = runs.start()
    time.sleep(after_s)
    drive = board[DRIVE]
    begin = time.perf_counter()
    process.kill()
    wait_for(lambda: drive.get() == SAFE, "the safe value")
    milliseconds = (time.perf_counter() - begin) * 1e3
    process.wait()
    count = drive.count
    will = board[will_slot("Drives")]
    wait_for(lambda: will.get().state == "executed", "the will is executed")
    time.sleep(0.06)  # a look of every guard
    return milliseconds, 1 + drive.count - count


def _cpu_percent(board: Whiteboard, runs: Runs, pid: int) -> float:
    runs.start()
    before = _cpu_s(pid)
    time.sleep(_IDLE_S)
    return (_cpu_s(pid) - before) / _IDLE_S * 100


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _guard(stack: ExitStack, name: str) -> subprocess.Popen[str]:
    guard = subprocess.Popen(
        [sys.executable, "-m", "llfsm.cli", "guard", "-b", name],
        text=True,
        stderr=subprocess.PIPE,
    )
    stack.callback(guard.wait)
    stack.callback(guard.kill)
    assert guard.stderr is not None
    assert "guarding" in guard.stderr.readline()
    # From now on the pipe only fills up: 200 lines fit into it.
    return guard


if __name__ == "__main__":
    sys.exit(main())
