"""Through a recording with processes that are kept on the way, so that going back is quick.

:mod:`.travel_host` is what runs in these. Where processes cannot be forked, machines run in this
one, and from the beginning to go back.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn, Protocol, Self

from llfsm.bridges.recording.errors import MachinesGoneError, MomentError
from llfsm.bridges.recording.reversing.checkpoints import KeptPoint, KeptPoints
from llfsm.bridges.recording.reversing.processes import LinkClosedError, ProcessLink
from llfsm.bridges.recording.reversing.reverse_debugger import NEVER, NO_BREAKPOINT, Jump, Travel
from llfsm.bridges.recording.reversing.worker import (
    PASSED,
    Asked,
    Moment,
    OtherMoment,
    Serve,
    start_origin,
)

if TYPE_CHECKING:
    from llfsm.bridges.recording.rerun import Rerun
    from llfsm.runtime.engine.machine import Machine


_SUBREAPER: Final = 36  # PR_SET_CHILD_SUBREAPER, of <linux/prctl.h>


class Travelled(Protocol):
    """What goes through a recording, and is asked there."""

    def __enter__(self) -> Self:
        """Return itself."""
        ...

    def __exit__(self, *_: object) -> None:
        """Close it."""
        ...

    def ask(self, name: str, *arguments: Any, then: Asked | None = None) -> Any:
        """Return what a method of what is asked returns; raise what it raises.

        One that lets machines go on returns when they are paused again, or, if they are in another
        process, never: then the answer is that to `then`.
        """
        ...

    def close(self) -> None:
        """End the machines."""
        ...


def travelling(
    make: Callable[[], Rerun],
    library: Mapping[str, type[Machine]],
    begin_ns: int,
    serve: Serve,
    read_line: Callable[[], str] = lambda: "",
) -> Travelled:
    """Return what goes through a recording as `Travel` does, and is asked what `serve` makes.

    `read_line` is as for `KeptTravel`.
    """
    if sys.platform == "linux":
        return KeptTravel(make, library, begin_ns, serve, read_line)
    return InProcess(make, library, begin_ns, serve)


class _Running(NamedTuple):
    """The process of the machines."""

    link: ProcessLink
    process: int
    begun_at: int
    """The number of the moment from which it ran on."""


class InProcess:
    """Ask what goes through a recording in this process."""

    def __init__(
        self,
        make: Callable[[], Rerun],
        library: Mapping[str, type[Machine]],
        begin_ns: int,
        serve: Serve,
    ):
        self._arguments = make, library, begin_ns
        self._serve = serve
        self._travel: Travel | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def ask(self, name: str, *arguments: Any, then: Asked | None = None) -> Any:
        """Return what a method of what is asked returns; raise what it raises."""
        if self._travel is None:
            self._travel = Travel(*self._arguments)
            self._served = self._serve(self._travel)
            self._travel.wait()
        found = getattr(self._served, name)(*arguments)
        return [*found] if isinstance(found, Iterator) else found

    def close(self) -> None:
        """End the machines' thread."""
        if self._travel is not None:
            self._travel.__exit__(None, None, None)
            self._travel = None


