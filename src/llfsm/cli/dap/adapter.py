"""``llfsm dap``: the adapter between an editor and a session, by the Debug Adapter Protocol.

An arrangement is one thread of the protocol. One thread of ours reads requests and answers them;
another waits for pauses, which a breakpoint or another process may cause at any time, and notifies
the editor. The events of a request are sent after its response, as editors expect: see `_follow`.
https://microsoft.github.io/debug-adapter-protocol/specification
"""

from __future__ import annotations

import io
import logging
import os
import re
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, redirect_stdout, suppress
from typing import TYPE_CHECKING, Any, Final

import click

from llfsm.cli.dap.framing import Message, MessageStream
from llfsm.cli.dap.inspection import Inspection, breakpoints_at
from llfsm.cli.debug.session import Session, clock_of
from llfsm.cli.machines import parse_arguments
from llfsm.cli.run.running import place_of_call
from llfsm.cli.run.world import recorded
from llfsm.errors import LlfsmError, one_line
from llfsm.whiteboard import Whiteboard
from llfsm.whiteboard.board_files import default_name

if TYPE_CHECKING:
    from llfsm.runtime.debugging.debugger import Debugger, Step


_THREAD: Final = 1
_LOOK_S: Final = 0.02  # between two looks whether a pause is over
_FAILURES: Final = "failures"
_STEPS: Final[dict[str, Step]] = {"next": "turn", "stepIn": "round", "stepOut": "transition"}
_REASONS: Final = {
    "start": "entry",
    "breakpoint": "breakpoint",
    "breakpoint()": "breakpoint",
    "step": "step",
}
_ASIDE: Final = frozenset({"evaluate", "scopes", "stackTrace", "threads", "variables"})
"""Requests of an editor on its own, as for a word under the mouse: no error of theirs pops up."""
_CAPABILITIES: Final = {
    "supportsConfigurationDoneRequest": True,
    "supportsConditionalBreakpoints": True,
    "supportsHitConditionalBreakpoints": True,
    "supportsFunctionBreakpoints": True,
    "supportsEvaluateForHovers": True,
    "supportsTerminateRequest": True,
    "exceptionBreakpointFilters": [
        {"filter": _FAILURES, "label": "Failures of machines", "default": True}
    ],
}


