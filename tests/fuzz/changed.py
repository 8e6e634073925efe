"""Change a board under programs of Python that use it, and under a daemon; see `make fuzz`.

``hostile.c`` (see there) changes the file of a board, while these use it::

    python tests/fuzz/changed.py HOSTILE SECONDS

The handles of a board and its lists, those who wait, ``whiteboard list`` and ``watch``, ``ps``,
``record``, a machine that runs, and a daemon, beside another daemon whose board nobody changes. An
error of llfsm in one line is as it should be. A traceback, what a sanitizer reports, a process that
does not come back, and an end of the other daemon are not: then the exit status is 1. As a board
that is damaged for good ends all, each lives for a few seconds only.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from free_ports import free_endpoint
from llfsm.whiteboard import Message, Slot, Whiteboard, WhiteboardError
from llfsm.whiteboard.shared import boards
from waiting import wait_for

LIFE_S, HANGS_S = 6, 60


class Blob(Message):
    data: bytes = b""


class Text(Message):
    text: str = ""
    numbers: tuple[float, ...] = ()


BLOB, TEXT, LONG = Slot("blob", Blob, 64), Slot("text", Text, 300), Slot("n" * 200, Blob, 3000)
SLOTS: tuple[Slot[Any], ...] = (BLOB, TEXT, LONG)
MACHINE = """
from llfsm.runtime import Machine, Sensor, State
from llfsm.whiteboard import Message, Slot

class Text(Message):
    text: str = ""
    numbers: tuple[float, ...] = ()

TEXT = Slot("text", Text, 300)

class Sensing(Machine):
    text = Sensor(TEXT)
    heard: float = 0.0
    look = State()

    @look.internal
    def _(self) -> None:
        self.heard = self.text.numbers[0] if self.text is not None else 0.0

    @look.to(look)
    def longer(self) -> bool:
        return self.text is not None and len(self.text.text) > 7
"""


def fill(board: Whiteboard, number: int) -> None:
    """Add a message to each slot."""
    board.add_message(BLOB, Blob(b"x" * (number % 50)))
    board.add_message(TEXT, Text("a text", (1.0, float(number))))
    board.add_message(LONG, Blob(b"y" * (number % 2900)))


def look(board: Whiteboard, number: int) -> None:
    """Use handles, lists and those who wait."""
    waiter = board.waiter()
    uses: list[Callable[[], object]] = [
        lambda: fill(board, number),
        lambda: [board.get_message(slot) for slot in SLOTS],
        lambda: [board.publisher(slot).sample() for slot in SLOTS],
        lambda: [board[slot].recent() for slot in SLOTS],
        lambda: [info.slot() for info in board.slots()],
        lambda: (board.living(), board.read_slots(), board.readings),
        lambda: [board.get_message(board.find(info.name)) for info in board.slots()],
        boards,
        lambda: board[BLOB].wait(after=board[BLOB].count, timeout=0.001),
        lambda: waiter.wait({board[BLOB]: board[BLOB].count}, 0.001),
        lambda: board.watcher()(0.001),
    ]
    for each in random.choices(uses, k=200):
        with contextlib.suppress(WhiteboardError):
            each()


def use(name: str) -> None:
    """Be one of the processes that use Python's interface: open the board again and again."""
    print("looks", flush=True)
    for number in range(1 << 60):
        with contextlib.suppress(WhiteboardError), Whiteboard(name, create=False) as board:
            look(board, number)


class Started:
    """A process with its output in a file."""

    def __init__(self, folder: Path, *command: str) -> None:
        self.command = command
        with tempfile.NamedTemporaryFile(dir=folder, suffix=".log", delete=False) as file:
            self.output = Path(file.name)
            start = [sys.executable, "-X", "faulthandler", *command]
            self.process = subprocess.Popen(start, stdout=file, stderr=file)

    def is_ready(self) -> bool:
        """Return whether it has printed its first line, or ended."""
        return self.output.stat().st_size > 0 or self.process.poll() is not None

    def problem(self) -> str:
        """End it; return what it should not have done."""
        process = self.process
        process.send_signal(signal.SIGINT)  # kills one that is just ending: its handler is gone
        try:
            status = process.wait(HANGS_S)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGABRT)  # faulthandler prints where it is
            status = process.wait()
        text = self.output.read_text(errors="replace")
        signs = ("Traceback", "Sanitizer", "runtime error", "panicked", "Fatal Python")
        if status in (0, 1, 130, -signal.SIGINT) and not any(sign in text for sign in signs):
            return ""
        return f"status {status}: {' '.join(self.command)}\n{text[-6000:]}"


def live(hostile: str, folder: Path, seed: int, lasted: Counter[str]) -> list[str]:
    """Let one board live for a while; return the problems, and count how long programs lasted."""
    name, endpoint = f"changed-{os.getpid()}", free_endpoint()
    machine = folder / "sensing.py"
    machine.write_text(MACHINE)
    cli = ["-m", "llfsm.cli"]
    with Whiteboard(name) as board, Whiteboard(name, directory=folder) as sound:
        fill(board, seed)
        daemon = [*cli, "whiteboard", "daemon", "-b", name]
        mirrored = ["--directory", str(folder), "--listen", free_endpoint(), "--connect", endpoint]
        beside = Started(folder, *daemon, *mirrored)
        long_lived = {
            "handles": Started(folder, __file__, "--use", name),
            "daemon": Started(folder, *daemon, "--listen", endpoint),
            "watch": Started(folder, *cli, "whiteboard", "watch", "text", "-b", name),
            "record": Started(folder, *cli, "record", "-o", str(folder / "run.mcap"), "-b", name),
            "run": Started(folder, *cli, "run", str(machine), "-b", name, "-v"),
        }
        short_lived: list[Started] = []
        for each in long_lived.values():
            wait_for(each.is_ready, " ".join(each.command))
        with subprocess.Popen([hostile, str(LIFE_S), str(seed), str(board.path)]):
            begin = time.monotonic()
            while time.monotonic() < begin + LIFE_S:
                fill(sound, seed)
                for label, each in long_lived.items():
                    lasted[label] += each.process.poll() is None
                for command in ("list", "ps"):
                    words = ["whiteboard", "list"] if command == "list" else [command]
                    short_lived.append(Started(folder, *cli, *words, "-b", name))
                    lasted[command] += short_lived[-1].process.wait(HANGS_S) == 0
        problems = [each.problem() for each in (*long_lived.values(), *short_lived)]
        if beside.process.poll() is not None:
            problems.append(f"the sound board's daemon ended: {beside.output.read_text()[-6000:]}")
        problems.append(beside.problem())
        board.remove()
    return [each for each in problems if each]


def main(hostile: str, seconds: float) -> int:
    """Let boards live until the time is over, or one has a problem."""
    seed, lives, end = time.time_ns() >> 20, 0, time.monotonic() + seconds
    lasted: Counter[str] = Counter()
    while time.monotonic() < end:
        with tempfile.TemporaryDirectory(prefix="changed", dir="/dev/shm") as folder:
            problems = live(hostile, Path(folder), seed + lives, lasted)
        lives += 1
        if problems:
            print(*problems, sep="\n")
            return 1
    print(f"{lives} boards changed, programs seen at work or done well: {dict(lasted)}")
    return 0


if __name__ == "__main__":
    if sys.argv[1] == "--use":
        with contextlib.suppress(KeyboardInterrupt):
            use(sys.argv[2])
        sys.exit(0)
    sys.exit(main(sys.argv[1], float(sys.argv[2])))
