"""``llfsm run -n``: start again after a crash, as clfsm does."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import NoReturn

import click

__all__ = ["run_nonstop"]

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