class Adapter:
    """Serve one editor until it disconnects."""

    def __init__(self, stream: MessageStream):
        self._stream = stream
        self._stack = ExitStack()
        self._session: Session | None = None
        self._stops_on_entry = self._has_breakpoints = True
        self._watcher: threading.Thread | None = None
        self._over = self._is_finished = False
        self._lines: dict[str, list[str]] = {}  # breakpoints by file
        self._planned: tuple[str, ...] = ()  # those of an arrangement file
        self._functions: list[str] = []
        self._failures: list[str] = []
        self._inspection: Inspection | None = None  # of this pause
        self._is_resumed = threading.Event()  # by the editor, since the last pause
        self._handlers: dict[str, Callable[[Message], Message | None]] = {
            "initialize": self._initialize,
            "launch": self._launch,
            "setBreakpoints": self._set_breakpoints,
            "setFunctionBreakpoints": self._set_function_breakpoints,
            "setExceptionBreakpoints": self._set_exception_breakpoints,
            "configurationDone": self._start,
            "threads": lambda arguments: {"threads": [{"id": _THREAD, "name": "arrangement"}]},
            "stackTrace": lambda arguments: self._inspect().stack_trace(arguments),
            "scopes": lambda arguments: self._inspect().scopes(arguments),
            "variables": lambda arguments: self._inspect().variables(arguments),
            "evaluate": lambda arguments: self._inspect().evaluate(arguments),
            "pause": self._require_machines,
            "terminate": self._require_machines,
            "disconnect": self._end,
            **dict.fromkeys(("continue", *_STEPS), self._resume),
        }

    def serve(self) -> None:
        """Answer requests until the editor disconnects, or is gone; raise as `receive` does."""
        with self._stack:
            self._stack.callback(self._watch_end)
            while not self._over and (request := self._stream.receive()) is not None:
                if request.get("type") == "request":
                    self._answer(request)
        if self._session is not None:
            self._finish(self._session)

    def print(self, category: str, text: str) -> None:
        """Show the editor what was printed."""
        self._event("output", category=category, output=text)

    def break_in_code(self, *given: object, **options: object) -> None:
        """Pause before the next turn: a machine's code calls `breakpoint()`."""
        if self._has_breakpoints and self._session is not None:
            self._session.debugger.pause(place_of_call(sys._getframe(1)))

    def _answer(self, request: Message) -> None:
        command, arguments = str(request.get("command")), request.get("arguments") or {}
        about = {"request_seq": request.get("seq", 0), "command": command}
        try:
            handler = self._handlers.get(command)
            if handler is None:
                raise LlfsmError(f"this adapter has no request {command!r}")
            body = handler(arguments)
        except Exception as error:  # also of a request that is wrong, or of code of a machine
            is_ours = isinstance(error, LlfsmError | click.ClickException)
            text = str(error) if is_ours else f"{type(error).__name__}: {error}"
            self._stream.send(
                "response",
                **about,
                success=False,
                message=text,
                body={"error": {"id": 1, "format": text, "showUser": command not in _ASIDE}},
            )
            return
        self._stream.send("response", **about, success=True, body=body or {})
        self._follow(command)

    def _follow(self, command: str) -> None:
        """Carry out a request whose response has to come before the events that it causes."""
        if command in _STEPS:
            self._go_on(lambda debugger: debugger.step(_STEPS[command]))
        match command:
            case "launch":
                self._event("initialized")
            case "configurationDone":
                if not self._stops_on_entry:
                    self._go_on(lambda debugger: debugger.proceed())
                self._watcher = threading.Thread(target=self._watch, name="watcher")
                self._watcher.start()
            case "continue":
                self._go_on(lambda debugger: debugger.proceed())
            case "pause":
                self._launched.debugger.pause()
            case "terminate" if self._watcher is None:
                self._finish(self._launched)
            case "terminate":
                self._go_on(lambda _: self._launched.arrangement.stop("the editor has ended it"))

    def _event(self, event: str, **body: Any) -> None:
        self._stream.send("event", event=event, body=body)

    def _initialize(self, arguments: Message) -> Message:
        if not arguments.get("linesStartAt1", True) or arguments.get("pathFormat") == "uri":
            raise LlfsmError("this adapter counts lines from 1, and takes paths, not URIs")
        return _CAPABILITIES

    # The machines

    def _launch(self, arguments: Message) -> None:
        given = arguments.get("machines")
        if given is None:
            given = [arguments["program"]] if "program" in arguments else []
        if self._session is not None or not isinstance(given, list):
            raise LlfsmError("launch one arrangement: `machines` is a list of them, or a file")
        folder = str(arguments.get("cwd") or ".")
        try:
            os.chdir(folder)
        except OSError as error:
            raise LlfsmError(f"`cwd`: {folder}: {error.strerror}") from error
        resolved = parse_arguments([str(each) for each in given])
        plan, board = resolved.plan, arguments.get("board")
        wb = self._stack.enter_context(Whiteboard(board or plan.board or default_name()))
        environment = self._stack.enter_context(recorded(None, wb, plan, clock_of(plan)))
        self._session = Session(resolved, environment)
        self._planned = plan.breakpoints
        self._has_breakpoints = not arguments.get("noDebug")
        self._stops_on_entry = bool(arguments.get("stopOnEntry")) and self._has_breakpoints
        self._break()

    @property
    def _launched(self) -> Session:
        if self._session is None:
            raise LlfsmError("no machines were launched yet")
        return self._session

    def _inspect(self) -> Inspection:
        """Return the inspection of this pause; raise `LlfsmError` while the machines run."""
        if not self._launched.debugger.paused or self._inspection is None:
            raise LlfsmError("the machines run: pause them first")
        return self._inspection

    def _start(self, arguments: Message) -> None:
        self._stack.enter_context(self._launched)
        self._launched.wait()

    def _require_machines(self, arguments: Message) -> None:
        assert self._launched

    def _end(self, arguments: Message) -> None:
        self._over = True

    def _resume(self, arguments: Message) -> Message:
        self._inspect()  # it is done once the editor has the response
        return {"allThreadsContinued": True}

    def _go_on(self, how: Callable[[Debugger], None]) -> None:
        self._inspection = None
        self._is_resumed.set()
        how(self._launched.debugger)

    def _watch(self) -> None:
        """Notify the editor of pauses, of ends of pauses that it has not requested, and of the end.

        Other processes pause, step and continue the machines, too.
        """
        session, debugger = self._launched, self._launched.debugger
        while why := session.wait():
            self._is_resumed.clear()
            self._inspection, number = Inspection(session), debugger.pauses
            self._stopped(why)
            while debugger.paused and debugger.pauses == number:
                time.sleep(_LOOK_S)  # nothing signals that others have continued them
            if not self._is_resumed.is_set():
                self._event("continued", threadId=_THREAD, allThreadsContinued=True)
        self._finish(session)

    def _watch_end(self) -> None:
        if self._watcher is not None:
            self._watcher.join()

    def _stopped(self, why: str) -> None:
        kind = why.partition(":")[0].partition(" ")[0]
        reason = _REASONS.get(kind, "pause")
        if self._failures and any(f"breakpoint {each}" in why for each in self._failures):
            reason = "exception"
        self._event(
            "stopped",
            reason=reason,
            description=why,
            text=why,
            threadId=_THREAD,
            allThreadsStopped=True,
        )

    def _finish(self, session: Session) -> None:
        """Notify the editor, once, that the machines have ended."""
        if self._is_finished:
            return
        self._is_finished = True
        if session.error is not None:
            self.print("stderr", f"{one_line(session.error)}\n")
        self._event("exited", exitCode=int(session.error is not None))
        self._event("terminated")

    # Breakpoints

    def _set_breakpoints(self, arguments: Message) -> Message:
        file = str(arguments.get("source", {}).get("path", ""))
        texts, answers = [], []
        machines = self._launched.library
        for wanted in arguments.get("breakpoints") or ():
            line = int(wanted.get("line", 0))
            places = breakpoints_at(machines, file, line)
            new = [place.breakpoint + _suffix(wanted) for place in places]
            answer: Message = {"verified": bool(new), "line": line, "message": ", ".join(new)}
            if places:
                answer["line"] = places[0].first if places[0].last < line else line
            else:
                answer["message"] = "no state, section or transition of these machines is here"
            problem = _refusal(wanted) or self._problem(new)
            if problem:
                answer |= {"verified": False, "message": problem}
            else:
                texts += new
            answers.append(answer)
        self._lines[os.path.realpath(file)] = texts
        self._break()
        return {"breakpoints": answers}

    def _set_function_breakpoints(self, arguments: Message) -> Message:
        self._functions, answers = [], []
        for wanted in arguments.get("breakpoints") or ():
            text = str(wanted.get("name", "")) + _suffix(wanted)
            problem = _refusal(wanted) or self._problem([text])
            if not problem:
                self._functions.append(text)
            answers.append({"verified": not problem, "message": problem or text})
        self._break()
        return {"breakpoints": answers}

    def _set_exception_breakpoints(self, arguments: Message) -> None:
        wanted = _FAILURES in (arguments.get("filters") or ())
        self._failures = [f"{machine}!" for machine in self._launched.library] if wanted else []
        self._break()

    def _problem(self, texts: list[str]) -> str:
        """Try breakpoints with those that are set; return the reason of a refusal, else ""."""
        try:
            self._launched.break_at(*self._launched.debugger.breakpoints, *texts)
        except LlfsmError as error:
            return str(error)
        return ""

    def _break(self) -> None:
        if not self._has_breakpoints:
            self._launched.break_at()
            return
        lines = [text for texts in self._lines.values() for text in texts]
        self._launched.break_at(
            *dict.fromkeys([*self._planned, *self._functions, *lines, *self._failures])
        )


