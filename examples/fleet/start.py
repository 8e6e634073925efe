"""Three hosts on this computer, and ten turtles that form a circle: start.py circle.svg.

Each host is a folder with a whiteboard of its own, which a daemon mirrors. The field is on `base`,
the machines are on `north` and `south`. This program gives the orders, on `base`.
"""

import socket
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from math import hypot
from pathlib import Path
from subprocess import DEVNULL, Popen
from tempfile import TemporaryDirectory

from fleet import ORDER, SIZE, Order, Report, Shape, place

from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.turtlesim import Pose

BOARD = "fleet"
LEAVES = {  # what each host publishes for the others
    "base": ("turtle*/pose", "fleet/*"),
    "north": ("turtle*/cmd_vel", "turtle*/report", "llfsm/*"),
    "south": ("turtle*/cmd_vel", "turtle*/report", "llfsm/*"),
}
LIMIT_S = 60.0
NUMBERS = range(1, SIZE + 1)


class Host:
    """A folder with a whiteboard, and processes that use it."""

    def __init__(self, name: str, folder: str) -> None:
        self.name, self.folder = name, Path(folder, name)
        self.folder.mkdir()

    @contextmanager
    def llfsm(self, *words: str) -> Iterator[Popen[bytes]]:
        """Run a command of llfsm on this host's board; end it when the block is left."""
        command = [sys.executable, "-m", "llfsm.cli", *words, "--directory", str(self.folder)]
        beside = Path(__file__).parent
        with Popen([*command, "--board", BOARD], cwd=beside, stdout=DEVNULL) as process:
            try:
                yield process
            finally:
                process.terminate()

    def daemon(self, *options: str) -> AbstractContextManager[Popen[bytes]]:
        """Run a daemon that publishes what this host has for the others, 20 times a second."""
        leaves = (word for glob in LEAVES[self.name] for word in ("--leave", glob))
        return self.llfsm("whiteboard", "daemon", "--rate", "20", *leaves, *options)


def endpoint() -> str:
    """Return a free place to listen on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"tcp/127.0.0.1:{server.getsockname()[1]}"


def arrive(board: Whiteboard, order: Order) -> float:
    """Give an order, wait until all have reported, and return the seconds that it took."""
    board.add_message(ORDER, order)
    reports = [board[Slot(f"turtle{each}/report", Report)] for each in NUMBERS]
    begin = time.monotonic()
    for each, report in zip(NUMBERS, reports, strict=True):
        while (latest := report.sample()) is None or latest.message.number < order.number:
            left = begin + LIMIT_S - time.monotonic()
            if report.wait(after=latest.count if latest else 0, timeout=max(0, left)) is None:
                sys.exit(f"turtle{each} has not arrived in {LIMIT_S:g} s")
    return time.monotonic() - begin


def farthest(board: Whiteboard, shape: Shape) -> float:
    """Return the metres of the worst turtle from its place, by the poses on the field."""
    distances = []
    for number in NUMBERS:
        pose = board.get_message(Slot(f"turtle{number}/pose", Pose))
        x, y = place(shape, number)
        distances.append(hypot(pose.x - x, pose.y - y))
    return max(distances)


def main() -> None:
    """Start all processes, give the orders, and report."""
    with ExitStack() as stack:
        folder = stack.enter_context(TemporaryDirectory(prefix="fleet-"))
        base, *others = (Host(name, folder) for name in LEAVES)
        board = stack.enter_context(Whiteboard(BOARD, directory=base.folder))
        runs = []
        picture = ("--picture", str(Path(sys.argv[1]).resolve())) if len(sys.argv) > 1 else ()
        turtles = [
            word for number in NUMBERS[1:]
            for word in ("--turtle", f"turtle{number},{number},1,1.57")
        ]  # fmt: skip
        stack.enter_context(base.llfsm("turtlesim", *turtles, *picture))
        listens = {host: endpoint() for host in (base, *others)}
        stack.enter_context(base.daemon("--listen", listens[base]))
        for host in others:
            options = ("--listen", listens[host], "--connect", listens[base])
            stack.enter_context(host.daemon(*options))
            runs.append(stack.enter_context(host.llfsm("run", f"{host.name}.toml", "-q")))
        seconds = arrive(board, Order(1, "circle"))
        print(f"all {SIZE} turtles have arrived after {seconds:.1f} s")
        print(f"the farthest is {farthest(board, 'circle'):.2f} m from its place")
        board.add_message(ORDER, Order(2, "end"))
        for run in runs:
            run.wait(LIMIT_S)


if __name__ == "__main__":
    main()
