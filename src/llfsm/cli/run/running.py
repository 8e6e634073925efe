"""The arrangement of ``llfsm run``: loaded with what reports of it, and run to its end.

What `breakpoint()` in machines' code does: Python's debugger holds all of a process up.

``llfsm run -n``: start again after a crash, as clfsm does.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NamedTuple, NoReturn

import click

from llfsm.cli.console import SIGNALS, ending_once
from llfsm.cli.machine_names import with_called_bundles
from llfsm.cli.run.arguments import ResolvedPlan
from llfsm.cli.run.report import (
    StateReport,
    SuspensionReport,
    conditions,
    latency_drawing,
    timing_table,
)
from llfsm.runtime.debugging.debugger import Debugger
from llfsm.runtime.debugging.obeying import LEASE_S
from llfsm.runtime.engine.arrangement import Arrangement
from llfsm.runtime.engine.environment import Environment
from llfsm.runtime.engine.events import Reason
from llfsm.runtime.engine.watchdog import running_call
from llfsm.runtime.plans import Plan, assemble

_log = logging.getLogger(__name__)


@contextmanager
def pausing_at_breakpoints(arrangement: Arrangement) -> Iterator[None]:
    """Let `breakpoint()` open Python's debugger in a terminal, and say what that does.

    Without a terminal it pauses the machines before the next turn.
    """

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
    """Return where code calls `breakpoint()`."""
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
        if asked or status == 0:
            sys.exit(0 if -status in (0, *_SIGNALS) else 1)
        os.close(pipe)
        how = f"was killed by {signal.Signals(-status).name}" if status < 0 else "failed"
        click.echo(f"the arrangement {how}; it starts again", err=True)
        until = time.monotonic() + _PAUSE_S
        while time.monotonic() < until and not asked:
            time.sleep(_LOOK_S)


def _be_child(run: Callable[[], None], stop: Callable[[str], None], pipe: int) -> NoReturn:
    """Run, print an error, and exit without the cleanup that the parent does at its own end."""

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
    except Exception as error:
        if click.get_current_context().find_root().params["debug"]:
            traceback.print_exc()
        else:
            click.echo(f"Error: {error}", err=True)
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else int(error.code is not None)
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:  # even if the output is closed: the code after `run_nonstop` is the parent's
            os._exit(status)


class Reports(NamedTuple):
    """What is printed of machines: the options ``-v`` (how often), ``-s`` and ``-t``."""

    verbose: int
    suspensions: bool
    timed: bool


def load_machines(
    resolved: ResolvedPlan, plan: Plan, reports: Reports, environment: Environment
) -> Arrangement:
    """Return the arrangement of a plan, with its breakpoints; `resolved` has its classes."""
    arrangement = assemble(
        plan, resolved.classes, environment, library=resolved.library, timed=reports.timed
    )
    if plan.on_pause != "keep" or plan.breakpoints:
        debugger = Debugger(arrangement, on_pause=plan.on_pause, lease_s=LEASE_S)
        library = with_called_bundles(resolved.classes) if plan.breakpoints else {}
        debugger.break_at(*plan.breakpoints, library=library)
    if reports.verbose:
        with_path = reports.verbose > 1
        arrangement.attach(StateReport(arrangement, with_path=with_path, with_times=reports.timed))
    if reports.suspensions:
        arrangement.attach(SuspensionReport(arrangement))
    return arrangement


def run_machines(arrangement: Arrangement, *, timed: bool) -> None:
    """Run it to its end, and print its times if it is timed; raise what `run` raises.

    Raise `click.ClickException` if machines have failed that nobody can resume.
    """

    def is_ending() -> bool:
        return arrangement.reason is not None or arrangement.stop_cause in SIGNALS

    def is_in_a_section() -> bool:  # elsewhere it ends by itself, or has locks
        return running_call(threading.get_ident()) is not None

    try:
        with pausing_at_breakpoints(arrangement):
            ending_once(arrangement.run, is_ending, is_in_a_section)
    finally:
        if timed:
            found = arrangement.statistics()
            if found:
                texts = (timing_table(found), conditions(found), latency_drawing(found))
                click.echo("\n".join(filter(None, texts)), err=True)
    if arrangement.reason is Reason.FAILED:
        failed = ", ".join(arrangement.roster.failed)
        raise click.ClickException(
            f"{failed} failed, and no other process can resume it: the run has ended"
        )
