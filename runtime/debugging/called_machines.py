"""The machines that others may call: breakpoints can be set before these run."""

from __future__ import annotations

import sys
from collections.abc import Iterable

from llfsm.runtime.engine.machine import Machine

__all__ = ["machines_beside"]


def machines_beside(classes: Iterable[type[Machine]]) -> dict[str, type[Machine]]:
    """Return the machine classes in the modules of some, by name."""
    modules = {cls.__module__: sys.modules.get(cls.__module__) for cls in classes}
    return {
        each.__name__: each
        for module in filter(None, modules.values())
        for each in vars(module).values()
        if isinstance(each, type) and issubclass(each, Machine) and each is not Machine
    }
