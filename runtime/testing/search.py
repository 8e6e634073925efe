"""Search for the shortest script that violates an invariant, and write it as Python text.

Hypothesis makes random scripts and shrinks the first that fails: fewer steps, less time, simpler
messages. Machines under a manual clock do the same for the same script, so the shortest one fails
again when it is played once more; if not, the machines depend on something else, which is an error.
The search has fixed seeds and keeps no database, so a test does the same in every run.

`PythonText` writes values, steps and calls, with the imports that they need.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, Final

from llfsm.runtime.engine.kernel import Factory
from llfsm.runtime.testing.errors import HypothesisMissingError, NotDeterministicError
from llfsm.runtime.testing.play import Invariant, Loading, factories, play
from llfsm.runtime.testing.scripted import Step
from llfsm.runtime.testing.waiting import name_of
from llfsm.whiteboard import Message, Slot
from llfsm.whiteboard.slots import DEFAULT_CAPACITY

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy


KIT: Final = "llfsm.runtime.testing"
"""The module from which the text imports `Step` and `play`."""


class PythonText:
    """Write values as Python, and collect the imports that they need.

    An attribute of a module is imported; an object local to a function is called by its name there,
    and a lambda by a given name.
    """

    def __init__(self) -> None:
        self._homes = {"Slot": "llfsm.whiteboard", "Step": KIT, "play": KIT}
        self._names: set[tuple[str, str]] = set()
        self._modules: set[str] = set()

    def imports(self) -> str:
        """Write the lines that import all that the text names."""
        names: dict[str, list[str]] = {}
        for module, name in sorted(self._names):
            names.setdefault(module, []).append(name)
        lines = [f"import {module}" for module in sorted(self._modules)]
        lines += [f"from {module} import {', '.join(each)}" for module, each in names.items()]
        return "\n".join(lines)

    def imported(self, module: str, name: str) -> str:
        """Import `name`; return it, qualified by its module if another one has the same name."""
        first = name.partition(".")[0]
        if self._homes.setdefault(first, module) == module:
            self._names.add((module, first))
            return name
        self._modules.add(module)
        return f"{module}.{name}"

    def named(self, thing: object, default: str) -> str:
        """Import a function or class, and return its name; `default` for a lambda."""
        name = name_of(thing, default)
        module = getattr(thing, "__module__", "__main__")
        if "<" in getattr(thing, "__qualname__", "<") or module in ("__main__", "builtins"):
            return name
        return self.imported(module, name)

    def step(self, step: Step) -> str:
        """Write a step of a script as a call of `Step`."""
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
        if step.elsewhere:
            given = (f"{name!r}: {dict(each)!r}" for name, each in step.elsewhere.items())
            parts.append(f"elsewhere={{{', '.join(given)}}}")
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


def check_invariant(
    machines: Factory | Iterable[Factory],
    *,
    invariant: Invariant,
    sensors: Mapping[Slot[Any], SearchStrategy[Any]] | None = None,
    rounds: int = 30,
    max_wait_ms: int = 2000,
    tries: int = 200,
) -> None:
    """Play random scripts as `play` does; raise the error of the shortest one that fails.

    A script has up to `rounds` steps; before each of them 0 to `max_wait_ms` milliseconds pass,
    and each slot of `sensors` may get a message drawn from its hypothesis strategy. `tries`
    scripts are played, the same ones in every call. The note of the error is Python text that
    plays the script. Raise `NotDeterministicError` if the script does not fail again, and
    `HypothesisMissingError` without hypothesis.
    """
    try:
        import hypothesis
        from hypothesis import errors, strategies
    except ImportError as error:
        raise HypothesisMissingError(
            "check_invariant needs hypothesis: pip install hypothesis"
        ) from error
    made = factories(machines)

    def fails(script: list[Step]) -> bool:
        try:
            play(made, script, invariant=invariant)
        except Exception:  # whatever it is, the same script raises it again below
            return True
        return False

    messages = strategies.fixed_dictionaries({}, optional=dict(sensors or {}))
    times = strategies.integers(0, max_wait_ms)
    step = strategies.tuples(times, messages).map(lambda given: Step(*given))
    settings = hypothesis.settings(
        max_examples=tries,
        deadline=None,  # a slow script is no failure
        database=None,
        derandomize=True,
        phases=[hypothesis.Phase.generate, hypothesis.Phase.shrink],
    )
    try:
        script = hypothesis.find(strategies.lists(step, max_size=rounds), fails, settings=settings)
    except errors.NoSuchExample:
        return
    except errors.Flaky as error:
        raise _not_deterministic() from error
    try:
        play(made, script, invariant=invariant)
    except Exception as error:
        error.add_note(f"To play it again:\n\n{source_of(made, script, invariant)}")
        raise
    raise _not_deterministic()


def _not_deterministic() -> NotDeterministicError:
    return NotDeterministicError(
        "a script that failed did not fail again: a machine or the invariant depends on more than "
        "its sensors and clock, as on time.time(), random or a class variable"
    )


def source_of(
    machines: Iterable[Factory | Loading], script: Iterable[Step], invariant: Invariant
) -> str:
    """Write Python text that plays `script`.

    The text imports every object that is an attribute of a module. It calls an object local to a
    function by its name there, and a lambda by the name of its argument.
    """
    text = PythonText()
    listed = ", ".join(text.named(factory, "machine") for factory in machines)
    steps = "".join(f"        {text.step(step)},\n" for step in script)
    call = f"play(\n    [{listed}],\n    [\n{steps}    ],\n"
    call += f"    invariant={text.named(invariant, 'invariant')},\n)"
    for name in ("Step", "play"):
        text.imported(KIT, name)
    return f"{text.imports()}\n\n{call}"
