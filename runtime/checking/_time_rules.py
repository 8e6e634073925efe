"""The rules for time: code that waits inside a ringlet, and transitions that never come.

A machine has one ringlet a turn, and all machines wait for its end. So code that waits for what
only another ringlet can bring never ends, and a call that waits delays every machine. Of the
transitions of a state, one never fires if its times contradict each other, or if its guard is that
of one before it; and one that leads to its own state starts no time anew.
"""

from __future__ import annotations

import ast
import concurrent.futures
import os
import queue
import signal
import socket
import subprocess
import threading
import time
import urllib.request
from collections.abc import Iterator, Sequence
from math import inf
from typing import Any, Final

from llfsm.runtime.checking._subject import CheckedTransition, Finding, Piece, Subject
from llfsm.runtime.expressions.reads import CLOCK, Code, nodes_of
from llfsm.runtime.expressions.types import MISSING, Options

# Code that waits


def endless_loops(subject: Subject) -> Iterator[Finding]:
    """Find loops that nothing ends, or only what comes with another ringlet."""
    for code in subject.all_code():
        for node in nodes_of(code):
            match node:
                case ast.While(ast.Constant(value)) if value and not _can_end(node, _ENDS):
                    text = "this loop never ends: no machine has another turn"
                    yield Finding(code.file, node.lineno, "error", text)
                case ast.While(test) if not _can_end(node, _LEAVES):
                    yield from _waiting(subject, code, node, test)


_LEAVES: Final = (ast.Break, ast.Return, ast.Raise, ast.Assert, ast.Await, ast.Yield, ast.YieldFrom)
# What ends a loop, or may raise: a caller may wait for that.
_ENDS: Final = (*_LEAVES, ast.Call, ast.Subscript)


def _can_end(loop: ast.While, ends: tuple[type[ast.AST], ...]) -> bool:
    inside = {each for part in loop.body for each in ast.walk(part)}
    return any(isinstance(each, ends) for each in inside)


def _waiting(subject: Subject, code: Code, loop: ast.While, test: ast.expr) -> Iterator[Finding]:
    names = [each for each in ast.walk(test) if isinstance(each, ast.Name)]
    if any(each.id != code.machine for each in names):
        return  # something else may change
    read = {
        each.attr
        for each in ast.walk(test)
        if isinstance(each, ast.Attribute)
        and isinstance(each.value, ast.Name)
        and each.value.id == code.machine
    }
    if read and read <= {*CLOCK}:
        text = "this loop waits, and no machine has a turn: wait by a transition with after_ms"
        yield Finding(code.file, loop.lineno, "warning", text)
    elif read and read <= subject.sensors | {"stopping"}:
        text = f"this loop never ends: {min(read)!r} is the same until the next ringlet"
        yield Finding(code.file, loop.lineno, "error", text)


_SLEEPS: Final = "time.sleep delays all machines: wait by a transition with after_ms"
_FUNCTIONS: Final[Sequence[Any]] = (
    *(input, os.system, os.wait, os.waitpid, signal.pause, signal.sigwait),
    *(socket.create_connection, urllib.request.urlopen, concurrent.futures.wait),
    *(subprocess.run, subprocess.call, subprocess.check_call, subprocess.check_output),
)
_METHODS: Final[Sequence[tuple[type, frozenset[str]]]] = (
    (queue.Queue, frozenset({"get", "put", "join"})),
    (queue.SimpleQueue, frozenset({"get"})),
    (threading.Event, frozenset({"wait"})),
    (threading.Condition, frozenset({"wait", "wait_for"})),
    (threading.Barrier, frozenset({"wait"})),
    (threading.Thread, frozenset({"join"})),
    (subprocess.Popen, frozenset({"wait", "communicate"})),
    (socket.socket, frozenset({"accept", "connect", "recv", "recvfrom", "sendall"})),
    (concurrent.futures.Future, frozenset({"result", "exception"})),
)
_OF_PACKAGES: Final = {
    "requests": {"delete", "get", "head", "patch", "post", "put", "request"},
    "httpx": {"delete", "get", "head", "patch", "post", "put", "request"},
    "rclpy": {"spin", "spin_once", "spin_until_future_complete"},
}
_METHODS_OF_PACKAGES: Final = {
    ("serial", "Serial"): {"flush", "read", "read_until", "readline", "readlines"},
    ("requests", "Session"): {"delete", "get", "patch", "post", "put", "request"},
}
_WITHOUT: Final = frozenset({"block", "blocking", "timeout"})


