"""Run the tests in so many processes as LLFSM_WORKERS says: a plugin for `make test`.

All tests are imported and collected once, then the process is forked. Each worker takes a file of
tests after another and sends what comes of them; what is printed is pytest's own. pytest-xdist has
workers that each import and collect all tests themselves: with seven, which keep two processors
busy while tests wait, that took a minute of processor time, a sixth of all.

A worker asks for its next file before the last test of the one it is at, as pytest wants to know
which fixtures that needs, too. One that dies fails the test that ran, and another takes its place.
"""

from __future__ import annotations

import atexit
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


class Workers:
    """Hand out files of tests to workers, and pass on to pytest what they report."""

    def __init__(self, count: int, begin: Callable[[], None]) -> None:
        self._count = count
        self._begin = begin  # called in each worker
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
                for connection in wait([*self._workers]):
                    assert isinstance(connection, Connection)
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
            _work(session, theirs, self._ordinal - 1, self._begin)
        theirs.close()
        self._workers[ours] = _Worker(pid)

    def _serve(self, session: pytest.Session, connection: Connection) -> None:
        """Pass on what a worker has sent, or answer with its next file."""
        worker = self._workers[connection]
        try:
            what, *content = connection.recv()
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
            worker.running = session.items[worker.tests.popleft()]
            hook.pytest_runtest_logstart(nodeid=content[0], location=content[1])
        elif what == "finish":
            worker.running = None
            hook.pytest_runtest_logfinish(nodeid=content[0], location=content[1])
        else:
            report = hook.pytest_report_from_serializable(config=session.config, data=content[0])
            hook.pytest_runtest_logreport(report=report)

    def _bury(self, session: pytest.Session, worker: _Worker) -> None:
        """Wait for a worker that ends. If it died, fail its test, and let another do the rest."""
        _, status = os.waitpid(worker.pid, 0)
        if worker.running is not None:
            item, hook = worker.running, session.config.hook
            text = f"the process that ran it died: {os.waitstatus_to_exitcode(status)}"
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
        self.tests = deque[int]()  # that it was given and has not begun
        self.running: pytest.Item | None = None

    def kill(self) -> None:
        os.kill(self.pid, 9)
        os.waitpid(self.pid, 0)


# ---- In a worker


def _work(
    session: pytest.Session, connection: Connection, ordinal: int, begin: Callable[[], None]
) -> NoReturn:
    """Run what is handed out, and end the process."""
    status = 1
    try:
        atexit._clear()  # what was registered before is done by the process that forked this one
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
