"""Hide the extensions in C from each Python process that has this folder in its PYTHONPATH.

Each refusal of shared memory is noted in the file that $LLFSM_REFUSALS names, whatever becomes of
the error: a test that failed after one is counted as skipped.
"""

import os
import sys
from importlib.abc import MetaPathFinder
from typing import Any

EXTENSIONS = (
    "llfsm.whiteboard._shm",
    "llfsm.runtime.engine._ringlet",
    "llfsm.runtime.verification._states",
)


class _Hiding(MetaPathFinder):
    def find_spec(self, name: str, *_: object) -> None:
        if name not in EXTENSIONS:
            return
        errors: Any = sys.modules.get("llfsm.whiteboard.errors")  # imported before the extension
        if errors is not None:
            errors.SharedMemoryUnavailableError.__init__ = _refuse
        raise ModuleNotFoundError(f"{name} is hidden", name=name)


def _refuse(self: Exception, *arguments: object) -> None:
    Exception.__init__(self, *arguments)
    if notes := os.environ.get("LLFSM_REFUSALS"):
        with open(notes, "a") as file:
            file.write(".")


sys.meta_path.insert(0, _Hiding())