def of_waiting(piece: Piece, node: ast.Call) -> Iterator[Finding]:
    """Find calls that return when something outside of the machines has happened."""
    function = piece.types.value_of(node.func)
    if function is time.sleep:
        yield piece.finding(node, "warning", _SLEEPS)
        return
    waits = any(function is each for each in _FUNCTIONS) or _is_of_a_package(function)
    if isinstance(node.func, ast.Attribute) and not waits:
        options = _made_or_known(piece, node.func.value)
        waits = bool(options) and all(_waits(each, node.func.attr) for each in options)
    given = [*node.args, *(each.value for each in node.keywords if each.arg in _WITHOUT)]
    at_once = any(isinstance(each, ast.Constant) and not each.value for each in given)
    if waits and not at_once:
        name = ast.unparse(node.func)
        text = f"{name} delays all machines until it returns: let another process do it"
        yield piece.finding(node, "warning", text)


def _made_or_known(piece: Piece, node: ast.expr) -> Options:
    """Type an expression; also one that calls a class, there or where a name gets its value."""
    node = piece.types.origin(node)
    if isinstance(node, ast.Call):
        made = piece.types.value_of(node.func)
        if isinstance(made, type):
            return (made,)
        return piece.types.of(node)
    found = piece.types.value_of(node)
    return piece.types.of(node) if found is MISSING else (type(found),)


def _is_of_a_package(function: Any) -> bool:
    """Check for a function of a well-known package that waits, without importing it."""
    package = str(getattr(function, "__module__", "")).partition(".")[0]
    return getattr(function, "__name__", "") in _OF_PACKAGES.get(package, ())


def _waits(kind: Any, method: str) -> bool:
    if not isinstance(kind, type):
        return False
    package = kind.__module__.partition(".")[0]
    return method in _METHODS_OF_PACKAGES.get((package, kind.__name__), ()) or any(
        issubclass(kind, each) and method in methods for each, methods in _METHODS
    )


# Transitions that never come


def contradictory_times(subject: Subject) -> Iterator[Finding]:
    """Find transitions that fire after a time, and only before an earlier one."""
    for state in subject.states:
        for each in state.transitions:
            low, high = _times(each)
            if low >= high:
                text = f"state {state.name!r}: the transition to {each.target!r} can never fire"
                why = f"as it waits for more than {low:g} ms and for at most {high:g} ms"
                yield Finding(*each.where, "warning", f"{text}, {why}")


def _times(transition: CheckedTransition) -> tuple[float, float]:
    """Return the ms in the state after which a transition may fire, and up to which it may."""
    low, high = transition.after_ms or 0, inf
    for each in _conditions(transition.guard):
        is_after, call = True, each
        if isinstance(each, ast.UnaryOp) and isinstance(each.op, ast.Not):
            is_after, call = False, each.operand
        limit = _limit(transition.guard, call)
        if limit is not None and is_after:
            low = max(low, limit)
        elif limit is not None:
            high = min(high, limit)
    return low, high


def _conditions(guard: Code | None) -> list[ast.expr]:
    """List the conditions that must all hold, if the guard is an expression."""
    match guard and guard.body:
        case [ast.Return(ast.BoolOp(ast.And(), values))]:
            return values
        case [ast.Return(ast.expr() as value)]:
            return [value]
    return []


def _limit(guard: Code | None, call: ast.expr) -> float | None:
    """Read the limit in ms of a call of the state's clock."""
    match call:
        case ast.Call(ast.Attribute(ast.Name(name), clock), [ast.Constant(int(x) | float(x))], []):
            if guard is not None and name == guard.machine and clock in CLOCK:
                return x * CLOCK[clock] / 1e6
    return None


def repeated_guards(subject: Subject) -> Iterator[Finding]:
    """Find transitions that ask what one before them has asked, at a time not later."""
    for state in subject.states:
        before: dict[str, CheckedTransition] = {}
        for each in state.transitions:
            asked = _asked(each.guard)
            if asked is None:
                continue
            first = before.setdefault(asked, each)
            if first is not each and (first.after_ms or 0) <= (each.after_ms or 0):
                text = f"state {state.name!r}: the transition to {each.target!r} can never fire"
                why = f"as that to {first.target!r} before it has the same guard"
                yield Finding(*each.where, "warning", f"{text}, {why}")


def _asked(guard: Code | None) -> str | None:
    """Write what a guard asks; None if it may answer otherwise when it is asked again."""
    if guard is None or not all(isinstance(each, ast.Return) for each in guard.body):
        return None
    for node in nodes_of(guard):
        if isinstance(node, ast.Call) and _limit(guard, node) is None:
            return None
        if isinstance(node, ast.NamedExpr):
            return None
    return "\n".join(ast.unparse(each) for each in guard.body)


def restarted_times(subject: Subject) -> Iterator[Finding]:
    """Find transitions to their own state beside others that wait there."""
    for state in subject.states:
        waits = any(_times(each)[0] > 0 for each in state.transitions if each.target != state.name)
        for each in state.transitions:
            if waits and each.target == state.name and not each.after_ms:
                text = "a transition to its own state does not start the time of after_ms anew"
                yield Finding(*each.where, "warning", f"state {state.name!r}: {text}")
