"""What `breakpoint()` in machines' code does: Python's debugger holds all of a process up."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

from llfsm.runtime.debugging.debugger import Debugger
from llfsm.runtime.debugging.obeying import LEASE_S

if TYPE_CHECKING:
    from llfsm.runtime.engine.arrangement import Arrangement

__all__ = ["pausing_at_breakpoints", "place_of_call"]

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