def _refusal(wanted: Message) -> str:
    """Check the count of a breakpoint; return the message if it is wrong, else ""."""
    count = str(wanted.get("hitCondition") or "1")
    if re.fullmatch(r"[1-9]\d*", count):
        return ""
    return f"{count!r} is no count of hits: write the number of the first one to pause at, as 3"


def _suffix(wanted: Message) -> str:
    """Return the count and the condition of a breakpoint, as in its text."""
    count, condition = wanted.get("hitCondition"), wanted.get("condition")
    return (f"#{count}" if count else "") + (f" if {condition}" if condition else "")


@click.command()
def dap() -> None:
    """Let an editor debug machines, by the Debug Adapter Protocol on standard input and output.

    An editor starts this; how-to/debugging.md shows how to set it up.

    \b
    llfsm dap
    """
    # What code prints must not get among the messages, nor what it reads take any from them; and
    # neither what programs do that it starts.
    with (
        suppress(BrokenPipeError),
        os.fdopen(os.dup(0), "rb") as received,
        os.fdopen(os.dup(1), "wb") as sent,
        open(os.devnull) as nothing,
    ):
        os.dup2(nothing.fileno(), 0)
        os.dup2(2, 1)
        adapter = Adapter(MessageStream(received, sent))
        sys.stdin, sys.breakpointhook = nothing, adapter.break_in_code
        logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[_Log(adapter)])
        with redirect_stdout(_Printed(adapter)):
            adapter.serve()


class _Printed(io.TextIOBase):
    """Standard output, as an editor shows it."""

    def __init__(self, adapter: Adapter):
        self._adapter = adapter

    def write(self, text: str) -> int:
        """Show a text."""
        self._adapter.print("stdout", text)
        return len(text)


class _Log(logging.Handler):
    """A log whose records an editor shows."""

    def __init__(self, adapter: Adapter):
        super().__init__()
        self._adapter = adapter

    def emit(self, record: logging.LogRecord) -> None:
        """Show a record."""
        category = "stdout" if record.levelno < logging.WARNING else "stderr"
        self._adapter.print(category, f"{self.format(record)}\n")
