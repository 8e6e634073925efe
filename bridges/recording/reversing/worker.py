"""The process in which the machines of a recording run, and the checkpoints that it leaves behind.

One thread does all: it runs the machines and, while they are paused, answers questions. That way a
fork has everything, for of a process's threads it gets only the one that forks.

* Every `CHECKPOINT_S` the machines' process forks a checkpoint, which waits before a turn. To run
  on from there, the checkpoint is forked again, so it can be used as often as it is needed.
* The forks are children of the client's process, not of each other: only that waits for their ends.
* A link's end closes with the client. A process that waits then ends; one that works gets SIGIO,
  whose handler ends it. The same signal announces an interrupt.
* Machines run forwards only here. A question that needs another moment leaves the method that is
  asked by an exception that machines' code cannot catch: :class:`Resumed` if the machines go on
  and it is asked again when they are paused, :class:`Redirected` if another process answers it.
* No checkpoint is taken once somebody may have changed variables, or where a fork would lack
  something (:mod:`.processes`): the machines then run there from an earlier checkpoint.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable
from io import TextIOBase
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from llfsm.bridges.recording.reversing.processes import Origin, SocketLink
from llfsm.bridges.recording.reversing.reverse_debugger import (
    NEVER,
    Jump,
    RerunDebugger,
    ReverseDebugger,
)
from llfsm.runtime.engine.events import Event, Section, Turn
from llfsm.runtime.worker import LinkClosedError, call, sendable

if TYPE_CHECKING:
    from llfsm.bridges.recording.rerun import Rerun


CHECKPOINT_S: Final = 0.4
"""How long machines run between two checkpoints, in seconds of a core."""
PASSED: Final = "passed"
"""What is asked, with whether this is the end, for the last moment with a breakpoint's hit."""
Serve: TypeAlias = Callable[[ReverseDebugger], Any]
"""It makes the object that is asked; `Asked` names one of its methods."""
Asked: TypeAlias = tuple[Any, ...]
"""The name of a method, and its arguments. What it returns is pickled; of an iterator, a list."""
_LOOK_TURNS: Final = 8  # between two looks how long they have run: to look takes a system call
_CODE_OF_FAILED: Final = 1
_YIELD_S: Final = 0.0002


class Moment(NamedTuple):
    """The place of machines in a recording."""

    number: int
    """The number of the turn that is to come; 0 before anything is arranged."""
    time_ns: int
    """The time of that turn; `NEVER` at the end."""
    breakpoints: tuple[str, ...] = ()
    counted: bool = True
    """True if these have counted their hits from the beginning."""

    def counts(self, breakpoints: tuple[str, ...]) -> bool:
        """Check that these have counted from the beginning, or have nothing to be counted."""
        if self.breakpoints == breakpoints:
            return self.counted
        # Without a count there is nothing to be counted; messages that were read count as known.
        return not any("#" in text or text.startswith("@") for text in breakpoints)


class Resumed(BaseException):  # no error of the code through which it passes
    """The machines go on: the question is answered when they are paused again."""


class Redirect(NamedTuple):
    """The answer is at another moment; None for the last hit of a breakpoint before this one."""

    jump: Jump | None


class Redirected(BaseException):
    """The question cannot be answered in this process."""

    def __init__(self, jump: Jump | None):
        self.redirect = Redirect(jump)


class ForwardDebugger(ReverseDebugger):
    """A debugger whose machines run in its own thread, forwards only."""

    def __init__(self, worker: RerunWorker, *arguments: Any):
        self._worker = worker
        self.over = False
        super().__init__(*arguments)

    def _begin(self, jump: Jump) -> None:
        self.rerun = self._arrange(jump)

    def _debugger_of(self, rerun: Rerun, since: int) -> RerunDebugger:
        return WorkerDebugger(rerun, since, self._worker)

    def run(self) -> None:
        """Run the machines; return at the end."""
        self._run(self.rerun)
        self.over = True

    def wait(self) -> str:
        """Report why the machines are paused; "" at the end. Raise the error that ended them."""
        if self.over:
            if self._error is not None:
                raise self._error
            return ""
        if not self.debugger.paused:
            raise Resumed
        return self.debugger.paused

    def break_at(self, *texts: str) -> None:
        """Replace all breakpoints; raise `BreakpointError`."""
        super().break_at(*texts)
        self._worker.counts = self.debugger.moment == 1

    def back_to_breakpoint(self) -> str:
        """Leave this to another process."""
        raise Redirected(None)

    def _go_to(self, jump: Jump) -> str:
        raise Redirected(jump._replace(breakpoints=self.debugger.breakpoints))

    _go_on_to = _go_to


