"""The ringlet: one turn of one machine. The numbers are those of the execution semantics."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from llfsm.runtime.engine.events import Turn
from llfsm.runtime.engine.failure import explain, not_a_bool

if TYPE_CHECKING:
    from llfsm.runtime.engine.seat import Seat


def ringlet(seat: Seat) -> bool:
    """Run one turn of the machine in `seat` and return whether a transition fired.

    1. Apply the pending request. 2. Take the snapshot. 3. Notify the states of suspension.
    4. Enter. 5. Evaluate the transitions in order; the first true one fires. 6. If none
    does, run Internal. An exception becomes an `ExecutionError`: `code` is always what is running.
    """
    if seat.request is not None:  # 1
        seat.perform_request()
    machine, state = seat.machine, seat.current
    code: Callable[[Any], object] | None = None
    try:
        for name, read, default in seat.sensors:  # 2
            value = read()
            setattr(machine, name, default if value is None else value)
        previous = seat.previous
        if state is not previous:
            seat.previous, seat.source = state, previous
            if not seat.notifies:  # 3
                pass
            elif state is seat.suspension:
                if previous is not None and (code := previous.on_suspend) is not None:
                    code(machine)
            elif previous is seat.suspension:
                if (code := previous.on_resume) is not None:
                    code(machine)
                if (code := state.on_resume) is not None:
                    code(machine)
            now = seat.now  # 4; a plain call: seat.now() would look for a method first
            seat.entered_ns = now()
            if (code := state.on_entry) is not None:
                code(machine)
        for limit_ns, code, target in state.transitions:  # 5
            if limit_ns is not None:
                now = seat.now
                if now() - seat.entered_ns <= limit_ns:
                    continue
            if code is not None:
                value = code(machine)
                if value is False:
                    continue
                if value is not True:
                    raise not_a_bool(seat, state, code, value)
            seat.current = target
            if (code := state.on_exit) is not None:
                code(machine)
            return True
        if (code := state.internal) is not None:  # 6
            code(machine)
        return False
    except BaseException as error:
        raise explain(seat, state, code, error)  # noqa: B904  # which knows the cause


def observed_ringlet(seat: Seat) -> bool:
    """Report to the observers that a turn begins, and run it."""
    previous = None if seat.previous is None else seat.previous.name
    where, arrangement = seat.current.name, seat.arrangement
    arrangement.emit(
        Turn(*arrangement.stamp(), seat.index, seat.name, where, previous, seat.request)
    )
    return ringlet(seat)
