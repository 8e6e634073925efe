"""A script as Python text, to be pasted into a test."""

from __future__ import annotations

import math
from collections.abc import Iterable
from enum import Enum
from typing import Any

from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.slots import DEFAULT_CAPACITY

from ..engine.loading import Factory
from .replay import Invariant, Step
from .standing import name_of

__all__ = ["source_of"]

_KIT = "llfsm.runtime.testing"


def source_of(machines: Iterable[Factory], script: Iterable[Step], invariant: Invariant) -> str:
    """Return Python text that plays `script`.

    It imports what has a name in a module; what is local to a function goes by its name there,
    and a lambda by the name of the argument that it was.
    """
    text = _Text()
    listed = ", ".join(text.named(factory, "machine") for factory in machines)
    steps = "".join(f"        {text.step(step)},\n" for step in script)
    call = f"play(\n    [{listed}],\n    [\n{steps}    ],\n"
    call += f"    invariant={text.named(invariant, 'invariant')},\n)"
    for name in ("Step", "play"):
        text.imported(_KIT, name)
    return f"{text.imports()}\n\n{call}"


class _Text:
    """Write values as Python, and collect what must be imported for it."""

    def __init__(self) -> None:
        self._homes = {"Slot": "llfsm.whiteboard", "Step": _KIT, "play": _KIT}
        self._names: set[tuple[str, str]] = set()
        self._modules: set[str] = set()

    def imports(self) -> str:
        names: dict[str, list[str]] = {}
        for module, name in sorted(self._names):
            names.setdefault(module, []).append(name)
        lines = [f"import {module}" for module in sorted(self._modules)]
        lines += [f"from {module} import {', '.join(each)}" for module, each in names.items()]
        return "\n".join(lines)

    def imported(self, module: str, name: str) -> str:
        """Import `name`, and return how to call it: with its module if another one has it, too."""
        first = name.partition(".")[0]
        if self._homes.setdefault(first, module) == module:
            self._names.add((module, first))
            return name
        self._modules.add(module)
        return f"{module}.{name}"

    def named(self, thing: object, default: str) -> str:
        name = name_of(thing, default)
        module = getattr(thing, "__module__", "__main__")
        if "<" in getattr(thing, "__qualname__", "<") or module in ("__main__", "builtins"):
            return name
        return self.imported(module, name)

    def step(self, step: Step) -> str:
        messages = ", ".join(
            f"{self._slot(slot)}: {self._value(message)}" for slot, message in step.messages.items()
        )
        return f"Step({step.wait_ms}, {{{messages}}})" if messages else f"Step({step.wait_ms})"

    def _slot(self, slot: Slot[Any]) -> str:
        capacity = "" if slot.capacity == DEFAULT_CAPACITY else f", {slot.capacity}"
        self.imported("llfsm.whiteboard", "Slot")
        return f"Slot({slot.name!r}, {self.named(slot.type, '')}{capacity})"

    def _value(self, value: object) -> str:
        if isinstance(value, Message):
            fields = ", ".join(
                f"{name}={self._value(getattr(value, name))}" for name in value.__struct_fields__
            )
            return f"{self.named(type(value), '')}({fields})"
        if isinstance(value, Enum):
            return f"{self.named(type(value), '')}.{value.name}"
        if isinstance(value, float) and not math.isfinite(value):
            return f"float({str(value)!r})"
        if isinstance(value, tuple):
            return f"({''.join(f'{self._value(each)}, ' for each in value).rstrip()})"
        if isinstance(value, frozenset):
            return f"frozenset([{', '.join(sorted(map(self._value, value)))}])"
        return repr(value)
