"""Three hosts on this machine, each adding to its slots for a while; see `make soak`.

Each host is a process that adds, a daemon and a board of its own. Every message tells when it was
added, by the clock that all share here, so each host can tell how old the newest message is that it
has not got. Reported: that age (p50, p99, max), and each daemon's processor time and memory, second
by second. The exit status is 1 if a promise is missed.
"""

from __future__ import annotations

import argparse
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import cache
from itertools import product
from pathlib import Path

from llfsm.whiteboard import Message, Slot, Whiteboard

BOARD = "soak"
PROMISED_MS = 100.0
FLAT = 1.1  # times the memory of the first third
LOOK_S = 0.05


class Beat(Message):
    """When it was added, and by which host."""

    at_ns: int
    host: int
    data: bytes = bytes(64)


@cache
def slot(host: int, number: int) -> Slot[Beat]:
    """Return one of the slots to which a host adds."""
    return Slot(f"soak/{host}/{number}", Beat)


def add(folder: str, host: int, slots: int, rate: float, seconds: float) -> None:
    """Be a host: add to its slots, at a steady pace, until the time is over."""
    with Whiteboard(BOARD, directory=folder) as board:
        bound = [board[slot(host, number)] for number in range(slots)]
        start = time.monotonic()
        turn = 0
        while turn < seconds * rate:
            for each in bound:
                each.add(Beat(time.monotonic_ns(), host))
            turn += 1
            left = start + turn / rate - time.monotonic()
            if left > 0:
                time.sleep(left)
            elif left < -1:  # this machine cannot add so fast: do not pretend
                turn = round((time.monotonic() - start) * rate)


def usage(pid: int) -> tuple[float, float]:
    """Return a process's seconds of processor time, and MiB of memory."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK"), int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def endpoints(number: int) -> list[str]:
    """Return as many free places to listen on."""
    with ExitStack() as stack:
        servers = [
            stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(number)
        ]
        return [f"tcp/127.0.0.1:{server.getsockname()[1]}" for server in servers]


def lags(boards: Sequence[Whiteboard], slots: int) -> list[float]:
    """Return for each slot and board how long, in ms, the newest message anywhere is missing."""
    now_ns = time.monotonic_ns()
    found: list[float] = []
    for host, number in product(range(len(boards)), range(slots)):
        held = [board.get_message(slot(host, number)) for board in boards]
        newest = max((message.at_ns for message in held if message is not None), default=now_ns)
        # A board that has an older one lacks what was added after it, for no longer than this.
        found += [
            (newest - m.at_ns) / 1e6 for i, m in enumerate(held) if i != host and m is not None
        ]
    return found


def soak(hosts: int, slots: int, rate: float, seconds: float) -> bool:
    """Run it; tell whether the promises are kept."""
    with ExitStack() as stack:
        folders = [
            stack.enter_context(tempfile.TemporaryDirectory(prefix="soak", dir="/dev/shm"))
            for _ in range(hosts)
        ]
        boards = [stack.enter_context(Whiteboard(BOARD, directory=f)) for f in folders]
        places = endpoints(hosts)
        daemons = []
        for folder, place in zip(folders, places, strict=True):
            others = [part for p in places if p != place for part in ("--connect", p)]
            command = ["whiteboard", "daemon", "-b", BOARD, "--directory", folder, "--listen"]
            daemon = subprocess.Popen(
                [sys.executable, "-m", "llfsm.cli", *command, place, *others],
                stdout=subprocess.PIPE,
            )
            stack.callback(daemon.wait)
            stack.callback(daemon.terminate)
            assert daemon.stdout is not None
            daemon.stdout.readline()
            daemons.append(daemon)
        adders = []
        for host, folder in enumerate(folders):
            arguments = (folder, host, slots, rate, seconds)
            command = ["--be", *map(str, arguments)]
            adders.append(subprocess.Popen([sys.executable, __file__, *command]))
            stack.callback(adders[-1].wait)
        return _watch(boards, daemons, adders, slots, rate)


def _watch(
    boards: Sequence[Whiteboard],
    daemons: Sequence[subprocess.Popen[bytes]],
    adders: Sequence[subprocess.Popen[bytes]],
    slots: int,
    rate: float,
) -> bool:
    ages: list[float] = []
    memory: list[list[float]] = []
    begin, reported = time.monotonic(), 0.0
    before = [usage(daemon.pid)[0] for daemon in daemons]
    print("   s   adds/s   age p50   p99 ms   daemons: % of a core, MiB")
    added = last = 0
    while any(adder.poll() is None for adder in adders):
        time.sleep(LOOK_S)
        now = time.monotonic() - begin
        if now > 2:  # once they all add
            ages += lags(boards, slots)
        if now - reported >= 5 and ages:
            added = sum(b[slot(h, n)].count for h, b in enumerate(boards) for n in range(slots))
            used = [usage(daemon.pid) for daemon in daemons]
            memory.append([mib for _, mib in used])
            shares = [
                100 * (u[0] - b) / (now - reported) for u, b in zip(used, before, strict=True)
            ]
            cells = "  ".join(f"{s:3.0f} {m:5.1f}" for s, (_, m) in zip(shares, used, strict=True))
            pace = (added - last) / (now - reported)
            print(f"{now:4.0f} {pace:8.0f} {_part(ages, 50):9.1f} {_part(ages, 99):8.1f}   {cells}")
            before, reported, last = [u[0] for u in used], now, added
    end = time.monotonic()
    while max(lags(boards, slots)) > 0:
        if time.monotonic() - end > 10:
            print("the boards do not agree 10 s after the end")
            return False
        time.sleep(0.001)
    print(f"all boards agree {1000 * (time.monotonic() - end):.0f} ms after the last add")
    p99 = _part(ages, 99)
    third = max(1, len(memory) // 3)
    first = max(map(max, memory[:third]), default=0)
    later = max(map(max, memory[-third:]), default=0)
    print(f"age of what is missing: p50 {_part(ages, 50):.1f} ms, p99 {p99:.1f} ms "
          f"(promised {PROMISED_MS:g}), max {max(ages):.1f} ms")  # fmt: skip
    print(f"memory of a daemon: {first:.1f} MiB at first, {later:.1f} MiB at last")
    return p99 <= PROMISED_MS and later <= FLAT * first


def _part(values: list[float], percent: int) -> float:
    return statistics.quantiles(values, n=100)[percent - 1]


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--hosts", type=int, default=3)
    parser.add_argument("--slots", type=int, default=50)
    parser.add_argument("--rate", type=float, default=200, help="adds a second, slot and host")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--be", nargs=5, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.be:
        folder, *numbers = options.be
        add(folder, int(numbers[0]), int(numbers[1]), float(numbers[2]), float(numbers[3]))
        return 0
    kept = soak(options.hosts, options.slots, options.rate, options.seconds)
    print("every promise is met" if kept else "a promise is missed")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
