"""The arrangement of ``llfsm run``: loaded, reported in clfsm's format, and run to its end.

* ``-v``, ``-s`` and ``-t`` are observers and a table of times; they write to standard error, which
  scripts for clfsm read.
* A call of `breakpoint()` in a machine's code opens Python's debugger in a terminal, which holds
  all of the process up. Without a terminal nobody could answer it, so it pauses the machines.
* ``-n`` starts them again after a crash, as clfsm does. They run in a fork, so that each run begins
  with the machines as they were loaded, and this process survives whatever ends the other.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import NamedTuple, NoReturn

import click

from llfsm.cli.console import SIGNALS, ending_once
from llfsm.cli.echo import echo
from llfsm.cli.machines import ResolvedPlan
from llfsm.cli.options import BoardRemovedError
from llfsm.runtime.debugging.breakpoints import callable_machines
from llfsm.runtime.debugging.debugger import Debugger
from llfsm.runtime.debugging.leases import LEASE_S
from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.events import Event, Reason, Request, Turn
from llfsm.runtime.engine.kernel import BOARD_GONE
from llfsm.runtime.engine.statistics import MachineStatistics, Spread
from llfsm.runtime.engine.watchdog import running_call
from llfsm.runtime.keeping import keep_in

_log = logging.getLogger(__name__)
_HEADS = ("machine", "ringlets", "fired", "cost us", "jitter us", "late us", "overruns", "worst us")


class StateReport:
    """Print each change of state as clfsm does, ``m  0 s  1 - Machine - STATE``, or timed."""

    def __init__(self, arrangement: Arrangement, *, with_path: bool, with_times: bool) -> None:
        self._arrangement = arrangement
        self._with_path = with_path
        self._with_times = with_times
        self._begin_ns: int | None = None

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, Turn) and event.previous != event.state:
            table = type(self._arrangement.machine(event.machine)).table
            names = [state.name for state in table.states]
            # A suspend state that the machine does not declare comes after those it does.
            number = names.index(event.state) if event.state in names else len(names)
            path = f"{table.path:<30.30} / " if self._with_path else ""
            if self._begin_ns is None:
                self._begin_ns = event.time_ns
            seconds = (event.time_ns - self._begin_ns) / 1e9
            time = f"{seconds:10.6f} " if self._with_times else ""
            change = f"m{event.index:3d} s{number:3d} - {path}{event.machine:<20.20}"
            echo(f"{time}{change} - {event.state}", err=True)


class SuspensionReport:
    """Print each suspend, resume and restart when it takes effect."""

    def __init__(self, arrangement: Arrangement) -> None:
        self._arrangement = arrangement
        self._due: Turn | None = None

    def __call__(self, event: Event) -> None:
        """Take an event: the one after a turn with a request shows the effect of the request."""
        due, self._due = self._due, None
        if due is not None:  # the request has been applied, and no transition has fired since
            state = self._arrangement.state_name_of(due.machine)
            if state != due.state or due.request == Request.RESTART:
                request = str(due.request).title()
                echo(f"{request} {due.index}: {due.state} -> {state}", err=True)
        if isinstance(event, Turn) and event.request is not None:
            self._due = event


def timing_table(machines: Iterable[MachineStatistics]) -> str:
    """Return a table of spreads, p50 / p99 / max in us, and of the seconds in each state."""
    rows = [_HEADS]
    notes: list[list[str]] = [[]]
    for machine in machines:
        planned = machine.jitter_us is not None
        rows.append(
            (
                machine.machine,
                str(machine.ringlets),
                str(machine.fired),
                _spread(machine.cost_us),
                _spread(machine.jitter_us),
                _spread(machine.late_us),
                str(machine.overruns) if planned else "-",
                f"{machine.worst_overrun_us:.0f}" if planned else "-",
            )
        )
        total = sum(machine.state_s.values()) or 1.0
        width = max((len(state) for state in machine.state_s), default=0)
        notes.append(
            [
                f"    {state.ljust(width)} {seconds:10.3f} s {seconds / total:6.1%}"
                for state, seconds in machine.state_s.items()
            ]
        )
        if machine.passed_over:
            notes[-1].append(f"    {machine.passed_over} ringlets could change nothing: not run")
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row, states in zip(rows, notes, strict=True):
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines += ["  ".join(cells), *states]
    return "\n".join(lines)


def conditions(machines: Iterable[MachineStatistics]) -> str:
    """Describe the real time in which turns were given, "" without; all machines share one."""
    for machine in machines:
        if machine.realtime is not None:
            core = "" if machine.cpu is None else f" on core {machine.cpu}"
            return f"in real time: FIFO {machine.realtime}{core}, memory locked"
    return ""


def latency_drawing(machines: Iterable[MachineStatistics]) -> str:
    """Draw how late turns began: a bar for each doubling of microseconds."""
    by_counts: dict[tuple[int, ...], list[str]] = {}
    for machine in machines:
        if machine.late_counts:
            by_counts.setdefault(machine.late_counts, []).append(machine.machine)
    lines: list[str] = []
    for counts, names in by_counts.items():  # with a period, the turns of all begin with one
        lines.append(f"turns of {', '.join(names)} that began late")
        first = next(place for place, count in enumerate(counts) if count)
        for place, count in enumerate(counts[first:], first):
            bar = "#" * -(-count * 40 // max(counts))
            lines.append(f"{'<':>5} {2**place:>8} us {count:>9}  {bar}".rstrip())
    return "\n".join(lines)


def _spread(spread: Spread | None) -> str:
    return "-" if spread is None else f"{spread.p50:.1f} / {spread.p99:.1f} / {spread.max:.1f}"


class Reports(NamedTuple):
    """The options that print, by their names: ``-v`` (how often it is given), ``-s``, ``-t``."""

    verbose: int
    report: bool
    timed: bool


def load_machines(
    resolved: ResolvedPlan, reports: Reports, environment: Environment
) -> Arrangement:
    """Load the machines of a plan, with breakpoints and reports."""
    plan = resolved.plan
    arrangement = resolved.assemble(environment, timed=reports.timed)
    if plan.on_pause != "keep" or plan.breakpoints:
        debugger = Debugger(arrangement, on_pause=plan.on_pause, lease_s=LEASE_S)
        library = callable_machines(resolved.classes) if plan.breakpoints else {}
        debugger.break_at(*plan.breakpoints, library=library)
    if reports.verbose:
        with_path = reports.verbose > 1
        arrangement.attach(StateReport(arrangement, with_path=with_path, with_times=reports.timed))
    if reports.report:
        arrangement.attach(SuspensionReport(arrangement))
    return arrangement


def run_machines(
    arrangement: Arrangement, *, timed: bool, kept: Path | None = None, quiet: bool = False
) -> None:
    """Run an arrangement to its end, and print its times if it is timed.

    Go on where the file `kept` has its machines, and keep them there; say so unless `quiet`.
    """

    def is_ending() -> bool:
        return arrangement.reason is not None or arrangement.stop_cause in SIGNALS

    def is_in_a_section() -> bool:  # elsewhere it ends by itself, or has locks
        return running_call(threading.get_ident()) is not None

    try:
        with ExitStack() as stack:
            stack.enter_context(pausing_at_breakpoints(arrangement))
            goes_on = kept is not None and stack.enter_context(keep_in(kept, arrangement))
            if goes_on and not quiet:
                echo(f"goes on where {kept} has the machines", err=True)
            ending_once(arrangement.run, is_ending, is_in_a_section)
    finally:
        if timed:
            found = arrangement.statistics()
            if found:
                texts = (timing_table(found), conditions(found), latency_drawing(found))
                echo("\n".join(filter(None, texts)), err=True)
    board = arrangement.environment.whiteboard
    if arrangement.stop_cause == BOARD_GONE and board is not None:
        raise BoardRemovedError(board.name)
    if arrangement.reason is Reason.FAILED:
        failed = ", ".join(arrangement.roster.failed)
        raise click.ClickException(
            f"{failed} failed, and no other process can resume it: the run has ended"
        )


@contextmanager
def pausing_at_breakpoints(arrangement: Arrangement) -> Iterator[None]:
    """Let `breakpoint()` open Python's debugger, or without a terminal pause the machines."""

    def pause(*given: object, **options: object) -> object:
        frame = sys._getframe(1)
        where = place_of_call(frame)
        if not sys.stdin.isatty() and "PYTHONBREAKPOINT" not in os.environ:
            Debugger.of(arrangement).pause(where, lease_s=LEASE_S)
            return None
        _log.warning("%s: no machine of this process has a turn before it ends", where)
        if "PYTHONBREAKPOINT" in os.environ:
            return sys.__breakpointhook__(*given, **options)
        from pdb import Pdb  # here, as few machines' code calls it

        Pdb().set_trace(frame)
        return None

    before, sys.breakpointhook = sys.breakpointhook, pause
    try:
        yield
    finally:
        sys.breakpointhook = before


