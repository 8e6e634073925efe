"""Questions to the machines of a recording, each to the process in which it is answered.

The machines run in a fork of a checkpoint. A question that concerns their moment is answered there.
One that needs another moment is answered with a :class:`.Redirect`: the client has the nearest
checkpoint before that moment forked, lets the machines run on there, and ends their old process.
The origin, from which machines run from the beginning, counts as a checkpoint at moment 0.

To go back to a breakpoint is to search: from the nearest checkpoint to now, then from the one
before up to that one, and so on, until one has passed a hit. Each stretch is run once.

A process may end at any time, by the machines' code or by the system. A checkpoint that has ended
is dropped, and the one before it taken; for the machines' own, they are where they were before.

Where processes cannot be forked, machines run in this one, and from the beginning to go back.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple, NoReturn

from llfsm.bridges.recording.errors import RecordingError
from llfsm.bridges.recording.reversing.checkpoints import Checkpoint, Checkpoints
from llfsm.bridges.recording.reversing.processes import SocketLink
from llfsm.bridges.recording.reversing.reverse_debugger import (
    NEVER,
    NO_BREAKPOINT,
    Jump,
    ReverseDebugger,
)
from llfsm.bridges.recording.reversing.worker import (
    PASSED,
    Asked,
    Moment,
    Redirect,
    Serve,
    start_origin,
)
from llfsm.runtime.worker import LinkClosedError, call
from llfsm.whiteboard.closing import ClosedOnExit

if TYPE_CHECKING:
    from llfsm.bridges.recording.rerun import Rerun
    from llfsm.runtime.engine.machine import Machine


_SUBREAPER: Final = 36  # PR_SET_CHILD_SUBREAPER, of <linux/prctl.h>


@dataclass(eq=False)
class Client(ClosedOnExit):
    """Asks the object that `serve` makes of a `ReverseDebugger`, wherever the machines are.

    `read_line` returns a line of standard input for machines' code in another process.
    """

    make: Callable[[], Rerun]
    library: Mapping[str, type[Machine]]
    begin_ns: int
    serve: Serve
    read_line: Callable[[], str] = lambda: ""

    @abstractmethod
    def ask(self, name: str, *arguments: Any, then: Asked | None = None) -> Any:
        """Call a method of the object; return its result, or raise here what it raises.

        A method that lets machines go on may not return where they are in another process: then
        the answer is that of `then`, once they are paused again.
        """


class LocalClient(Client):
    """Ask an object in this process, in which the machines run, too."""

    _debugger: ReverseDebugger | None = None  # from the first question on

    def ask(self, name: str, *arguments: Any, then: Asked | None = None) -> Any:
        """Call a method; it returns when the machines are paused, so `then` is not needed."""
        if self._debugger is None:
            self._debugger = ReverseDebugger(self.make, self.library, self.begin_ns)
            self._served = self.serve(self._debugger)
            self._debugger.wait()
        return call(self._served, name, *arguments)

    def close(self) -> None:
        """End the machines' thread; closing twice is fine."""
        if self._debugger is not None:
            self._debugger.__exit__(None, None, None)
            self._debugger = None


class _Running(NamedTuple):
    """The process in which the machines are, and where it was forked."""

    link: SocketLink
    process: int
    begun_at: int
    """The number of the moment from which it ran on."""