class KeptTravel:
    """Ask what goes through a recording in processes of its own.

    `read_line` returns a line of standard input for the machines' code. Ctrl-C pauses machines that
    run. Should their process end, as machines' code can do that, they are at the moment before.

    kept: the moments from which machines run on to go back.
    """

    def __init__(
        self,
        make: Callable[[], Rerun],
        library: Mapping[str, type[Machine]],
        begin_ns: int,
        serve: Serve,
        read_line: Callable[[], str] = lambda: "",
    ):
        self._arguments = make, library, begin_ns
        self._serve = serve
        self._read_line = read_line
        self.kept = KeptPoints()
        self._host: _Running | None = None
        self._running: _Running | None = None  # of which an answer is awaited
        self._at, self._why = Moment(0, 0), "start"
        self._was_interrupted = False
        self._origin: KeptPoint | None = None
        _adopt_orphans(is_on=True)
        self._begin()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def ask(self, name: str, *arguments: Any, then: Asked | None = None) -> Any:
        """Return what a method of what is asked returns; raise what it raises."""
        asked: Asked = (name, *arguments)
        with self._interrupting():
            if self._host is None:  # it is the first question, or their process has ended
                self._jump(self._jump_to(max(self._at.number, 1), self._why), (PASSED,))
            found = self._answer(self._host, ("ask", asked, then))
            if isinstance(found, OtherMoment):
                assert then is not None
                found = self._go(found.jump, then)
        return found

    def close(self) -> None:
        """End all processes; closing twice is fine."""
        if self._origin is None:
            return
        self._leave(self._host)
        self.kept.points.append(self._origin)
        self.kept.close()
        self._origin = self._host = None
        _adopt_orphans(is_on=False)

    def _jump_to(self, moment: int, why: str) -> Jump:
        return Jump(why, moment, moment, breakpoints=self._at.breakpoints)

    def _go(self, jump: Jump | None, then: Asked) -> Any:
        if jump is None:
            return self._go_to_breakpoint(then)
        if jump.after_ns is not None and self._at.time_ns <= jump.after_ns:
            nearest = next(self.kept.usable(jump), None)
            if nearest is None or nearest.at.number <= self._at.number:
                return self._answer(self._host, ("run", jump, then))
        return self._jump(jump, then)

    def _go_to_breakpoint(self, then: Asked) -> Any:
        """Look for the last one, in the last stretch that can be run alone, then in the others."""
        end, is_after_end = self._at.number, self._at.time_ns == NEVER
        since = end
        while end > 1:
            looking = self._jump_to(end, "back")._replace(since=since)
            host, found, _ = self._woken(looking, (PASSED, is_after_end))
            self._leave(host)
            if isinstance(found, int) and found:
                return self._jump(self._jump_to(found, "back"), then)
            if self._was_interrupted or not isinstance(found, int):
                raise MomentError("the search was interrupted")
            end = host.begun_at
            since = end + 1
        raise MomentError(NO_BREAKPOINT)

    def _jump(self, jump: Jump, then: Asked) -> Any:
        host, found, at = self._woken(jump, then)
        self._leave(self._host)
        self._host, self._at, self._why = host, at, "back"
        if isinstance(found, Exception):
            raise found
        return found

    def _woken(self, jump: Jump, then: Asked) -> tuple[_Running, Any, Moment]:
        """Run to a moment from the nearest that is kept; one whose process has ended is dropped."""
        while True:
            point = next(self.kept.usable(jump), None) or self._origin
            assert point is not None
            ours, theirs = ProcessLink.pair()
            known = [
                each.at.number
                for each in self.kept.points
                if each.at.number > point.at.number and each.at.counts(jump.breakpoints)
            ]
            try:
                point.link.send((jump, then, known), theirs)
                theirs.close()
                (_, process), _ = ours.receive()  # hello
            except LinkClosedError:
                theirs.close()
                ours.close()
                self._lose(point)
                continue
            host = _Running(ours, process, point.at.number)
            return host, *self._received(host)

    def _lose(self, point: KeptPoint) -> None:
        """Do without a process that has ended."""
        if point is not self._origin:
            self.kept.drop(point)
            return
        point.link.close()
        self.kept.end(point.process)
        self._begin()

    def _answer(self, host: _Running | None, message: object) -> Any:
        assert host is not None
        try:
            host.link.send(message)
        except LinkClosedError:
            self._lost(host)
        found, self._at = self._received(host)
        if isinstance(found, Exception):
            raise found
        return found

    def _received(self, host: _Running) -> tuple[Any, Moment]:
        """Wait for an answer; keep what is kept, and give what is read, meanwhile."""
        self._running = host
        try:
            while True:
                (kind, *parts), link = host.link.receive()
                match kind:
                    case "kept":
                        assert link is not None
                        with suppress(LinkClosedError):  # it could not be forked, or has ended
                            (_, process), _ = link.receive()  # hello
                            self.kept.add(KeptPoint(parts[0], link, process))
                    case "input":
                        host.link.send(("input", self._read_line()))
                    case _:
                        return parts[0], parts[1]
        except LinkClosedError:
            self._lost(host)
        finally:
            self._running = None

    def _lost(self, host: _Running) -> NoReturn:
        self._leave(host)
        if host is self._host:
            self._host = None
        raise MachinesGoneError(
            "the process in which the machines ran has ended: they are where they were before"
        )

    def _leave(self, host: _Running | None) -> None:
        if host is not None:
            host.link.close()
            with suppress(ProcessLookupError):  # machines' code may run for ever
                os.kill(host.process, signal.SIGKILL)
            self.kept.end(host.process)

    def _begin(self) -> None:
        """Start the process from which machines run from the beginning."""
        links = [point.link for point in self.kept.points]
        links += [self._host.link] if self._host is not None else []
        link, process = start_origin(self._serve, *self._arguments, closed=links)
        self._origin = KeptPoint(Moment(0, 0), link, process)

    @contextmanager
    def _interrupting(self) -> Iterator[None]:
        """Let Ctrl-C pause machines, in the main thread."""
        self._was_interrupted = False
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def interrupt(*_: object) -> None:
            self._was_interrupted = True
            if self._running is not None:
                self._running.link.interrupt()

        before = signal.signal(signal.SIGINT, interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


def _adopt_orphans(*, is_on: bool) -> None:
    """Let this process get a signal when those that were forked by others in between have ended."""
    ctypes.CDLL(None).prctl(_SUBREAPER, int(is_on), 0, 0, 0)
