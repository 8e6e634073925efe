"""A property as the testing kit's invariant: machines that run are viewed as explored ones are."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

from ..engine.errors import OptionError
from ..testing.scripted import ScriptedEnvironment
from ..verification.properties import Property, evaluate
from ..verification.state_view import View
from .replaying import view_of

if TYPE_CHECKING:
    from ..engine.arrangement import Arrangement

__all__ = ["Holds", "holds"]


class Holds:
    """Whether a property is not violated, in one play: see `holds`."""

    def __init__(self, prop: Property, between_ms: tuple[float, float] | None):
        self.__qualname__ = prop.name  # which an error names
        self._property = prop
        self._from_ns, self._until_ns = (ms * 1e6 for ms in between_ms or (inf, inf))
        self._earlier: View | None = None
        self._due_ns = inf  # since when a response is due

    def begin(self, arrangement: Arrangement) -> bool:
        """Look at the initial state, and return whether it violates nothing."""
        return self(arrangement)

    def __call__(self, arrangement: Arrangement) -> bool:
        """Look at the state after a turn, and return whether nothing is violated."""
        environment = arrangement.environment
        if not isinstance(environment, ScriptedEnvironment):
            raise OptionError("holds(...) is an invariant for llfsm.runtime.testing.play")
        prop = self._property
        before, now = self._earlier, view_of(environment)
        self._earlier = now
        match prop.kind:
            case "never" if prop.functions:
                return not evaluate(prop, prop.functions[0], now)
            case "always":
                return evaluate(prop, prop.functions[0], now)
            case "step" if before is not None:
                return evaluate(prop, prop.functions[0], before, now)
            case "leads_to":
                answered = self._is_answered(now, environment.clock.now_ns())
                return answered and not (arrangement.finished and self._due_ns < inf)
        return True

    def _is_answered(self, now: View, now_ns: int) -> bool:
        """Return whether no response is late."""
        prop = self._property
        if prop.within_ms is not None and now_ns - self._due_ns > prop.within_ms * 1e6:
            return False
        trigger, response = prop.functions
        if evaluate(prop, response, now):
            self._due_ns = inf
        elif self._due_ns == inf and evaluate(prop, trigger, now):
            self._due_ns = now_ns
        return not (self._due_ns <= self._from_ns and now_ns >= self._until_ns)


def holds(prop: Property, *, between_ms: tuple[float, float] | None = None) -> Holds:
    """Return an invariant for one `llfsm.runtime.testing.play`: that `prop` is not violated.

    Of a `leads_to` without a time of its own, what was due at the first time of `between_ms` must
    have come by the second. A `reachable` is violated in no state.
    """
    return Holds(prop, between_ms)
