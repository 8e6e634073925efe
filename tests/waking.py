"""A machine that wakes itself, unless somebody asks for another suspend."""

from llfsm.runtime import Machine, State
from llfsm.runtime.verification import leads_to

__all__ = ["Waking", "wakes"]


class Waking(Machine):
    """Resume itself whenever it is suspended."""

    AWAKE, ASLEEP = State(), State(suspend=True)
    AWAKE.to(AWAKE, after_ms=1000)

    @ASLEEP.internal
    def _(self) -> None:
        self.resume("Waking")


wakes = leads_to(lambda v: v.Waking.state == "ASLEEP", lambda v: v.Waking.state == "AWAKE", "wakes")
