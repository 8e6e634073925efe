"""Run the tests in so many processes as LLFSM_WORKERS says: a plugin for `make test`.

All tests are imported and collected once, then the process is forked. Each worker takes a file of
tests after another and sends what comes of them; what is printed is pytest's own. pytest-xdist has
workers that each import and collect all tests themselves: with seven, which keep two processors
busy while tests wait, that took a minute of processor time, a sixth of all.

A worker asks for its next file before the last test of the one it is at, as pytest wants to know
which fixtures that needs, too. One that dies fails the test that ran, and another takes its place.
One that is stuck where no limit of a test ends it, in a call that takes no signals or after its
last test, prints where its threads are and dies.
"""

from __future__ import annotations

import atexit
import faulthandler
import os
import random
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from itertools import groupby, pairwise
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any, NoReturn

import pytest
from _pytest._io import TerminalWriter

__all__ = ["Workers"]

STUCK_S = 400  # more than three times the limit of a test, which has its fixtures to end after that


class Workers:
    """Hand out files of tests to workers, and pass on to pytest what they report."""

    def __init__(self, count: int, begin: Callable[[], None], stuck_s: float = STUCK_S) -> None:
        self._count = count
        self._begin = begin  # called in each worker
        self._stuck_s = stuck_s
        self._left: deque[list[int]] = deque()  # indices of tests, by file
        self._workers: dict[Connection, _Worker] = {}
        self._ordinal = 0

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Run all tests; where there is nothing to run, leave that to pytest."""
        if session.testsfailed or session.config.option.collectonly:
            return None
        session.config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]
        by_file = groupby(range(len(session.items)), key=lambda n: session.items[n].path)
        self._left.extend(list(numbers) for _, numbers in by_file)
        try:
            for _ in range(min(self._count, len(self._left))):
                self._start(session)
            while self._workers:
                # A dead one is known by its process: what it forked may keep its connection open.
                ends = {worker.process: connection for connection, worker in self._workers.items()}
                ready = wait([*self._workers, *ends])
                heard = [one for one in ready if isinstance(one, Connection)]
                for connection in heard or [ends[one] for one in ready if isinstance(one, int)]:
                    self._serve(session, connection)
        finally:
            for worker in self._workers.values():
                worker.kill()
        if session.shouldfail:
            raise session.Failed(session.shouldfail)
        return True

    def _start(self, session: pytest.Session) -> None:
        ours, theirs = Pipe()
        self._ordinal += 1
        pid = os.fork()
        if pid == 0:
            for other in (ours, *self._workers):
                other.close()
            watchdog = _Watchdog(self._stuck_s)
            _work(session, theirs, self._ordinal - 1, self._begin, watchdog)
        theirs.close()
        self._workers[ours] = _Worker(pid)

    def _serve(self, session: pytest.Session, connection: Connection) -> None:
        """Pass on what a worker has sent, or answer with its next file."""
        worker = self._workers[connection]
        try:
            # What it sent before it died comes first.
            what, *content = connection.recv() if connection.poll() else ["end"]
        except (EOFError, ConnectionError):
            what, content = "end", []
        hook = session.config.hook
        if what == "end":
            connection.close()
            del self._workers[connection]
            self._bury(session, worker)
        elif what == "next":
            stops = session.shouldfail or session.shouldstop
            files = [] if stops or not self._left else [self._left.popleft()]
            worker.tests += [number for numbers in files for number in numbers]
            connection.send(files[0] if files else None)
        elif what == "start":
            worker.last = worker.running = session.items[worker.tests.popleft()]
            hook.pytest_runtest_logstart(nodeid=content[0], location=content[1])
        elif what == "finish":
            worker.running = None
            hook.pytest_runtest_logfinish(nodeid=content[0], location=content[1])
        else:
            report = hook.pytest_report_from_serializable(config=session.config, data=content[0])
            hook.pytest_runtest_logreport(report=report)

    def _bury(self, session: pytest.Session, worker: _Worker) -> None:
        """Wait for a worker that ends. If it died, fail its test, and let another do the rest."""
        status = worker.wait()
        if worker.last is not None and (worker.running is not None or status):
            item, hook = worker.last, session.config.hook
            what = "ran it" if worker.running else "had run it last"
            text = f"the process that {what} died: {os.waitstatus_to_exitcode(status)}"
            report = pytest.TestReport(item.nodeid, item.location, {}, "failed", text, "call")
            hook.pytest_runtest_logreport(report=report)
            hook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        if worker.tests:
            self._left.appendleft([*worker.tests])
        if self._left and not (session.shouldfail or session.shouldstop):
            self._start(session)


class _Worker:
    """A worker, as the process that forked it sees it."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.process = os.pidfd_open(pid)  # is ready to be read when it has ended
        self.tests = deque[int]()  # that it was given and has not begun
        self.running: pytest.Item | None = None
        self.last: pytest.Item | None = None  # that began

    def kill(self) -> None:
        os.kill(self.pid, 9)
        self.wait()

    def wait(self) -> int:
        """Wait for its end; return its status."""
        _, status = os.waitpid(self.pid, 0)
        os.close(self.process)
        return status


