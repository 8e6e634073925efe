"""Processes that run as one: started in order, watched, started again, and ended in order.

All is done by one thread, in turns of a loop: lines that processes have printed are passed on, ends
are noticed, those that may start are started. So a report stands where it happened in the output.
Each process has a session of its own, and only this one gets the terminal's Ctrl-C. If this process
is killed, Linux sends the others SIGTERM.
"""

from __future__ import annotations

import ctypes
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Final

from llfsm.cli.up.system import ProcessPlan
from llfsm.runtime.presence.remote import Directory
from llfsm.whiteboard import BoardNotFoundError, Whiteboard
from llfsm.whiteboard.board_files import default_name

_LOOK_S: Final = 0.05  # from one look at the processes to the next
_PAUSE_S: Final = 1.0  # before the first start anew; twice as long each time
_LONGEST_S: Final = 30.0
_SOON_S: Final = 10.0  # an end sooner after its start makes the next pause longer
_TERMINATED_S: Final = 1.0  # from SIGTERM to SIGKILL
_LATE_S: Final = 30.0  # after which it is reported that something is not ready
_LINE: Final = 1 << 16  # bytes of a line without an end, and of one read
_LAST_READS: Final = 64  # after an end: what is left behind may print for ever
_PR_SET_PDEATHSIG: Final = 1
_LIBC = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None


def _die_with_parent() -> None:
    """Ask Linux for SIGTERM when the parent ends; called between fork and exec, in one thread."""
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class Process:
    """A process of a system, from before its first start to its last end."""

    def __init__(self, plan: ProcessPlan):
        self.plan = plan
        self.name = plan.planned.name
        self.popen: subprocess.Popen[bytes] | None = None
        """The process, while it runs, and afterwards the last one."""
        self.is_ready = False
        self.done = False
        """True once it has ended, and will not be started again."""
        self.failed = False
        self.started_s = 0.0
        self.due_s = 0.0
        """When it is started again."""
        self.pause_s = 0.0
        self.unfinished = b""
        """What it has printed of a line."""

    @property
    def running(self) -> bool:
        """True if it was started and its end was not noticed."""
        return self.popen is not None and self.popen.returncode is None

    def start(self) -> None:
        """Start it; raise `OSError` if its program cannot be started."""
        plan = self.plan
        given = {} if plan.board is None else {"WHITEBOARD_NAME": plan.board}
        environment = {**os.environ, "PYTHONUNBUFFERED": "1", **given, **plan.planned.environment}
        self.started_s = time.monotonic()
        self.is_ready, self.unfinished = False, b""
        self.popen = subprocess.Popen(
            plan.words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=plan.folder,
            env=environment,
            start_new_session=True,
            preexec_fn=_die_with_parent,
        )

    def look(self) -> None:
        """Notice that it is ready, if no text that it prints tells."""
        if self.is_ready or not self.running or self.plan.planned.ready is not None:
            return
        self.is_ready = self.plan.run_arguments is None or self._has_machines()

    def _has_machines(self) -> bool:
        assert self.popen is not None
        try:
            with Whiteboard(self.plan.board_name or default_name(), create=False) as board:
                pids = {machine.status.pid for machine in Directory(board).machines()}
        except BoardNotFoundError:
            return False
        return self.popen.pid in pids

    def lines(self, data: bytes) -> list[str]:
        """Return the lines that end in what it has just printed; with b"", the rest."""
        *whole, self.unfinished = (self.unfinished + data).split(b"\n")
        if self.unfinished and (not data or len(self.unfinished) > _LINE):
            whole.append(self.unfinished)
            self.unfinished = b""
        lines = [line.decode(errors="replace").rstrip("\r") for line in whole]
        text = self.plan.planned.ready
        if text is not None and any(text in line for line in lines):
            self.is_ready = True
        return lines

    def signal(self, number: int) -> None:
        """Send it a signal, and whatever it has started that stayed in its session's group."""
        if self.popen is not None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.popen.pid, number)


