"""Do the same things a great many times in one process, and see that its memory stays flat.

* Machines are loaded and unloaded, on a board where others can see them; also under names that
  never come again, for which the board must not grow, either.
* Rounds are run. A page posts, over a real socket. Slots are made anew for each message.

Each must grow by less than 4 MiB between a fifth of the times and all. The exit status is 1 if
something does not.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import time
from collections.abc import Callable
from functools import cache
from itertools import count
from pathlib import Path
from types import new_class

from fuzz.page_socket import PageServer
from llfsm.runtime import Actuator, Arrangement, Machine, ManualClock, State
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Bool, String

_MOST_BYTES = 4 << 20  # what the allocator may keep: some 50 bytes a time
_numbers = count()
_LAMP = Slot("lamp", Bool)


class Blinks(Machine):
    """Go to and fro, and post at each change."""

    lamp = Actuator(_LAMP, at_end=Bool(False))
    on: bool = False
    a, b = State(), State()

    @a.on_entry
    def _(self) -> None:
        self.lamp(Bool(True))

    a.to(b, when=lambda m: True)
    b.to(a, when=lambda m: True)


def main() -> int:
    """Do all of it, and print what it takes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("what", nargs="*", help="to do; by default all")
    parser.add_argument("--scale", type=float, default=1.0, help="of the numbers of times")
    options = parser.parse_args()
    name, bad = f"soak-flat-{os.getpid()}", 0
    for what, times in (
        (loads, 100_000), (names, 100_000), (rounds, 1_000_000), (posts, 100_000), (slots, 10_000)
    ):  # fmt: skip
        if options.what and what.__name__ not in options.what:
            continue
        with Whiteboard(name) as board:
            try:
                bad += _measure(what, board, max(5, int(times * options.scale)))
            finally:
                board.remove()
    return int(bad > 0)


def _measure(what: Callable[[Whiteboard, int], None], board: Whiteboard, times: int) -> int:
    start = time.monotonic()
    what(board, times // 5)
    before = _memory(), board.path.stat().st_size
    what(board, times - times // 5)
    grown, size = _memory() - before[0], board.path.stat().st_size - before[1]
    took = time.monotonic() - start
    good = grown < _MOST_BYTES and size == 0
    print(
        f"{times} {what.__name__} in {took:.0f} s: memory +{grown >> 10} KiB of {before[0] >> 10}, "
        f"the board +{size} of {before[1]} bytes{'' if good else ': NOT FLAT'}",
        flush=True,
    )
    return int(not good)


def _memory() -> int:
    gc.collect()
    resident = int(Path("/proc/self/statm").read_text().split()[1])
    shared = int(
        Path("/proc/self/statm").read_text().split()[2]
    )  # the board's file is counted apart
    return (resident - shared) * os.sysconf("SC_PAGE_SIZE")


class Comes(Blinks):
    """Is loaded and unloaded by another one."""


class Loads(Machine):
    """Load a machine in one round, and unload it in the next."""

    loads: int = 0

    off, on = State(), State()

    @on.on_entry
    def _(self) -> None:
        self.load("Comes")
        self.loads += 1

    @off.on_entry
    def _(self) -> None:
        if self.loads:
            self.unload("Comes")

    off.to(on, when=lambda m: True)
    on.to(off, when=lambda m: True)


def loads(board: Whiteboard, times: int) -> None:
    """Load a machine and unload it."""
    environment = LiveEnvironment(board, ManualClock())
    Arrangement([Loads], library={"Comes": Comes}, environment=environment).run(
        max_rounds=2 * times
    )


def names(board: Whiteboard, times: int) -> None:
    """Run a machine of a name that was never there before."""
    for _ in range(times):
        machine = new_class(f"Machine{next(_numbers)}", (Blinks,))
        environment = LiveEnvironment(board, ManualClock())
        Arrangement([machine], environment=environment).run(max_rounds=2)


def rounds(board: Whiteboard, times: int) -> None:
    """Run rounds."""
    environment = LiveEnvironment(board, ManualClock())
    Arrangement([Blinks], environment=environment).run(max_rounds=times)


def posts(board: Whiteboard, times: int) -> None:
    """Post from a page."""
    server = _server()
    for _ in range(times):
        server.post()


@cache
def _server() -> PageServer:
    return PageServer({Slot("text", String): String("first")})


def slots(board: Whiteboard, times: int) -> None:
    """Add with a slot that is made for it."""
    for _ in range(times):
        board.add_message(Slot("number", Bool), Bool(True))


if __name__ == "__main__":
    sys.exit(main())
