"""Run every kept ringlet again, in another order: each must do the same.

Code that reads random numbers, the host's clock, files or what is not a machine's own makes the
table of ringlets wrong, and so does what depends on the order of a set. Most such code does not do
the same twice. A clock or a file may not change meanwhile, so calls that read them are found as
they are made.
"""

from __future__ import annotations

import gc
import random
import sys
from collections.abc import Iterable
from contextlib import suppress
from itertools import pairwise, zip_longest
from types import FrameType
from typing import Any, Final

from ..engine.events import Eval, Event, Section
from ..engine.failure import place_of
from ..engine.outside import reaches_outside, reads_outside
from ..engine.ringlet import ringlet
from .errors import RepeatError
from .ringlets import Ringlets
from .standings import Given, RingletOutcome, UnknownStandingError

__all__ = ["check_repeats"]

_UNSEEN: Final = ("logging", "linecache", "tokenize", "llfsm.whiteboard", "llfsm.runtime")
"""What reads a clock or files for reports, which no code of a machine sees."""
_STANDARD: Final = sys.stdlib_module_names
_TRIES = 20
_LEAST = 1_000
"""Ringlets to run again at least: of a few, each is run often, as chance may do the same twice."""


def check_repeats(ringlets: Ringlets, kept: Iterable[tuple[Given, RingletOutcome]]) -> None:
    """Run ringlets again, shuffled; raise `RepeatError` if one does something else.

    Raise `TimeUpError` after the deadline. The messages in slots are equal, but other objects: no
    code may depend on which they are.
    """
    each = list(kept)
    for given, _ in each:
        if call := _outside_call(ringlets, given):
            raise RepeatError(
                f"{ringlets.seats[given.place].name}, {call}: only variables, sensors and the time "
                f"in the state, as by after_ms, can be explored"
            )
    again = each * max(1, _LEAST // max(1, len(each)))
    random.Random(0).shuffle(again)
    for given, before in again:
        if _again(ringlets, given) != before:
            raise RepeatError(
                f"{_place(ringlets, given)} did not do the same again in the same situation: does "
                f"it read what machines share, compare messages with `is`, or depend on a set's "
                f"order? Only variables, sensors and the time in the state can be explored"
            )


def _again(ringlets: Ringlets, given: Given) -> RingletOutcome | None:
    """Run a ringlet; return None if it asks about a machine about which it did not ask before."""
    try:
        return ringlets.run_ringlet(given, copied=True)
    except UnknownStandingError:
        return None


def _place(ringlets: Ringlets, given: Given) -> str:
    """Return machine, state and section of the code that does not do the same again."""
    runs = [_steps(ringlets, given) for _ in range(_TRIES)]
    for first, second in pairwise(runs):
        for one, other in zip_longest(first, second):
            if one != other:
                return f"{ringlets.seats[given.place].name}, {(one or other)[0]},"
    state = ringlets.controls[given.place].values[given.control].current
    return f"{ringlets.seats[given.place].name}, state {state},"


def _outside_call(ringlets: Ringlets, given: Given) -> str:
    """Run a ringlet, and return where it first reads a clock or random numbers, if it does."""
    calls: list[str] = []

    def watch(frame: FrameType, event: str, function: Any) -> None:
        if event != "c_call" or calls:
            return
        module = str(frame.f_globals.get("__name__"))
        if module.startswith(_UNSEEN):
            return
        if function is hash or function is id:  # a `__hash__` may call them, for sets and dicts
            if frame.f_code.co_name == "__hash__" or module.split(".")[0] in _STANDARD:
                return
        elif not (reads_outside(function) or reaches_outside(function)):
            return
        inner, outer = frame, frame.f_back
        while outer is not None and outer.f_code is not ringlet.__code__:
            inner, outer = outer, outer.f_back
        if outer is not None:
            running = outer.f_locals
            state, step = place_of(running["seat"], running["state"], running["code"])
            name = getattr(function, "__qualname__", function)
            where = f"{inner.f_code.co_filename}:{inner.f_lineno}"
            calls.append(f"state {state}, {step}, calls {name} ({where})")

    before, collects = sys.getprofile(), gc.isenabled()
    gc.disable()  # what is called when garbage is collected is not the machine's code
    sys.setprofile(watch)
    try:
        with suppress(UnknownStandingError):  # which is found when it is run again
            ringlets.run_ringlet(given)
    finally:
        sys.setprofile(before)
        if collects:
            gc.enable()
    return calls[0] if calls else ""


def _steps(ringlets: Ringlets, given: Given) -> list[tuple[str, object]]:
    """Run a ringlet and return each step with what it had changed by its end, or its value."""
    steps: list[tuple[str, object]] = []
    begun: list[str] = []

    def end_section() -> None:
        if begun:
            steps.append((begun.pop(), ringlets.fingerprint(given.place)))

    def observe(event: Event) -> None:
        if isinstance(event, Section | Eval):
            end_section()
        if isinstance(event, Section):
            begun.append(f"state {event.state}, {event.section}")
        elif isinstance(event, Eval):
            steps.append((f"state {event.state}, transition {event.label}", event.value))

    ringlets.attach(observe)
    try:
        _again(ringlets, given)
        end_section()
    finally:
        ringlets.detach(observe)
    return steps