def place_of_call(frame: FrameType) -> str:
    """Return the cause of a pause by code that calls `breakpoint()`: with its file and line."""
    return f"breakpoint() in {os.path.basename(frame.f_code.co_filename)}:{frame.f_lineno}"


_PAUSE_S = 1.0  # as clfsm waits; a machine that crashes at once must not keep a core busy
_LOOK_S = 0.02  # a signal need not interrupt a wait: Python resumes it, or another thread has it
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def run_nonstop(run: Callable[[], None], stop: Callable[[str], None]) -> None:
    """Call `run` in a forked process, again and again until it ends without a failure.

    The fork has the state of this process, so each run starts with the machines as loaded. The
    first SIGINT or SIGTERM calls `stop` in the fork, as does the end of this process; the next
    signal is passed on. (A terminal's Ctrl-C reaches both processes; the fork gets it only once.)
    """
    child, pipe, asked = 0, -1, 0

    def on_signal(number: int, _: FrameType | None) -> None:
        nonlocal asked
        asked += 1
        if child and asked == 1:
            os.close(pipe)
        elif child:
            with suppress(ProcessLookupError):  # it has ended, as waitpid is about to return
                os.kill(child, number)

    before = {number: signal.signal(number, on_signal) for number in _SIGNALS}
    while not asked:
        sys.stdout.flush()  # or the child would print it again
        sys.stderr.flush()
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)  # until both processes can handle them
        if asked:
            break
        end, pipe = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(pipe)
            for number, handler in before.items():
                signal.signal(number, handler)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
            _be_child(run, stop, end)
        os.close(end)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
        while not (ended := os.waitpid(child, os.WNOHANG))[0]:
            time.sleep(_LOOK_S)
        status = os.waitstatus_to_exitcode(ended[1])
        child = 0
        if asked or status in (0, BoardRemovedError.exit_code):
            sys.exit(0 if -status in (0, *_SIGNALS) else max(status, 1))
        os.close(pipe)
        how = f"was killed by {signal.Signals(-status).name}" if status < 0 else "failed"
        echo(f"the arrangement {how}; it starts again", err=True)
        until = time.monotonic() + _PAUSE_S
        while time.monotonic() < until and not asked:
            time.sleep(_LOOK_S)


def _be_child(run: Callable[[], None], stop: Callable[[str], None], pipe: int) -> NoReturn:
    """Run in the fork, print an error, and exit without the cleanup that is the parent's."""

    def wait() -> None:
        os.read(pipe, 1)  # which is never written to
        stop("an end was requested, or the supervisor has died")

    threading.Thread(target=wait, name="supervisor", daemon=True).start()
    status = 1
    try:
        run()
        status = 0
    except KeyboardInterrupt:
        status = 0
    except BoardRemovedError as error:
        echo(f"Error: {error.message}", err=True)
        status = error.exit_code
    except Exception as error:
        if click.get_current_context().find_root().params["debug"]:
            traceback.print_exc()
        else:
            echo(f"Error: {error}", err=True)
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else int(error.code is not None)
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:  # even if the output is closed: the code after `run_nonstop` is the parent's
            os._exit(status)
