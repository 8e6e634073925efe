"""A machine that controls another one."""

from llfsm.machines.common import stopping
from llfsm.runtime import Machine, State

__all__ = ["TurtleSuspendResume"]


class TurtleSuspendResume(Machine):
    """Suspend the machine named `target` for three seconds, let it run for five, and repeat."""

    target: str = "RosBlindTurttleBot"

    INITIAL = State()
    HOLD = State()
    RESTART = State()
    WATCH = State()
    END = State()

    @INITIAL.on_entry
    def _(self) -> None:
        self.suspend(self.target)

    @RESTART.on_entry
    def _(self) -> None:
        self.resume(self.target)

    @INITIAL.to(HOLD)
    def target_is_suspended(self) -> bool:
        """True once the suspension has taken effect."""
        return self.is_suspended(self.target)

    HOLD.to(RESTART, after_ms=3000)

    @RESTART.to(WATCH)
    def target_is_running(self) -> bool:
        """True once the resumption has taken effect."""
        return self.is_running(self.target)

    WATCH.to(INITIAL, after_ms=5000)

    INITIAL.to(END, when=stopping)
    HOLD.to(END, when=stopping)
    RESTART.to(END, when=stopping)
    WATCH.to(END, when=stopping)