class _Released:
    """In place of the `threading.Event` for which paused machines wait: they serve meanwhile."""

    def __init__(self, serve: Callable[[], None]):
        self._serve = serve
        self._is_set = False

    def is_set(self) -> bool:
        return self._is_set

    def set(self) -> None:
        self._is_set = True

    def clear(self) -> None:
        self._is_set = False

    def wait(self, _: float) -> bool:
        self._serve()
        return True


class WorkerDebugger(RerunDebugger):
    """The debugger in a worker, which takes checkpoints before turns and serves in pauses."""

    def __init__(self, rerun: Rerun, since: int, worker: RerunWorker):
        super().__init__(rerun, since)
        self._worker = worker
        self._go = _Released(worker.serve)  # type: ignore[assignment]  # it is used as an Event

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, Turn) and self._rerun.difference is None:
            self._worker.checkpoint_if_due(event)
        super().__call__(event)

    def jump(self, jump: Jump) -> None:
        """Run to a moment, in the fork of a checkpoint, which was taken on the way to another."""
        self.passed, self.fired, self.place = 0, None, None
        self.run_to(jump.goal(self), jump.since)

    def _open_pdb(self, event: Section) -> None:
        place = self.place
        super()._open_pdb(event)
        if self.place is not place:
            self._worker.is_touched = True


class RerunWorker:
    """The machines in this process, and whom it serves: one link, until that is closed."""

    def __init__(self, link: SocketLink, serve: Serve):
        self._link = link
        self._then: Asked | None = None
        self._serve = serve
        self._is_serving = False
        self.debugging: ForwardDebugger
        self.counts = True
        """True if the breakpoints have counted their hits from the beginning."""
        self.is_touched = False
        """True once somebody may have changed variables."""
        self._turns = 0
        self._taken_s = time.process_time()  # when the latest checkpoint was
        self._known: list[int] = []

    def run(self, jump: Jump, then: Asked, known: list[int], *arguments: Any) -> None:
        """Arrange the machines, run to a moment and serve; never return."""
        self._begin(then, known)
        self._origin = Origin()
        sys.breakpointhook = self._breakpoint
        self.debugging = ForwardDebugger(self, *arguments, jump)
        self._served = self._serve(self.debugging)
        self.debugging.run()
        while True:
            self.serve()

    def _begin(self, then: Asked, known: list[int]) -> None:
        """Take over, in a new process."""
        self._then, self._known, self._turns = then, sorted(known, reverse=True), 0
        self._taken_s = time.process_time()
        _notify(self._link, self._notice)
        if sys.stdin is not sys.__stdin__ or sys.stdin is None or not sys.stdin.isatty():
            sys.stdin = _Input(self._link)
        self._link.send(("hello", os.getpid()))

    def _notice(self, *_: object) -> None:
        """Pause at a sign, end with the link: something has come over it."""
        try:
            is_interrupted = self._link.interrupted()
        except LinkClosedError:
            os._exit(0)
        if is_interrupted and not self._is_serving and hasattr(self, "debugging"):
            self.debugging.debugger.pause("interrupt")

    def _breakpoint(self, *arguments: Any, **options: Any) -> Any:
        self.is_touched = True
        return sys.__breakpointhook__(*arguments, **options)

    # Questions

    def serve(self) -> None:
        """Answer questions until the machines go on."""
        self._is_serving = True
        asked, self._then = self._then, None
        if asked is not None and self._goes_on(asked, None):
            return
        while True:
            kind, *request = self._link.receive()
            if kind == "run":
                jump, self._then = request
                self.debugging.debugger.run_to(jump.goal(self.debugging.debugger), jump.since)
                self._is_serving = False
                return
            if self._goes_on(*request):
                return

    def _goes_on(self, asked: Asked, then: Asked | None) -> bool:
        """Answer a question; return True instead if the machines go on."""
        try:
            if then is None:
                self.debugging.wait()  # which raises the error that has ended the machines
            answer = self._found(*asked)
        except Resumed:
            self._then, self._is_serving = then or asked, False
            return True
        except Redirected as redirected:
            answer = redirected.redirect
        except Exception as error:
            answer = sendable(error)
        for file in (sys.stdout, sys.stderr):
            file.flush()
        self._link.send(("answer", answer, self._moment()))
        return False

    def _found(self, name: str, *arguments: Any) -> Any:
        if name == PASSED:
            return self.debugging.debugger.last_hit(is_after_end=bool(*arguments))
        return call(self._served, name, *arguments)

    def _moment(self, turn: Turn | None = None) -> Moment:
        debugger = self.debugging.debugger
        turn = turn or debugger.turn
        time_ns = debugger.time_ns if turn is None else turn.time_ns + debugger.behind_ns
        if self.debugging.over:
            time_ns = NEVER
        return Moment(debugger.moment, time_ns, debugger.breakpoints, self.counts)

    # Checkpoints

    def checkpoint_if_due(self, turn: Turn) -> None:
        """Take a checkpoint before a turn that is to come, if it is time to, and it can be."""
        self._turns += 1
        if self._turns % _LOOK_TURNS:
            return
        now_s, number = time.process_time(), self.debugging.debugger.number + 1
        while self._known and self._known[-1] <= number:  # there is one already
            self._known.pop()
            self._taken_s = now_s
        if now_s - self._taken_s >= CHECKPOINT_S and not self.is_touched:
            self._taken_s = now_s
            self._checkpoint(turn)
            self._taken_s = time.process_time()

    def _checkpoint(self, turn: Turn) -> None:
        """Fork a process that waits here; return in this one, and in those forked from it."""
        files = self._origin.files()
        if files is None:
            return
        ours, theirs = SocketLink.pair()
        for file in (sys.stdout, sys.stderr):
            file.flush()
        try:
            is_checkpoint = _forked()
        except OSError:  # the system has no more processes, or memory
            is_checkpoint = False
        else:
            if not is_checkpoint:
                self._link.send_with(("checkpoint", self._moment(turn)), ours)
        if not is_checkpoint:
            ours.close()
            theirs.close()
            return
        ours.close()
        self._link.close()
        theirs.send(("hello", os.getpid()))
        jump, then, known, self._link = _forked_when_asked(theirs)
        for each in files:
            each.reopen()
        self._begin(then, known)
        debugger = self.debugging.debugger
        if jump.breakpoints != debugger.breakpoints:
            self.debugging.break_at(*jump.breakpoints)
        assert isinstance(debugger, WorkerDebugger)
        debugger.jump(jump)


