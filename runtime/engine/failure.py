"""Turn a failure of a machine's code into an error with its place."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from llfsm.runtime.engine.errors import ExecutionError, GuardResultError, ObserverError

if TYPE_CHECKING:
    from logging import Logger

    from llfsm.runtime.engine.seat import BoundState, Seat


_LONGEST = 300  # characters of an error in a status

_RUNTIME = os.path.dirname(os.path.dirname(__file__))


def logger() -> Logger:
    """Return the runtime's logger, importing logging only when there is something to log."""
    import logging

    return logging.getLogger("llfsm.runtime")


def one_line(error: BaseException) -> str:
    """Return an error's message in one line, and not too long a one; UTF-8 can be made of it."""
    line = " ".join(str(error).split()).encode(errors="backslashreplace").decode()
    if len(line) <= _LONGEST:
        return line
    half = _LONGEST // 2
    return f"{line[:half]} … {line[-half:]}"  # the place in the code comes last


def explain(seat: Seat, state: BoundState, code: object, error: BaseException) -> BaseException:
    """Describe the `error` that `code` raised in a ringlet of `seat` that began in `state`.

    One that is no failure of the code, or is described already, is returned as it is.
    """
    failed = isinstance(error, Exception) or (
        isinstance(error, SystemExit | KeyboardInterrupt) and seat.arrangement.contains_exits
    )
    if not failed or isinstance(error, ExecutionError | ObserverError):
        return error
    where, step = place_of(seat, state, code)
    filename, line = None, None
    trace = error.__traceback__
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if not file.startswith(_RUNTIME):
            filename, line = file, trace.tb_lineno
            break
        trace = trace.tb_next
    what = f"{type(error).__name__}: {_text(str, error)}"
    explained = ExecutionError(what, seat.name, where, step, filename, line)
    explained.__cause__ = error
    return explained


def not_a_bool(seat: Seat, state: BoundState, guard: object, value: object) -> GuardResultError:
    """Describe the `value`, neither True nor False, that `guard` returned."""
    where, step = place_of(seat, state, guard)
    number = next(i for i, (_, bound, _) in enumerate(state.transitions) if bound is guard)
    filename, line = seat.declared(state).transitions[number].location
    what = f"the guard returned {_text(repr, value)}, a {type(value).__name__}; "
    what += "it must return True or False"
    return GuardResultError(what, seat.name, where, step, filename, line)


def _text(describe: Callable[[object], str], value: object) -> str:
    try:
        return describe(value)
    except Exception as error:  # of a class of the machine's own
        return f"({type(error).__name__} while it was described)"


def place_of(seat: Seat, state: BoundState, code: object) -> tuple[str, str]:
    """Return the state and the section or transition that `code` is.

    The ringlet keeps no record of its steps, for speed, so look for the function; one that
    serves in several places of one state gives them all.
    """
    if code is None:
        return state.name, "the snapshot"
    steps = list(_steps(seat, state, code))
    if steps:
        return state.name, " or ".join(steps)
    for other in seat.states.values():  # only these run in the turn of another state
        if other.on_suspend is code:
            return other.name, "OnSuspend"
        if other.on_resume is code:
            return other.name, "OnResume"
    return state.name, "a section"


def _steps(seat: Seat, state: BoundState, code: object) -> Iterator[str]:
    if state.on_entry is code:
        yield "OnEntry"
    if state.on_exit is code:
        yield "OnExit"
    if state.internal is code:
        yield "Internal"
    if state.on_resume is code:
        yield "OnResume"
    for number, (_, guard, _) in enumerate(state.transitions):
        if guard is code:
            yield f"transition {seat.declared(state).transitions[number].label}"
