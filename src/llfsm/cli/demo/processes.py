"""A group of `llfsm` processes: started, supervised and ended as one.

A running demo on the terminal.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol, Self

import click

from llfsm.cli.options import BoardPlace
from llfsm.cli.ps import Watcher, machine_table, slot_table, turtle_field
from llfsm.errors import LlfsmError

if TYPE_CHECKING:
    from rich.console import RenderableType


_PATIENCE_S = 5.0  # from SIGTERM to SIGKILL


class ProcessDiedError(LlfsmError):
    """A process has ended that should not have; the text ends with its last lines."""


class ProcessStatus(NamedTuple):
    """The status of a process."""

    name: str
    pid: int | None
    """None while it waits to be started again."""
    since_s: float
    output: str
    """The last line that it printed."""


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
        return self.popen.returncode > 0 and self.ended - self.started < seconds

    def death(self, then: str = "") -> str:
        """Return how it ended, and `then`; if it exited by itself, with its last lines."""
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
        """Restart processes that have ended; raise :class:`ProcessDiedError` if that ends all."""
        for place, process in enumerate(self._all):
            known = process.ended is not None
            if not process.has_ended():
                continue
            if not self._restart or process.has_failed_within(self._early_s):
                raise ProcessDiedError(process.death())
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


_FRAME_S = 0.1
_NEWS = 5  # lines of it on the terminal


class Parts(Protocol):
    """The parts of a running demo: processes, or threads of this one."""

    reports: deque[str]

    def statuses(self) -> list[ProcessStatus]:
        """Return the status of each part."""
        ...

    def wait(self, seconds: float) -> None:
        """Wait while the parts work."""
        ...


class LiveBoard:
    """The whiteboard of a demo, removed at the end.

    A process of the demo that ends removes it as well; then it is created again.
    """

    def __init__(self, place: BoardPlace) -> None:
        self._place = place
        self._open()

    def _open(self) -> None:
        self._board = self._place.open()
        self._watcher = Watcher(self._board)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._board.remove()
        self._board.close()

    def watcher(self) -> Watcher:
        """Return the watcher of the whiteboard, which is created again if it was removed."""
        if not self._board.alive:
            self._board.close()
            self._open()
        return self._watcher


def show(watcher: Callable[[], Watcher], parts: Parts, title: str, seconds: float | None) -> None:
    """Show a demo for `seconds`: as a screen on a terminal, else a line for each change."""
    started = time.monotonic()
    until = float("inf") if seconds is None else started + seconds

    def timed(line: str) -> str:
        return f"{time.monotonic() - started:6.1f} s  {line}"

    if sys.stdout.isatty():
        from rich.live import Live

        news: deque[str] = deque(maxlen=_NEWS)
        with Live(auto_refresh=False) as live:
            while time.monotonic() < until:
                news.extend(map(timed, _reports(parts)))
                shown = _picture(watcher(), title, parts.statuses(), news)
                live.update(shown, refresh=True)
                parts.wait(_FRAME_S)
        return
    click.echo(title)
    printed: dict[str, str] = {}
    while time.monotonic() < until:
        for report in _reports(parts):
            click.echo(timed(report))
        watched = watcher()
        pose = watched.pose()
        where = "" if pose is None else f"  turtle1 at ({pose.x:.2f}, {pose.y:.2f})"
        states = {machine.name: machine.state for machine in watched.machines()}
        for machine, state in states.items():
            if printed.get(machine) != state:
                click.echo(timed(f"{machine}: {state}{where}"))
        printed = states
        parts.wait(_FRAME_S / 2)


def _reports(parts: Parts) -> Iterator[str]:
    while parts.reports:
        yield parts.reports.popleft()


def _picture(
    watcher: Watcher, title: str, processes: Sequence[ProcessStatus], news: Sequence[str]
) -> RenderableType:
    """Return the screen of a terminal: machines, turtle, processes, slots and the latest news."""
    from rich.columns import Columns
    from rich.console import Group
    from rich.panel import Panel
    from rich.table import Table
    from rich.text import Text

    machines = machine_table(watcher.machines())
    running = Table.grid(padding=(0, 2))
    for name, pid, since_s, output in processes:
        state = Text("starts again", "bold red") if pid is None else Text(f"process {pid}", "green")
        running.add_row(name, state, f"{since_s:5.0f} s", Text(output, "dim", no_wrap=True))
    pose = watcher.pose()
    board = slot_table(watcher.slots())
    top: list[RenderableType] = [Panel(machines, title="machines", title_align="left")]
    if pose is not None:
        where = f"turtle1 at ({pose.x:.2f}, {pose.y:.2f})"
        top.append(Panel(turtle_field(watcher, pose), title=where, title_align="left"))
    return Group(
        Text(title, "bold"),
        Columns(top),
        Panel(running, title="processes", title_align="left"),
        Panel(board, title="whiteboard", title_align="left"),
        *(Text(line, "red") for line in news),
    )
