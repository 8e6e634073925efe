"""The machines that others may call: breakpoints can be set before these run."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FunctionType

from llfsm.runtime.bundles import SUFFIX, load_bundle
from llfsm.runtime.engine.machine import Machine

__all__ = ["machines_beside", "may_call"]


def machines_beside(classes: Iterable[type[Machine]]) -> dict[str, type[Machine]]:
    """Return the machine classes in the modules of some, by name."""
    modules = {cls.__module__: sys.modules.get(cls.__module__) for cls in classes}
    return {
        each.__name__: each
        for module in filter(None, modules.values())
        for each in vars(module).values()
        if isinstance(each, type) and issubclass(each, Machine) and each is not Machine
    }


def may_call(classes: Iterable[type[Machine]], name: str) -> type[Machine] | None:
    """Return a machine that code of some may call by that name; None if none is known.

    That is one in the module of a class, or the bundle beside a bundle whose code names it. Raise
    what `load_bundle` raises.
    """
    known = [*classes]
    beside = machines_beside(known)
    if name in beside:
        return beside[name]
    for cls in known:
        folder = Path(cls.table.path)
        other = folder.with_name(f"{name}{SUFFIX}")
        if folder.suffix == SUFFIX and other.is_dir() and name in _texts(cls):
            return load_bundle(other)
    return None


def _texts(cls: type[Machine]) -> Iterator[object]:
    """Yield the constants of a machine's code."""
    for state in cls.table.states:
        for code in state.sections.values():
            if isinstance(code, FunctionType):
                yield from code.__code__.co_consts