@dataclass(eq=False)
class ForkingClient(Client):
    """Ask objects in processes that are forked from checkpoints.

    Ctrl-C pauses machines that run. Should their process end, as machines' code can do that, they
    are at the moment before.
    """

    def __post_init__(self) -> None:
        self.checkpoints = Checkpoints()
        self._current: _Running | None = None
        self._answering: _Running | None = None  # of which an answer is awaited
        self._at, self._why = Moment(0, 0), "start"
        self._was_interrupted = False
        self._origin: Checkpoint | None = None
        _adopt_orphans(is_on=True)
        self._begin()

    def ask(self, name: str, *arguments: Any, then: Asked | None = None) -> Any:
        """Call a method where the machines are, or at the moment to which it redirects."""
        asked: Asked = (name, *arguments)
        with self._interrupting():
            if self._current is None:  # it is the first question, or their process has ended
                self._jump(self._jump_to(max(self._at.number, 1), self._why), (PASSED,))
            found = self._answer(self._current, ("ask", asked, then))
            if isinstance(found, Redirect):
                assert then is not None
                found = self._redirect(found.jump, then)
        return found

    def close(self) -> None:
        """End all processes; closing twice is fine."""
        if self._origin is None:
            return
        self._leave(self._current)
        self.checkpoints.all.append(self._origin)
        self.checkpoints.close()
        self._origin = self._current = None
        _adopt_orphans(is_on=False)

    # To other moments

    def _jump_to(self, moment: int, why: str) -> Jump:
        return Jump(why, moment, moment, breakpoints=self._at.breakpoints)

    def _redirect(self, jump: Jump | None, then: Asked) -> Any:
        if jump is None:
            return self._back_to_breakpoint(then)
        if jump.after_ns is not None and self._at.time_ns <= jump.after_ns:
            nearest = next(self.checkpoints.before(jump), None)
            if nearest is None or nearest.at.number <= self._at.number:
                return self._answer(self._current, ("run", jump, then))
        return self._jump(jump, then)

    def _back_to_breakpoint(self, then: Asked) -> Any:
        """Search for the last hit in the last stretch that can be run alone, then in the others."""
        end, is_after_end = self._at.number, self._at.time_ns == NEVER
        since = end
        while end > 1:
            looking = self._jump_to(end, "back")._replace(since=since)
            searched, found, _ = self._run_to(looking, (PASSED, is_after_end))
            self._leave(searched)
            if isinstance(found, int) and found:
                return self._jump(self._jump_to(found, "back"), then)
            if self._was_interrupted or not isinstance(found, int):
                raise RecordingError("the search was interrupted")
            end = searched.begun_at
            since = end + 1
        raise RecordingError(NO_BREAKPOINT)

    def _jump(self, jump: Jump, then: Asked) -> Any:
        running, found, at = self._run_to(jump, then)
        self._leave(self._current)
        self._current, self._at, self._why = running, at, "back"
        if isinstance(found, Exception):
            raise found
        return found

    def _run_to(self, jump: Jump, then: Asked) -> tuple[_Running, Any, Moment]:
        """Run to a moment from the nearest checkpoint, in a new process; return its answer."""
        while True:
            nearest = next(self.checkpoints.before(jump), None) or self._origin
            assert nearest is not None
            ours, theirs = SocketLink.pair()
            known = [
                each.at.number
                for each in self.checkpoints.all
                if each.at.number > nearest.at.number and each.at.counts(jump.breakpoints)
            ]
            try:
                nearest.link.send_with((jump, then, known), theirs)
                theirs.close()
                _, process = ours.receive()  # hello
            except LinkClosedError:
                theirs.close()
                ours.close()
                self._lose(nearest)
                continue
            running = _Running(ours, process, nearest.at.number)
            return running, *self._received(running)

    def _lose(self, checkpoint: Checkpoint) -> None:
        """Do without a checkpoint whose process has ended; start the origin anew."""
        if checkpoint is not self._origin:
            self.checkpoints.drop(checkpoint)
            return
        checkpoint.link.close()
        self.checkpoints.end(checkpoint.process)
        self._begin()

    # Questions and answers

    def _answer(self, running: _Running | None, message: object) -> Any:
        assert running is not None
        try:
            running.link.send(message)
        except LinkClosedError:
            self._lost(running)
        found, self._at = self._received(running)
        if isinstance(found, Exception):
            raise found
        return found

    def _received(self, running: _Running) -> tuple[Any, Moment]:
        """Wait for an answer; add checkpoints and give lines of input meanwhile."""
        self._answering = running
        try:
            while True:
                (kind, *parts), link = running.link.receive_with()
                match kind:
                    case "checkpoint":
                        assert link is not None
                        with suppress(LinkClosedError):  # it could not be forked, or has ended
                            _, process = link.receive()  # hello
                            self.checkpoints.add(Checkpoint(parts[0], link, process))
                    case "input":
                        running.link.send(("input", self.read_line()))
                    case _:
                        return parts[0], parts[1]
        except LinkClosedError:
            self._lost(running)
        finally:
            self._answering = None

    def _lost(self, running: _Running) -> NoReturn:
        self._leave(running)
        if running is self._current:
            self._current = None
        raise RecordingError(
            "the process in which the machines ran has ended: they are where they were before"
        )

    def _leave(self, running: _Running | None) -> None:
        if running is not None:
            running.link.close()
            with suppress(ProcessLookupError):  # machines' code may run for ever
                os.kill(running.process, signal.SIGKILL)
            self.checkpoints.end(running.process)

    def _begin(self) -> None:
        """Start the process from which machines run from the beginning."""
        links = [checkpoint.link for checkpoint in self.checkpoints.all]
        links += [self._current.link] if self._current is not None else []
        arguments = self.make, self.library, self.begin_ns
        link, process = start_origin(self.serve, *arguments, closed=links)
        self._origin = Checkpoint(Moment(0, 0), link, process)

    @contextmanager
    def _interrupting(self) -> Iterator[None]:
        """Let Ctrl-C pause machines, in the main thread."""
        self._was_interrupted = False
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def interrupt(*_: object) -> None:
            self._was_interrupted = True
            if self._answering is not None:
                self._answering.link.interrupt()

        before = signal.signal(signal.SIGINT, interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


def start_client(
    make: Callable[[], Rerun],
    library: Mapping[str, type[Machine]],
    begin_ns: int,
    serve: Serve,
    read_line: Callable[[], str] = lambda: "",
) -> Client:
    """Start the client for this system; the arguments are as for `Client`."""
    kind = ForkingClient if sys.platform == "linux" else LocalClient
    return kind(make, library, begin_ns, serve, read_line)


def _adopt_orphans(*, is_on: bool) -> None:
    """Let this process reap processes whose parents have ended, as those between do at once."""
    ctypes.CDLL(None).prctl(_SUBREAPER, int(is_on), 0, 0, 0)
