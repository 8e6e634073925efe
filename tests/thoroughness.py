"""How many examples a test of hypothesis tries.

Importable from every test: `from thoroughness import examples`. `make test` tries what finds most
faults soon, and the same at each run; `LLFSM_EXAMPLES=20`, as `make fuzz` has it, twenty times as
many, and others at each run.
"""

import os

__all__ = ["SEARCHING", "examples"]

SEARCHING = "LLFSM_EXAMPLES" in os.environ
_SCALE = float(os.environ.get("LLFSM_EXAMPLES", "1"))


def examples(number: int) -> int:
    """Return the `max_examples` of a test that tries `number` in `make test`."""
    return round(number * _SCALE)