# ---- In a worker


def _work(
    session: pytest.Session,
    connection: Connection,
    ordinal: int,
    begin: Callable[[], None],
    watchdog: _Watchdog,
) -> NoReturn:
    """Run what is handed out, and end the process."""
    status = 1
    try:
        atexit._clear()  # what was registered before is done by the process that forked this one
        session.config.pluginmanager.register(watchdog)
        _own_process(session.config, ordinal)
        begin()
        session.config.pluginmanager.register(_Sender(session.config, connection))
        for item, following in _pairs(session, connection):
            session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if session.shouldfail or session.shouldstop:
                break
        status = 0
    except (KeyboardInterrupt, EOFError, BrokenPipeError):
        pass  # the process that forked this one ends, or has ended
    except BaseException:
        session.config.pluginmanager.getplugin("capturemanager").stop_global_capturing()
        traceback.print_exc()
    finally:
        atexit._run_exitfuncs()
        os._exit(status)


def _own_process(config: pytest.Config, ordinal: int) -> None:
    """Let no two workers share a name, a capture of what is printed, or random numbers."""
    os.environ["PYTEST_XDIST_WORKER"] = f"gw{ordinal}"  # the name that tests know it by
    random.seed()
    capture = config.pluginmanager.getplugin("capturemanager")
    capture.stop_global_capturing()
    capture.start_global_capturing()
    capture.suspend_global_capture(in_=False)
    config.pluginmanager.unregister(name="terminalreporter")
    config.pluginmanager.register(_Silent(), "terminalreporter")


def _pairs(
    session: pytest.Session, connection: Connection
) -> Iterator[tuple[pytest.Item, pytest.Item | None]]:
    """Yield the tests of this worker, each with the one after it, as they are handed out."""
    connection.send(["next"])
    numbers = connection.recv()
    while numbers:
        items = [session.items[number] for number in numbers]
        yield from pairwise(items)
        connection.send(["next"])
        numbers = connection.recv()
        yield items[-1], session.items[numbers[0]] if numbers else None


class _Watchdog:
    """End the worker where it has been at one test, or at its end, for too long."""

    def __init__(self, stuck_s: float) -> None:
        self._stuck_s = stuck_s
        self._printed = os.dup(2)  # before what tests print is captured
        self._begin()

    def pytest_runtest_logstart(self) -> None:
        """Give each test the whole time."""
        self._begin()

    @pytest.hookimpl(trylast=True)
    def pytest_exception_interact(self) -> None:
        """Go on where pytest has ended all that watches, as someone might debug what failed."""
        self._begin()

    def _begin(self) -> None:
        faulthandler.dump_traceback_later(self._stuck_s, exit=True, file=self._printed)


class _Silent:
    """Takes the place of what prints reports, whose writer a test that takes too long asks for."""

    def __init__(self) -> None:
        self._tw = TerminalWriter(open(os.devnull, "w"))  # noqa: SIM115  to the end


class _Sender:
    """Send what comes of tests."""

    def __init__(self, config: pytest.Config, connection: Connection) -> None:
        self._config = config
        self._connection = connection

    def pytest_runtest_logstart(self, nodeid: str, location: Any) -> None:
        """Send that a test begins."""
        self._connection.send(["start", nodeid, location])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Send a report."""
        hook = self._config.hook
        data = hook.pytest_report_to_serializable(config=self._config, report=report)
        self._connection.send(["report", data])

    def pytest_runtest_logfinish(self, nodeid: str, location: Any) -> None:
        """Send that a test has ended."""
        self._connection.send(["finish", nodeid, location])
