"""Values, scripts and calls as Python text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from typing import Any, Final

from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.slots import DEFAULT_CAPACITY

from .scripted import Step
from .states import name_of

__all__ = ["KIT", "PythonText"]

KIT: Final = "llfsm.runtime.testing"


class PythonText:
    """Write values as Python, and collect the imports that they need.

    What is an attribute of a module is imported; what is local to a function is called by its name
    there, and a lambda by the name that it is given.
    """

    def __init__(self) -> None:
        self._homes = {"Slot": "llfsm.whiteboard", "Step": KIT, "play": KIT}
        self._names: set[tuple[str, str]] = set()
        self._modules: set[str] = set()

    def imports(self) -> str:
        """Return the lines that import what the text calls."""
        names: dict[str, list[str]] = {}
        for module, name in sorted(self._names):
            names.setdefault(module, []).append(name)
        lines = [f"import {module}" for module in sorted(self._modules)]
        lines += [f"from {module} import {', '.join(each)}" for module, each in names.items()]
        return "\n".join(lines)

    def imported(self, module: str, name: str) -> str:
        """Import `name`; return it, qualified by its module if another module has the same name."""
        first = name.partition(".")[0]
        if self._homes.setdefault(first, module) == module:
            self._names.add((module, first))
            return name
        self._modules.add(module)
        return f"{module}.{name}"

    def named(self, thing: object, default: str) -> str:
        """Return what calls a function or class."""
        name = name_of(thing, default)
        module = getattr(thing, "__module__", "__main__")
        if "<" in getattr(thing, "__qualname__", "<") or module in ("__main__", "builtins"):
            return name
        return self.imported(module, name)

    def step(self, step: Step) -> str:
        """Return what makes a step of a script."""
        self.imported(KIT, "Step")
        parts = [f"{step.wait_ms:.15g}"]
        if step.messages:
            parts.append(self._messages(step.messages))
        if step.before:
            before = (f"{name!r}: {self._messages(each)}" for name, each in step.before.items())
            parts.append(f"before={{{', '.join(before)}}}")
        for option, asks in (("asks", step.asks), ("after", step.after)):
            if asks:
                each = (f"{name!r}: {[*asked]!r}" for name, asked in asks.items())
                parts.append(f"{option}={{{', '.join(each)}}}")
        return f"Step({', '.join(parts)})"

    def _messages(self, messages: Mapping[Slot[Any], Any]) -> str:
        posted = (f"{self._slot(slot)}: {self._value(each)}" for slot, each in messages.items())
        return f"{{{', '.join(posted)}}}"

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
