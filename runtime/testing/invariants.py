"""Look for a script that breaks an invariant, and make it as short as possible."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from llfsm.whiteboard import Slot

from ..engine.loading import Factory
from .errors import HypothesisMissingError, NotDeterministicError
from .replay import Invariant, Step, factories, play
from .source import source_of

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy

__all__ = ["check_invariant"]


def check_invariant(
    machines: Factory | Iterable[Factory],
    *,
    invariant: Invariant,
    sensors: Mapping[Slot[Any], SearchStrategy[Any]] | None = None,
    rounds: int = 30,
    max_wait_ms: int = 2000,
    tries: int = 200,
) -> None:
    """Play random scripts as `play` does; raise what the shortest that fails raises.

    A script has up to `rounds` steps; before each of them 0 to `max_wait_ms` milliseconds pass,
    and each slot of `sensors` may get a message that its hypothesis strategy draws. `tries`
    scripts are tried, always the same ones. The error's note is Python text that plays the
    script found. Raise `NotDeterministicError` if the script does not fail twice, and
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
    step = strategies.builds(Step, strategies.integers(0, max_wait_ms), messages)
    settings = hypothesis.settings(
        max_examples=tries,
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
