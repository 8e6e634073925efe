"""Hide the extensions in C from each Python process that has this folder in its PYTHONPATH."""

import sys
from typing import Any

modules: dict[str, Any] = sys.modules
modules["llfsm.whiteboard._shm"] = modules["llfsm.runtime.engine._ringlet"] = None
