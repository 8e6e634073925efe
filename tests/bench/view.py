"""Show a busy board on a page and measure what that costs; print it as JSON.

500 slots change 50 times a second and 50 machines run. `frames` is how many frames a second the
browser draws, `server` what `llfsm view` takes of a core, `cost` what a ringlet takes in
microseconds (median of the machines) without and with a page. The browser draws without a
graphics card here, and all share the cores of this host.
"""

import argparse
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from statistics import median
from types import FrameType

from llfsm.runtime import Arrangement, Machine, State
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.geometry_msgs import Twist, Vector3

SLOTS, HERTZ, MACHINES = 500, 50, 50
WARM_S = 2.0  # for the page to load and lay itself out
PATIENCE_S = 60  # how long all of it may take, beside what is measured, on a busy machine


class Worker(Machine):
    """Change its state a few times a second, and a variable in every ringlet."""

    turns: int = 0

    a = State()
    b = State()
    c = State()
    a.to(b, after_ms=170)
    b.to(c, after_ms=230)
    c.to(a, after_ms=310)

    @a.internal
    def _(self) -> None:
        self.turns += 1


def feed(board: str) -> None:
    """Add to every slot so many times a second, until the board is gone."""
    with Whiteboard(board) as wb:
        slots = [wb[Slot(f"group{i // 20}/value{i}", Twist)] for i in range(SLOTS)]
        due, number = time.monotonic(), 0
        while wb.alive:
            number += 1
            for i, slot in enumerate(slots):
                slot.add(Twist(linear=Vector3(x=float(number), y=float(i))))
            due = max(due + 1 / HERTZ, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))


def work(board: str) -> None:
    """Print a line once each machine had a turn; run until one is read; print a ringlet's cost."""
    with Whiteboard(board) as wb:
        arrangement = Arrangement([Worker] * MACHINES, whiteboard=wb, timed=True)

        def stop_when_asked() -> None:
            sys.stdin.readline()
            arrangement.stop()

        arrangement.round()
        print("ready", flush=True)
        threading.Thread(target=stop_when_asked, daemon=True).start()
        arrangement.run(grace_s=0)
        print(median(machine.cost_us.p50 for machine in arrangement.statistics()), flush=True)


def cpu_s(pid: int) -> float:
    """Return the seconds of a core that a process has taken."""
    with open(f"/proc/{pid}/stat") as file:
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Part:
    """One of the processes."""

    def __init__(self, *arguments: str) -> None:
        self.popen = subprocess.Popen(
            [sys.executable, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def line(self, asked: str = "") -> str:
        assert self.popen.stdin is not None
        assert self.popen.stdout is not None
        self.popen.stdin.write(asked)
        self.popen.stdin.flush()
        readable, _, _ = select.select([self.popen.stdout], [], [], PATIENCE_S)
        line = self.popen.stdout.readline() if readable else ""
        if not line:
            raise RuntimeError(f"no answer of {self.popen.args}")
        return line

    def end(self) -> None:
        self.popen.kill()
        self.popen.communicate()


def measure(seconds: float) -> dict[str, float]:
    """Run all of it for so long, first without a page and then with one."""
    from playwright.sync_api import sync_playwright

    board = f"bench-{os.getpid()}-view"
    parts: list[Part] = []
    with Whiteboard(board) as wb:
        try:
            parts.append(Part(__file__, "--feed", board))
            worker = Part(__file__, "--work", board)
            parts.append(worker)
            worker.line()
            time.sleep(seconds)
            without = float(worker.line("\n"))
            worker = Part(__file__, "--work", board)
            parts.append(worker)
            worker.line()
            server = Part("-m", "llfsm.cli", "view", "-b", board, "--no-open", "--port", "0")
            parts.append(server)
            found = re.search(r"http://\S+", server.line())
            assert found
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(
                    executable_path=shutil.which("chromium"), args=["--no-sandbox"]
                )
                page = browser.new_page(viewport={"width": 1440, "height": 900})
                page.goto(found[0])
                page.wait_for_selector("[data-slot]")
                time.sleep(WARM_S)
                taken, began = cpu_s(server.popen.pid), time.monotonic()
                page.evaluate(_COUNT)
                time.sleep(seconds)
                drawn = page.evaluate("[window.drawn, window.updated]")
                passed = time.monotonic() - began
                share = (cpu_s(server.popen.pid) - taken) / passed
                browser.close()
            return {
                "frames": drawn[0] / passed,
                "updates": drawn[1] / passed,
                "server": share,
                "cost_without": without,
                "cost_with": float(worker.line("\n")),
            }
        finally:
            wb.remove()
            for part in parts:
                part.end()


# An update of the page is one in which the age of some row has changed.
_COUNT = """() => {
    window.drawn = window.updated = 0;
    const count = () => { window.drawn += 1; requestAnimationFrame(count); };
    requestAnimationFrame(count);
    let changed = false;
    new MutationObserver(() => {
        if (!changed) requestAnimationFrame(() => { changed = false; window.updated += 1; });
        changed = true;
    }).observe(document.getElementById("rows"), {
        subtree: true, childList: true, characterData: true
    });
}"""


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--feed", metavar="BOARD")
    parser.add_argument("--work", metavar="BOARD")
    arguments = parser.parse_args()
    if arguments.feed:
        feed(arguments.feed)
    elif arguments.work:
        work(arguments.work)
    else:
        # A page that hangs has no limit of its own. What is open is closed on the way out.
        signal.signal(signal.SIGALRM, give_up)
        signal.alarm(round(2 * arguments.seconds) + PATIENCE_S)
        print(json.dumps(measure(arguments.seconds)))


def give_up(_signal: int, _frame: FrameType | None) -> None:
    """Say that it took too long."""
    raise TimeoutError(f"not done {PATIENCE_S} s after what is measured was over")


if __name__ == "__main__":
    main()
