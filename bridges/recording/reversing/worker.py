"""The process in which the machines of a recording run, and those that are kept on the way.

One thread does all: it runs the machines and, while they are paused, what is asked of it. Every now
and then it forks a process that waits at that moment. To go back is to fork one of those again, and
to let that run on to the moment that is looked for. The link to the process that asks ends them.

Go through a recording in one thread, forwards only: in a process from which others are forked.

A question that cannot be answered at once leaves the function by an exception: the machines go on,
or another process answers.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from io import TextIOBase
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from llfsm.bridges.recording.errors import RecordingError
from llfsm.bridges.recording.reversing.processes import LinkClosedError, Origin, ProcessLink
from llfsm.bridges.recording.reversing.reverse_debugger import NEVER, Jump, Travel, TravelDebugger
from llfsm.runtime.engine.events import Event, Section, Turn

if TYPE_CHECKING:
    from llfsm.bridges.recording.rerun import Rerun


class Moment(NamedTuple):
    """Where the machines of a process are."""

    number: int
    """The number of the turn that is to come; 0 before anything is arranged."""
    time_ns: int
    """The time of that turn; `NEVER` at the end."""
    breakpoints: tuple[str, ...] = ()
    counted: bool = True
    """Whether these have counted their hits from the beginning."""

    def counts(self, breakpoints: tuple[str, ...]) -> bool:
        """Return whether these have counted from the beginning, or have nothing to be counted."""
        if self.breakpoints == breakpoints:
            return self.counted
        # Without a count there is nothing to be counted; messages that were read count as known.
        return not any("#" in text or text.startswith("@") for text in breakpoints)


class GoneOn(BaseException):  # no error of whom it passes
    """The machines go on: what was asked cannot be answered before they are paused again."""


class OtherMoment(NamedTuple):
    """Another process is to answer, at that moment; None for the last breakpoint before now."""

    jump: Jump | None


class GoneElsewhere(BaseException):
    """The answer is not to be found in this process."""

    def __init__(self, jump: Jump | None):
        self.elsewhere = OtherMoment(jump)


class ForwardTravel(Travel):
    """Go through a recording in one thread, forwards only."""

    def __init__(self, host: TravelHost, *arguments: Any):
        self._host = host
        self.over = False
        super().__init__(*arguments)

    def _begin(self, jump: Jump) -> None:
        self.rerun = self._arrange(jump)

    def _debugger_of(self, rerun: Rerun, since: int) -> TravelDebugger:
        return HostedDebugger(rerun, since, self._host)

    def run(self) -> None:
        """Run the machines; return at the end."""
        self._run(self.rerun)
        self.over = True

    def wait(self) -> str:
        """Return why the machines are paused; "" at the end. Raise what ended them."""
        if self.over:
            if self._error is not None:
                raise self._error
            return ""
        if not self.debugger.paused:
            raise GoneOn
        return self.debugger.paused

    def break_at(self, *texts: str) -> None:
        """Replace all breakpoints; raise `BreakpointError`."""
        super().break_at(*texts)
        self._host.counts = self.debugger.moment == 1

    def back_to_breakpoint(self) -> str:
        """Leave this to another process."""
        raise GoneElsewhere(None)

    def _go_to(self, jump: Jump) -> str:
        raise GoneElsewhere(jump._replace(breakpoints=self.debugger.breakpoints))

    _go_on_to = _go_to


class _Released:
    """The event that lets machines go on; to wait for it is to serve."""

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


class HostedDebugger(TravelDebugger):
    """A debugger whose process is kept at some turns, and asked while it is paused."""

    def __init__(self, rerun: Rerun, since: int, host: TravelHost):
        super().__init__(rerun, since)
        self._host = host
        self._go = _Released(host.serve)  # type: ignore[assignment]  # it is used as an Event

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, Turn) and self._rerun.difference is None:
            self._host.pass_by(event)
        super().__call__(event)

    def jump(self, jump: Jump) -> None:
        """Run to a moment, in a process that was kept while machines ran to another one."""
        self.passed, self.fired, self.place = 0, None, None
        self.run_to(jump.goal(self), jump.since)

    def _open_pdb(self, event: Section) -> None:
        place = self.place
        super()._open_pdb(event)
        if self.place is not place:
            self._host.is_touched = True


KEEP_S: Final = 0.4
"""How long machines run between two moments that are kept, in seconds of a core."""
PASSED: Final = "passed"
"""What is asked, with whether this is the end, for the last moment with a breakpoint's hit."""
Serve: TypeAlias = Callable[[Travel], Any]
"""It makes what is asked; `Asked` names one of its methods."""
Asked: TypeAlias = tuple[Any, ...]
"""The name of a method, and its arguments. What it returns is pickled; of an iterator, a list."""
_LOOK_TURNS: Final = 8  # between two looks how long they have run
_CODE_OF_FAILED: Final = 1
_YIELD_S: Final = 0.0002


