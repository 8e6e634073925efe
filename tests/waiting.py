"""Wait for a condition or for the end of a process, as long as a busy machine may need.

Importable from every test: `from waiting import wait_for`.
"""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable

__all__ = ["PATIENCE_S", "rest_of", "wait_for"]

PATIENCE_S = 60.0
"""How many seconds a condition may take before the test fails. A test that passes never waits so
long."""

_PAUSE_S = 0.001


def wait_for(
    condition: Callable[[], object],
    what: str = "the condition",
    *,
    between: Callable[[], object] = lambda: None,
    patience_s: float = PATIENCE_S,
) -> float:
    """Wait until `condition()` is true, and return the seconds that this took.

    After each vain look `between()` is called, for a condition that something has to be done for.
    Raise AssertionError, which names `what`, when `patience_s` seconds have passed.
    """
    begin = time.monotonic()
    while not condition():
        assert time.monotonic() - begin < patience_s, f"never: {what}"
        between()
        time.sleep(_PAUSE_S)
    return time.monotonic() - begin


def rest_of(process: subprocess.Popen[str]) -> str:
    """Wait until a process ends, and return what it prints until then, to the one pipe it has.

    `communicate` would leave out what came together with a line that was read before. A process
    that has not ended after `PATIENCE_S` seconds is killed. Asked again, it is nothing.
    """
    pipe = process.stdout or process.stderr
    assert pipe is not None
    if process.stdin is not None:
        process.stdin.close()
    killer = threading.Timer(PATIENCE_S, process.kill)
    killer.start()
    try:
        printed = "" if pipe.closed else pipe.read()
        process.wait()
    finally:
        killer.cancel()
        pipe.close()
    return printed
