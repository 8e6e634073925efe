"""Search for the shortest script that violates an invariant, and write it as Python text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from llfsm.whiteboard import Slot

from ..engine.loading import Factory
from .errors import HypothesisMissingError, NotDeterministicError
from .play import Invariant, Loading, factories, play
from .python_text import KIT, PythonText
from .scripted import Step

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy

__all__ = ["check_invariant", "source_of"]


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
    """Return Python text that plays `script`.

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
