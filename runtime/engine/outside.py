"""Which functions read a clock or random numbers, or reach what is beside the machines.

Code that calls them does not do the same again: `llfsm check` warns of clocks and random numbers,
and verification finds all such calls as they are made.
"""

from __future__ import annotations

import _thread
import datetime
import io
import os
import random
import time
from typing import Final

__all__ = ["reaches_outside", "reads_outside"]

_CLOCKS: Final = frozenset(
    function
    for name, function in vars(time).items()
    if name.removesuffix("_ns") in ("time", "monotonic", "perf_counter", "process_time")
    or name in ("thread_time", "localtime", "gmtime", "ctime", "strftime")
)
_NOW: Final = ("now", "utcnow", "today")
_CHANCE: Final = ("uuid", "secrets")
_SYSTEM: Final = ("posix", "nt", "_posixsubprocess", "_winapi", "_socket", "select")
_PURE: Final = ("fspath", "_path_")
"""How the names of functions of the system begin that only compute."""
_THREADS: Final = ("start_new_thread", "start_joinable_thread")


def reads_outside(function: object) -> bool:
    """Return whether what a function returns depends on the host's clock or on chance."""
    try:
        if function in _CLOCKS or function is os.urandom:
            return True
    except TypeError:  # a method of what has no hash
        return False
    owner = getattr(function, "__self__", None)
    if isinstance(owner, type) and issubclass(owner, datetime.date):
        return getattr(function, "__name__", "") in _NOW
    by_chance = getattr(function, "__module__", None) in _CHANCE and not isinstance(function, type)
    return isinstance(owner, random.Random) or by_chance


def reaches_outside(function: object) -> bool:
    """Return whether a function reads or changes files, processes or sockets, or starts threads."""
    name, module = (getattr(function, each, None) for each in ("__name__", "__module__"))
    if module in _SYSTEM:
        return not str(name).startswith(_PURE)
    if module == _thread.__name__:
        return name in _THREADS
    owner = getattr(function, "__self__", None)
    reads = isinstance(owner, io.IOBase) and str(name).startswith("read")
    return reads or function is open or function is input
