"""The parts of a demo, run and ended as one: `llfsm` processes, or threads of this process.

Processes are those that a user would start by hand, on one whiteboard; one that dies can be started
again. Threads need no shared memory, so a demo also runs on systems that have none.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Self

import click

from llfsm.bridges.turtlesim.node import TurtlesimNode
from llfsm.bridges.turtlesim.simulator import Simulator, run
from llfsm.cli.machines import parse_arguments
from llfsm.cli.options import BoardRemovedError
from llfsm.cli.view import VIEW_PORT, listen, make_server, page_address
from llfsm.errors import LlfsmError
from llfsm.runtime.presence.live import LiveEnvironment

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from llfsm.whiteboard import Board


_PATIENCE_S = 5.0  # from SIGTERM to SIGKILL


class ProcessStatus(NamedTuple):
    """The status of a part."""

    name: str
    pid: int | None  # None while a process waits to be started again
    since_s: float
    output: str  # the last line that it printed


class _Process:
    def __init__(self, name: str, arguments: Sequence[str], environment: Mapping[str, str]) -> None:
        self.name = name
        self.arguments = arguments
        self.started = time.monotonic()
        self.ended: float | None = None
        # A session of its own, so that a Ctrl-C at the terminal reaches only the supervisor;
        # its standard input is closed if the supervisor is killed.
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "llfsm.cli", *arguments, "--until-eof"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            env=os.environ | environment,
        )
        self.output: deque[str] = deque(maxlen=10)
        self._reader = threading.Thread(target=self._read, name=f"output of {name}", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.popen.stdout is not None
        for line in self.popen.stdout:
            self.output.append(line.rstrip("\n"))

    def end(self) -> None:
        if self.popen.poll() is None:
            self.popen.terminate()
            try:
                self.popen.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self.popen.kill()
                self.popen.wait()
        self._reader.join(_PATIENCE_S)
        for stream in (self.popen.stdin, self.popen.stdout):
            if stream is not None:
                stream.close()

    def has_ended(self) -> bool:
        if self.ended is None and self.popen.poll() is not None:
            self.ended = time.monotonic()
            self._reader.join(_PATIENCE_S)
        return self.ended is not None

    def has_failed_within(self, seconds: float) -> bool:
        assert self.ended is not None
        code = self.popen.returncode
        fails = code > 0 and code != BoardRemovedError.exit_code
        return fails and self.ended - self.started < seconds

    def death(self, then: str = "") -> str:
        """Describe how it ended, and `then`; if it exited by itself, with its last lines."""
        code = self.popen.returncode
        if code < 0:
            return f"the {self.name} was killed by {signal.Signals(-code).name}{then}"
        return "\n    ".join([f"the {self.name} ended with {code}{then}", *self.output])

    def status(self) -> ProcessStatus:
        pid = self.popen.pid if self.ended is None else None
        since = self.started if self.ended is None else self.ended
        last = self.output[-1] if self.output else ""
        return ProcessStatus(self.name, pid, time.monotonic() - since, last)


class Processes:
    """Run `llfsm` commands as processes; leaving the ``with`` block ends them, the last first.

    When a process ends, all end. With `restart` it is started again after `pause_s` seconds,
    unless it failed within `early_s` seconds of its start: it would fail again. `environment` is
    added to theirs. `reports` has a text for each process that ended, oldest first; its reader
    removes them.
    """

    def __init__(
        self,
        *,
        restart: bool = False,
        environment: Mapping[str, str] | None = None,
        pause_s: float = 1.0,
        early_s: float = 5.0,
    ) -> None:
        self.reports: deque[str] = deque()
        self._restart = restart
        self._environment = environment or {}
        self._pause_s = pause_s
        self._early_s = early_s
        self._all: list[_Process] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        while self._all:
            self._all.pop().end()

    def start(self, name: str, *arguments: str) -> None:
        """Start ``llfsm ARGUMENTS``, called `name` in reports."""
        self._all.append(_Process(name, arguments, self._environment))

    def statuses(self) -> list[ProcessStatus]:
        """Return the status of each process, in the order of their start."""
        return [process.status() for process in self._all]

    def check(self) -> None:
        """Restart processes that have ended; raise `LlfsmError` if that ends all."""
        for place, process in enumerate(self._all):
            known = process.ended is not None
            if not process.has_ended():
                continue
            if not self._restart or process.has_failed_within(self._early_s):
                raise LlfsmError(process.death())
            assert process.ended is not None
            if not known:
                self.reports.append(process.death("; it starts again"))
            elif time.monotonic() - process.ended >= self._pause_s:
                process.end()
                self._all[place] = _Process(process.name, process.arguments, self._environment)

    def wait(self, seconds: float) -> None:
        """Wait, checking the processes; a signal handler that raises cuts it short."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self.check()
            time.sleep(min(left, 0.05))  # soon enough to report that one has died


class _Part(NamedTuple):
    name: str
    started: float
    thread: threading.Thread
    stop: Callable[[], object]


class Threads:
    """Run the parts of a demo as threads, as `Processes` does; `wait` raises the error of one."""

    def __init__(self, board: Board) -> None:
        self.reports: deque[str] = deque()
        self._board = board
        self._all: list[_Part] = []
        self._failed: deque[Exception] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        while self._all:
            part = self._all.pop()
            part.stop()
            part.thread.join()

    def start_simulator(self, simulator: Simulator) -> None:
        """Start a turtle simulator."""
        step, ending = TurtlesimNode(simulator, self._board).step, threading.Event()
        self._start("simulator", partial(run, step, ending.is_set), ending.set)

    def start_machines(self, names: Sequence[str]) -> None:
        """Start the machines of these names as one arrangement."""
        arrangement = parse_arguments(names).assemble(LiveEnvironment(self._board))
        self._start("machine", arrangement.run, partial(arrangement.stop, "the demo ends"))

    def start_page(self, token: str) -> str:
        """Serve the page of the whiteboard on this host; return its address."""
        from llfsm.bridges.view.live_source import LiveSource

        host = "127.0.0.1"
        source = LiveSource(self._board.name, given=self._board)

        def make_app(token: str) -> ASGIApp:
            from llfsm.bridges.view.app import make_app

            return make_app(source, host=host, token=token, control=False)

        server = make_server(make_app, token)
        try:
            listener = listen(host, VIEW_PORT)
        except click.ClickException:  # another page has it
            listener = listen(host, 0)
        self._start(
            "page",
            partial(server.run, sockets=[listener]),
            partial(setattr, server, "should_exit", True),
        )
        return page_address(host, listener.getsockname()[1], token)

    def statuses(self) -> list[ProcessStatus]:
        """Return the status of each part, in the order of their start."""
        now = time.monotonic()
        return [ProcessStatus(p.name, os.getpid(), now - p.started, "") for p in self._all]

    def wait(self, seconds: float) -> None:
        """Wait, and raise the error that has ended a part."""
        if self._failed:
            raise self._failed.popleft()
        time.sleep(seconds)  # between two looks of the screen

    def _start(self, name: str, run: Callable[[], object], stop: Callable[[], object]) -> None:
        def execute() -> None:
            try:
                run()
            except Exception as error:  # raised again where the demo waits
                self._failed.append(error)

        thread = threading.Thread(target=execute, name=name, daemon=True)
        self._all.append(_Part(name, time.monotonic(), thread, stop))
        thread.start()
