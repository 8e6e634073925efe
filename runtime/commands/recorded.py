"""What ``llfsm run --record`` does: a recorder as a process beside this one.

Machines share neither a core nor a fate with it: they hand their journal over in a pipe, which
never makes them wait. If the recorder dies they go on; if they are killed it completes its file.
"""

from __future__ import annotations

import fcntl
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Self

import click

from ..arrangement import Arrangement
from ..failure import logger
from ..journal import Journal
from ..journalled import JournalledArrangement
from ..plan import Plan

__all__ = ["recorded"]

_PIPE = 1 << 20  # bytes that the system keeps for the recorder
_MOST = 64 << 20  # bytes that we keep, too, before the recorder counts as stuck
_PATIENCE_S = 5.0  # for the rest to be taken and the file to be completed


@contextmanager
def recorded(file: Path | None, board: str, plan: Plan) -> Iterator[Callable[..., Arrangement]]:
    """Give what makes an arrangement that is recorded in `file`; without one, just an arrangement.

    Raise ``click.ClickException`` if the recorder does not start, which says why by itself.
    """
    if file is None:
        yield Arrangement
        return
    with _Recorder(file, board) as recorder:
        recorder.journal.add(("Plan", plan, str(Path.cwd())))
        yield partial(JournalledArrangement, journal=recorder.journal)


class _Recorder:
    """Have a board and a `journal` recorded in a file; leaving the ``with`` block ends that."""

    def __init__(self, file: Path, board: str):
        taken, self._pipe = os.pipe()
        os.set_blocking(self._pipe, False)
        fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _PIPE)
        self._left = bytearray()
        self._works = True
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", "llfsm.runtime", "record"),
                *("-o", str(file), "-b", board, "--events", str(taken)),
            ],
            stdout=subprocess.PIPE,
            pass_fds=[taken],
            start_new_session=True,  # a Ctrl-C is for the machines, whose last events it must see
        )
        os.close(taken)
        assert self._process.stdout is not None
        with self._process.stdout as said:
            if not said.readline():
                self._close(time.monotonic() + _PATIENCE_S)
                raise click.ClickException("the recorder did not start, nothing was run")
        self.journal = Journal(self._write)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.journal.flush()
        until = time.monotonic() + _PATIENCE_S
        while self._works and self._left and time.monotonic() < until:
            select.select([], [self._pipe], [], 0.1)
            self._write_left()
        self._close(until)

    def _write(self, data: bytes) -> None:
        if self._works:
            self._left += len(data).to_bytes(4, "little") + data
            self._write_left()

    def _write_left(self) -> None:
        try:
            del self._left[: os.write(self._pipe, self._left)]
        except BlockingIOError:
            if len(self._left) > _MOST:
                self._give_up("has stood still for too long")
        except OSError as error:
            self._give_up(f"is gone ({error.strerror})")

    def _give_up(self, why: str) -> None:
        self._works = False
        self._left.clear()
        logger().warning("the recorder %s: the machines go on unrecorded", why)

    def _close(self, until: float) -> None:
        os.close(self._pipe)
        try:
            self._process.wait(max(0.1, until - time.monotonic()))
        except subprocess.TimeoutExpired:
            self._process.kill()  # what it has written can be read
            self._process.wait()
