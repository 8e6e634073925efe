"""Let a hundred thousand of what has a life come and go through real processes; see `make soak`.

A board with a daemon, a guard, a page that somebody looks at and a recorder, and another host's
board with a daemon. Their memory and both boards must be as large at the end as after a fifth of:

* names of slots that are made and given up, a hundred at a time, which the other host follows;
* machines with a last will, each under a name of its own, loaded and ended;
* hosts that send a heartbeat once and are never there again, each under a name of its own.

The exit status is 1 if something grows, or a daemon does not follow to the end.
"""

from __future__ import annotations

import argparse
import itertools
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from random import Random
from types import new_class

import msgspec
import zenoh
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.typing import Origin

from free_ports import free_endpoint, free_port
from llfsm.runtime import Actuator, Arrangement, Machine, ManualClock, State
from llfsm.runtime.presence.live import LiveEnvironment
from llfsm.whiteboard import Slot, Whiteboard
from llfsm.whiteboard.messages.std_msgs import Bool, Int32
from llfsm.whiteboard.mirror.batches import Heartbeat
from llfsm.whiteboard.mirror.groups import group_of
from llfsm.whiteboard.mirror.keys import Keys
from waiting import wait_for

_ALIVE = 100
_MOST_KIB = 16 << 10  # what allocators keep, as they do with much that comes and goes
_CHANNEL_KIB = 3  # of a recorder: the end of its file lists all machines and slots that it has seen
_numbers, _looks = itertools.count(), itertools.count()
_LAST = Slot("last", Int32)


class Stops(Machine):
    """Have a last will, and do nothing."""

    stop = Actuator(Slot("stop", Bool), at_failure=Bool(True))
    a, b = State(), State()
    a.to(b, when=lambda m: True)


class Hosts:
    """Two boards, and the processes that look at them."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self.name = f"soak-lives-{os.getpid()}"
        self.board = stack.enter_context(Whiteboard(self.name))
        stack.callback(self.board.remove)
        self.other = stack.enter_context(Whiteboard(self.name, directory=folder))
        self.endpoint, port = free_endpoint(), free_port()
        there = ["--directory", str(folder), "--connect", self.endpoint]
        commands = {
            "daemon": ["whiteboard", "daemon", "--listen", self.endpoint],
            "other daemon": ["whiteboard", "daemon", *there, "--listen", free_endpoint()],
            "guard": ["guard"],
            "page": ["view", "--no-open", "--port", str(port)],
            "recorder": ["record", "-o", str(folder / "run.mcap")],
        }
        environment = os.environ | {"LLFSM_VIEW_TOKEN": "token", "MALLOC_ARENA_MAX": "2"}
        self.processes = {
            label: stack.enter_context(started(command, self.name, environment))
            for label, command in commands.items()
        }
        self.seen = 0
        threading.Thread(target=self._look, args=[port], daemon=True).start()
        wait_for(lambda: self.seen, "the page is served")
        self.follow()

    def _look(self, port: int) -> None:
        """Be the page in a browser."""
        while True:
            with (
                suppress(OSError, WebSocketException),
                connect(
                    f"ws://127.0.0.1:{port}/live?token=token",
                    origin=Origin(f"http://127.0.0.1:{port}"),
                    max_size=None,
                    proxy=None,
                ) as page,
            ):
                for _ in page:
                    page.send('{"type": "seen"}')
                    self.seen += 1
            time.sleep(0.2)

    def follow(self) -> None:
        """Wait until the other host and the page have what was added last."""
        number = next(_looks)
        self.board.add_message(_LAST, Int32(number))
        wait_for(lambda: self.other.get_message(_LAST) == Int32(number), "the other host follows")
        seen = self.seen
        wait_for(lambda: self.seen > seen + 2, "the page is served")

    def sizes(self) -> dict[str, int]:
        """Return what each process and each board takes, in KiB."""
        return {
            **{label: private_kib(process.pid) for label, process in self.processes.items()},
            "board": self.board.path.stat().st_size >> 10,
            "other board": self.other.path.stat().st_size >> 10,
        }


@contextmanager
def started(
    command: list[str], name: str, environment: dict[str, str]
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command on the board."""
    begin = [sys.executable, "-m", "llfsm.cli", *command, "-b", name]
    with subprocess.Popen(begin, env=environment, stdout=subprocess.DEVNULL) as process:
        try:
            yield process
            if process.poll() is not None:
                sys.exit(f"llfsm {' '.join(command)} ended with status {process.returncode}")
        finally:
            process.kill()


def private_kib(pid: int) -> int:
    """Return the memory of a process, without what it maps of a board."""
    resident, shared = Path(f"/proc/{pid}/statm").read_text().split()[1:3]
    return (int(resident) - int(shared)) * os.sysconf("SC_PAGE_SIZE") >> 10


def names(hosts: Hosts, times: int) -> None:
    """Make names of slots, and give up those that are the hundredth to the last."""
    for number in itertools.islice(_numbers, times):
        hosts.board.add_message(_named(number), Int32(number % (1 << 31)))
        if number >= _ALIVE:
            with suppress(LookupError):
                hosts.board.vacate(_named(number - _ALIVE))
        if number % 2000 == 0:
            hosts.follow()
    hosts.follow()


def _named(number: int) -> Slot[Int32]:
    return Slot(f"life/{number}", Int32)


def machines(hosts: Hosts, times: int) -> None:
    """Run machines with a last will under names that were never there."""
    for number in itertools.islice(_numbers, times):
        machine = new_class(f"Machine{number}", (Stops,))
        environment = LiveEnvironment(hosts.board, ManualClock())
        Arrangement([machine], environment=environment).run(max_rounds=2)
        if number % 2000 == 0:
            hosts.follow()
    hosts.follow()


def strangers(hosts: Hosts, times: int) -> None:
    """Send a heartbeat under the name of a host that was never there, and a token."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{hosts.endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    random = Random(times)
    with zenoh.open(config) as session:
        for number in itertools.islice(_numbers, times):
            host, born = random.getrandbits(60), random.getrandbits(60)
            keys = Keys(hosts.name, host, "-")
            beat = Heartbeat(host, born, 1, time.time_ns(), f"host{number}")
            token = session.liveliness().declare_token(keys.alive(f"host{number}"))
            session.put(keys.beats(group_of("last")), msgspec.msgpack.encode(beat))
            session.put(keys.hello, msgspec.msgpack.encode(beat))
            token.undeclare()
            if number % 200 == 0:
                hosts.follow()
    hosts.follow()


def main() -> int:
    """Let all of them live, and print what is larger afterwards."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    kinds: dict[str, Callable[[Hosts, int], None]] = {
        each.__name__: each for each in (names, machines, strangers)
    }
    parser.add_argument("kinds", nargs="*", help="by default all")
    parser.add_argument("--times", type=int, default=100_000)
    options = parser.parse_args()
    bad = False
    for label in options.kinds or kinds:
        with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
            hosts, begin = Hosts(stack, Path(folder)), time.monotonic()
            kinds[label](hosts, options.times // 5)
            before = hosts.sizes()
            kinds[label](hosts, options.times - options.times // 5)
            grown = {each: size - before[each] for each, size in hosts.sizes().items()}
            took = time.monotonic() - begin
            print(f"{options.times} {label} in {took:.0f} s: KiB {before}, grown by {grown}")
            most = dict.fromkeys(grown, _MOST_KIB) | {"board": 0}
            most["recorder"] += _CHANNEL_KIB * options.times
            bad |= any(kib > most[each] for each, kib in grown.items())
    return int(bad)


if __name__ == "__main__":
    sys.exit(main())
