"""Python's debugger in one section of a state, from its first line to its return."""

from __future__ import annotations

import pdb
import sys
from types import CodeType, FrameType
from typing import Any


class SectionPdb(pdb.Pdb):
    """A pdb that opens when the next call of some code begins, and closes when that returns.

    To quit it is to continue: the machine is not to fail because somebody has looked at it.
    """

    def __init__(self, **options: Any):
        super().__init__(nosigint=True, **options)  # Ctrl-C is for the prompt
        self._section: FrameType | None = None

    def open_at(self, code: CodeType) -> None:
        """Open when this thread calls `code` next."""
        self.reset()

        def wait_for(frame: FrameType, event: str, _: object) -> Any:
            if event != "call" or frame.f_code is not code:
                return None
            self._section, self.botframe = frame, frame.f_back
            self.set_step()
            sys.settrace(self.trace_dispatch)
            return self.trace_dispatch

        sys.settrace(wait_for)

    def user_call(self, frame: FrameType, argument_list: None) -> None:
        """Let the user look at a call, unless the section has returned."""
        if self._is_inside(frame):
            super().user_call(frame, argument_list)

    def user_line(self, frame: FrameType) -> None:
        """Let the user look at a line, unless the section has returned."""
        if self._is_inside(frame):
            super().user_line(frame)

    def _is_inside(self, frame: FrameType) -> bool:
        outer: FrameType | None = frame
        while outer is not None and outer is not self._section:
            outer = outer.f_back
        if outer is None:
            self.set_continue()
        return outer is not None

    def do_quit(self, arg: str) -> bool | None:
        """Leave this debugger, and let the section go on."""
        return self.do_continue(arg)

    do_q = do_exit = do_quit

    def do_EOF(self, arg: str) -> bool | None:  # noqa: N802  # pdb's name for Ctrl-D
        """Leave this debugger, and let the section go on."""
        self.message("")
        return self.do_continue(arg)