class Processes:
    """The processes of a system.

    `show` is called with each line that a process prints, and `report` with what becomes of one.
    """

    def __init__(
        self,
        plans: Sequence[ProcessPlan],
        *,
        show: Callable[[str, str], object],
        report: Callable[[str], object],
    ):
        self.all = [Process(plan) for plan in plans]
        self._named = {process.name: process for process in self.all}
        self._show = show
        self._report = report
        self._selector = selectors.DefaultSelector()
        self._late: set[str] = set()
        self.must_end = False
        """True once a process has failed without which the system does not go on."""

    @property
    def failed(self) -> bool:
        """True if a process has failed, and was not started again."""
        return any(process.failed for process in self.all)

    @property
    def over(self) -> bool:
        """True once no process runs, and none will."""
        return self.must_end or all(process.done for process in self.all)

    def look(self) -> None:
        """Pass on what was printed, notice ends, and start what may start."""
        for key, _ in self._selector.select(_LOOK_S):
            self._read(key.data)
        for process in self.all:
            if process.running:
                process.look()
                self._notice(process)
            elif not process.done and time.monotonic() >= process.due_s and self._may(process):
                self._start(process)

    def _may(self, process: Process) -> bool:
        """Check that all is ready, or has ended well, after which a process starts."""
        before = [self._named[name] for name in process.plan.planned.after]
        for each in before:
            late = each.running and time.monotonic() - each.started_s > _LATE_S
            if late and not each.is_ready and each.name not in self._late:
                self._late.add(each.name)
                self._report(f"{each.name} is not ready after {_LATE_S:g} s; others wait for it")
        lost = next((each.name for each in before if each.failed and not each.is_ready), None)
        if lost is not None:
            self._report(f"{process.name} is not started, as {lost} has failed")
            self._end_for_good(process, failed=True)
        return all(each.is_ready or each.done for each in before) and lost is None

    def _start(self, process: Process) -> None:
        try:
            process.start()
        except OSError as error:
            self._report(f"{process.name} cannot be started: {error.strerror}: {error.filename}")
            self._end_for_good(process, failed=True)
            return
        assert process.popen is not None
        assert process.popen.stdout is not None
        os.set_blocking(process.popen.stdout.fileno(), False)
        self._selector.register(process.popen.stdout, selectors.EVENT_READ, process)
        self._report(f"{process.name} starts ({process.popen.pid})")

    def _read(self, process: Process) -> bool:
        """Pass on what a process has printed; return False if there is nothing."""
        assert process.popen is not None
        stdout = process.popen.stdout
        assert stdout is not None
        try:
            data = b"" if stdout.closed else os.read(stdout.fileno(), _LINE)
        except BlockingIOError:
            return False
        for line in process.lines(data):
            self._show(process.name, line)
        if not data and not stdout.closed:
            self._selector.unregister(stdout)
            stdout.close()
        return bool(data)

    def _finish(self, process: Process) -> None:
        """End what a process has left behind, and pass on the rest of what it has printed."""
        process.signal(signal.SIGTERM)
        for _ in range(_LAST_READS):
            if not self._read(process):
                break
        assert process.popen is not None
        stdout = process.popen.stdout
        if stdout is not None and not stdout.closed:  # which those have, too
            self._selector.unregister(stdout)
            stdout.close()

    def _notice(self, process: Process) -> None:
        """Note an end, and decide what follows."""
        assert process.popen is not None
        status = process.popen.poll()
        if status is None:
            return
        self._finish(process)
        how = f"was killed by {signal.Signals(-status).name}" if status < 0 else f"ended ({status})"
        wanted = process.plan.planned.restart
        if wanted == "always" or (wanted == "on-failure" and status):
            soon = time.monotonic() - process.started_s < _SOON_S
            longer_s = min(2 * process.pause_s, _LONGEST_S) if soon else 0.0
            process.pause_s = longer_s or _PAUSE_S
            process.due_s = time.monotonic() + process.pause_s
            self._report(f"{process.name} {how}; it starts again in {process.pause_s:g} s")
            process.popen = None
            return
        self._report(f"{process.name} {how}")
        self._end_for_good(process, failed=status != 0)

    def _end_for_good(self, process: Process, *, failed: bool) -> None:
        process.done, process.failed = True, failed
        if failed and process.plan.planned.essential:
            self._report(f"all end, as {process.name} is essential")
            self.must_end = True

    def end(self, is_urgent: Callable[[], bool]) -> None:
        """End what runs, the last first; at once if that `is_urgent`."""
        for process in reversed(self.all):
            if not process.running:
                continue
            for number, patience_s in (
                (signal.SIGINT, process.plan.grace_s),
                (signal.SIGTERM, _TERMINATED_S),
                (signal.SIGKILL, float("inf")),
            ):
                process.signal(number if not is_urgent() else signal.SIGKILL)
                if self._is_over(process, time.monotonic() + patience_s, is_urgent):
                    break
                self._report(f"{process.name} goes on after {number.name}")

    def _is_over(self, process: Process, until_s: float, is_urgent: Callable[[], bool]) -> bool:
        assert process.popen is not None
        while time.monotonic() < until_s and not (is_urgent() and until_s < float("inf")):
            for key, _ in self._selector.select(_LOOK_S):
                self._read(key.data)
            if (status := process.popen.poll()) is not None:
                self._finish(process)
                process.done = True
                ended = f"was killed by {signal.Signals(-status).name}" if status < 0 else "ended"
                self._report(f"{process.name} {ended}")
                return True
        return False