class _Input(TextIOBase):
    """The client's standard input: only the client knows what of it was read already."""

    def __init__(self, link: SocketLink):
        self._link = link

    def readable(self) -> bool:
        return True

    def readline(self, size: int | None = -1, /) -> str:  # type: ignore[override]
        self._link.send(("input",))
        _, line = self._link.receive()
        return str(line)


def start_origin(serve: Serve, *arguments: Any, closed: list[SocketLink]) -> tuple[SocketLink, int]:
    """Fork the origin, the checkpoint at the beginning; return a link to it, and its id.

    `arguments` are those of `ReverseDebugger`; the links `closed` are not its own.
    """
    ours, theirs = SocketLink.pair()
    for file in (sys.stdout, sys.stderr):
        file.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: they take no part in it
        process = os.fork()
    if process:
        theirs.close()
        return ours, process
    try:
        for link in (ours, *closed):
            link.close()
        for name in ("SIGTERM", "SIGHUP"):
            signal.signal(getattr(signal, name), signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all
        gc.freeze()  # to look for cycles would write to memory that processes share
        jump, then, known, link = _forked_when_asked(theirs)
        RerunWorker(link, serve).run(jump, then, known, *arguments)
    except LinkClosedError:
        os._exit(0)
    except Exception:
        sys.excepthook(*sys.exc_info())
    finally:  # whatever happens: what has called this goes on in another process
        os._exit(_CODE_OF_FAILED)


def _forked_when_asked(link: SocketLink) -> tuple[Jump, Asked, list[int], SocketLink]:
    """Wait as a checkpoint; return in each process that is forked from it, to run on."""
    signal.signal(signal.SIGIO, signal.SIG_IGN)
    while True:
        try:
            (jump, then, known), own = link.receive_with()
        except LinkClosedError:
            os._exit(0)
        assert own is not None
        try:
            is_new = _forked()
        except OSError:  # the client finds that there is no answer
            is_new = False
        if is_new:
            link.close()
            return jump, then, known, own
        own.close()


def _forked() -> bool:
    """Fork a process that is no child of this one; return True in the new one."""
    child = os.fork()
    if child:
        os.waitpid(child, 0)
        return False
    between = os.getpid()
    try:
        grandchild = os.fork()
    except OSError:
        os._exit(_CODE_OF_FAILED)
    if grandchild:
        os._exit(0)
    while os.getppid() == between:  # until then the client cannot wait for its end
        time.sleep(_YIELD_S)  # nothing signals that a process has a new parent
    return True


def _notify(link: SocketLink, notice: Callable[..., None]) -> None:
    """Call `notice` whenever something comes over a link, also its end."""
    import fcntl  # which Windows lacks

    signal.signal(signal.SIGIO, notice)
    fcntl.fcntl(link.fileno(), fcntl.F_SETOWN, os.getpid())
    flags = fcntl.fcntl(link.fileno(), fcntl.F_GETFL)
    fcntl.fcntl(link.fileno(), fcntl.F_SETFL, flags | os.O_ASYNC)