class TravelHost:
    """What a process is: it serves one link, until that is closed."""

    def __init__(self, link: ProcessLink, serve: Serve):
        self._link = link
        self._then: Asked | None = None
        self._serve = serve
        self._is_serving = False
        self.travel: ForwardTravel
        self.counts = True
        """Whether the breakpoints have counted their hits from the beginning."""
        self.is_touched = False
        """Whether somebody may have changed variables."""
        self._turns = 0
        self._kept_s = time.process_time()
        self._known: list[int] = []

    def run(self, jump: Jump, then: Asked, known: list[int], *arguments: Any) -> None:
        """Arrange the machines, run to a moment and serve; return never."""
        self._begin(then, known)
        self._origin = Origin()
        sys.breakpointhook = self._breakpoint
        self.travel = ForwardTravel(self, *arguments, jump)
        self._served = self._serve(self.travel)
        self.travel.run()
        while True:
            self.serve()

    def _begin(self, then: Asked, known: list[int]) -> None:
        """Take over, in a new process."""
        self._then, self._known, self._turns = then, sorted(known, reverse=True), 0
        self._kept_s = time.process_time()
        _notify(self._link, self._notice)
        if sys.stdin is not sys.__stdin__ or sys.stdin is None or not sys.stdin.isatty():
            sys.stdin = _Input(self._link)
        self._link.send(("hello", os.getpid()))

    def _notice(self, *_: object) -> None:
        """Pause, or end: something has come from whom it serves."""
        try:
            is_interrupted = self._link.interrupted()
        except LinkClosedError:
            os._exit(0)
        if is_interrupted and not self._is_serving and hasattr(self, "travel"):
            self.travel.debugger.pause("interrupt")

    def _breakpoint(self, *arguments: Any, **options: Any) -> Any:
        self.is_touched = True
        return sys.__breakpointhook__(*arguments, **options)

    # Asked

    def serve(self) -> None:
        """Answer what is asked, until the machines go on."""
        self._is_serving = True
        asked, self._then = self._then, None
        if asked is not None and self._goes_on(asked, None):
            return
        while True:
            (kind, *request), _ = self._link.receive()
            if kind == "run":
                jump, self._then = request
                self.travel.debugger.run_to(jump.goal(self.travel.debugger), jump.since)
                self._is_serving = False
                return
            if self._goes_on(*request):
                return

    def _goes_on(self, asked: Asked, then: Asked | None) -> bool:
        try:
            if then is None:
                self.travel.wait()  # which raises what the machines have ended with
            answer = self._found(*asked)
        except GoneOn:
            self._then, self._is_serving = then or asked, False
            return True
        except GoneElsewhere as elsewhere:
            answer = elsewhere.elsewhere
        except Exception as error:
            answer = _sendable(error)
        for file in (sys.stdout, sys.stderr):
            file.flush()
        self._link.send(("answer", answer, self._moment()))
        return False

    def _found(self, name: str, *arguments: Any) -> Any:
        if name == PASSED:
            return self.travel.debugger.last_hit(is_after_end=bool(*arguments))
        found = getattr(self._served, name)(*arguments)
        return [*found] if isinstance(found, Iterator) else found

    def _moment(self, turn: Turn | None = None) -> Moment:
        debugger = self.travel.debugger
        turn = turn or debugger.turn
        time_ns = debugger.time_ns if turn is None else turn.time_ns + debugger.behind_ns
        if self.travel.over:
            time_ns = NEVER
        return Moment(debugger.moment, time_ns, debugger.breakpoints, self.counts)

    # Kept

    def pass_by(self, turn: Turn) -> None:
        """Keep the moment before a turn that is to come, if it is time to, and it can be."""
        self._turns += 1
        if self._turns % _LOOK_TURNS:
            return
        now_s, number = time.process_time(), self.travel.debugger.number + 1
        while self._known and self._known[-1] <= number:  # there is one already
            self._known.pop()
            self._kept_s = now_s
        if now_s - self._kept_s >= KEEP_S and not self.is_touched:
            self._kept_s = now_s
            self._keep(turn)
            self._kept_s = time.process_time()

    def _keep(self, turn: Turn) -> None:
        """Fork a process that waits here; return in this one, and in those forked from it."""
        files = self._origin.files()
        if files is None:
            return
        ours, theirs = ProcessLink.pair()
        for file in (sys.stdout, sys.stderr):
            file.flush()
        try:
            is_kept = _forked()
        except OSError:  # the system has no more processes, or memory
            is_kept = False
        else:
            if not is_kept:
                self._link.send(("kept", self._moment(turn)), ours)
        if not is_kept:
            ours.close()
            theirs.close()
            return
        ours.close()
        self._link.close()
        theirs.send(("hello", os.getpid()))
        jump, then, known, self._link = _wait_at(theirs)
        for each in files:
            each.reopen()
        self._begin(then, known)
        debugger = self.travel.debugger
        if jump.breakpoints != debugger.breakpoints:
            self.travel.break_at(*jump.breakpoints)
        assert isinstance(debugger, HostedDebugger)
        debugger.jump(jump)


