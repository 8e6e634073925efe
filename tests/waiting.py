"""Wait for a condition, as long as a busy machine may need, and never for a time.

Importable from every test: `from waiting import wait_for`.
"""

from __future__ import annotations

import time
from collections.abc import Callable

__all__ = ["PATIENCE_S", "wait_for"]

PATIENCE_S = 30.0
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
