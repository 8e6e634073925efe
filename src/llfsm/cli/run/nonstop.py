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
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def run_nonstop(run: Callable[[], None], stop: Callable[[str], None]) -> None:
    """Call `run` in a forked process, again and again until it ends without a failure.

    The fork has everything as it is now, so that each run starts with machines as they were
    loaded. The first SIGINT or SIGTERM has `stop` called there, as does the end of this process;
    the next is handed on. (A terminal's Ctrl-C reaches both: nobody gets it twice.)
    """
    child, pipe, asked = 0, -1, 0

    def on_signal(number: int, _: FrameType | None) -> None:
        nonlocal asked
        asked += 1
        if child and asked == 1:
            os.close(pipe)
        elif child:
            with suppress(ProcessLookupError):  # it has ended, which is about to be noticed
                os.kill(child, number)

    before = {number: signal.signal(number, on_signal) for number in _SIGNALS}
    while not asked:
        sys.stdout.flush()  # or the child would say it again
        sys.stderr.flush()
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)  # until they reach whom they are for
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
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        child = 0
        if asked or status == 0:
            sys.exit(0 if -status in (0, *_SIGNALS) else 1)
        os.close(pipe)
        how = f"was killed by {signal.Signals(-status).name}" if status < 0 else "failed"
        click.echo(f"the arrangement {how}; it starts again", err=True)
        until = time.monotonic() + _PAUSE_S
        while time.monotonic() < until and not asked:
            time.sleep(0.02)  # Python goes on sleeping after a signal: look whether one came


def _be_child(run: Callable[[], None], stop: Callable[[str], None], pipe: int) -> NoReturn:
    """Run, say what went wrong, and leave without what the parent will do at its own end."""

    def wait() -> None:
        os.read(pipe, 1)  # which is never written to
        stop("an end was asked for, or the supervisor has died")

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
        finally:  # also if nobody listens: what comes after `run_nonstop` is up to the parent
            os._exit(status)