class _Input(TextIOBase):
    """The standard input of whom a process serves: it has read more of it than it has used."""

    def __init__(self, link: ProcessLink):
        self._link = link

    def readable(self) -> bool:
        return True

    def readline(self, size: int | None = -1, /) -> str:  # type: ignore[override]
        self._link.send(("input",))
        (_, line), _ = self._link.receive()
        return str(line)


def start_origin(
    serve: Serve, *arguments: Any, closed: list[ProcessLink]
) -> tuple[ProcessLink, int]:
    """Fork the process from which the machines run from the beginning; `closed` are not its own.

    `arguments` are those of `Travel`. Return a link to it, and its id.
    """
    ours, theirs = ProcessLink.pair()
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
        jump, then, known, link = _wait_at(theirs)
        TravelHost(link, serve).run(jump, then, known, *arguments)
    except LinkClosedError:
        os._exit(0)
    except Exception:
        sys.excepthook(*sys.exc_info())
    finally:  # whatever happens: what has called this goes on in another process
        os._exit(_CODE_OF_FAILED)


def _wait_at(link: ProcessLink) -> tuple[Jump, Asked, list[int], ProcessLink]:
    """Wait in a process that is kept; return in each process forked from it."""
    signal.signal(signal.SIGIO, signal.SIG_IGN)
    while True:
        try:
            (jump, then, known), own = link.receive()
        except LinkClosedError:
            os._exit(0)
        assert own is not None
        try:
            is_new = _forked()
        except OSError:  # whom it serves finds that there is no answer
            is_new = False
        if is_new:
            link.close()
            return jump, then, known, own
        own.close()


def _forked() -> bool:
    """Fork a process that is no child of this one; return whether this is the new one."""
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
    while os.getppid() == between:  # until then whom it serves cannot wait for its end
        time.sleep(_YIELD_S)  # nothing signals that a process has a new parent
    return True


def _notify(link: ProcessLink, notice: Callable[..., None]) -> None:
    """Call `notice` whenever something comes over a link, also that it is closed."""
    import fcntl  # which Windows lacks

    signal.signal(signal.SIGIO, notice)
    fcntl.fcntl(link.fileno(), fcntl.F_SETOWN, os.getpid())
    flags = fcntl.fcntl(link.fileno(), fcntl.F_GETFL)
    fcntl.fcntl(link.fileno(), fcntl.F_SETFL, flags | os.O_ASYNC)


def _sendable(error: Exception) -> Exception:
    """Return an error, or one with its text if it cannot be made again from its arguments."""
    with suppress(Exception):
        if str(pickle.loads(pickle.dumps(error))) == str(error):
            return error
    return RecordingError(str(error))
