"""Importing the runtime is cheap: what few programs need is imported when they do."""

from __future__ import annotations

import subprocess
import sys

EXPENSIVE = ["msgspec", "click", "rich", "logging", "inspect", "dataclasses", "asyncio"]
if sys.version_info < (3, 14):  # in which a NamedTuple needs it
    EXPENSIVE += ["ast"]


def test_nothing_expensive_is_imported():
    program = f"import sys, llfsm.runtime; print([m for m in {EXPENSIVE} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "[]\n"


def test_what_is_exported_is_there():
    import llfsm.runtime

    assert all(hasattr(llfsm.runtime, name) for name in llfsm.runtime.__all__)
