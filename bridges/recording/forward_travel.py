"""Go through a recording in one thread, forwards only: in a process from which others are forked.

A question that cannot be answered at once leaves the function by an exception: the machines go on,
or another process answers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from llfsm.runtime.engine.events import Event, Section, Turn

from .travel import Jump, Travel
from .travel_debugger import TravelDebugger

if TYPE_CHECKING:
    from .rerun import Rerun
    from .travel_host import TravelHost

__all__ = ["ForwardTravel", "GoneElsewhere", "GoneOn", "HostedDebugger", "Moment", "OtherMoment"]


class Moment(NamedTuple):
    """Where the machines of a process are."""

    number: int
    """The number of the turn that is to come; 0 before anything is arranged."""
    time_ns: int
    """The time of that turn; `NEVER` at the end."""
    breakpoints: tuple[str, ...] = ()
    counted: bool = True
    """Whether these have counted their hits from the beginning."""

    def counts(self, breakpoints: tuple[str, ...]) -> bool:
        """Return whether these have counted from the beginning, or have nothing to be counted."""
        if self.breakpoints == breakpoints:
            return self.counted
        # Without a count there is nothing to be counted; messages that were read count as known.
        return not any("#" in text or text.startswith("@") for text in breakpoints)


class GoneOn(BaseException):  # no error of whom it passes
    """The machines go on: what was asked cannot be answered before they are paused again."""


class OtherMoment(NamedTuple):
    """Another process is to answer, at that moment; None for the last breakpoint before now."""

    jump: Jump | None


class GoneElsewhere(BaseException):
    """The answer is not to be found in this process."""

    def __init__(self, jump: Jump | None):
        self.elsewhere = OtherMoment(jump)


class ForwardTravel(Travel):
    """Go through a recording in one thread, forwards only."""

    def __init__(self, host: TravelHost, *arguments: Any):
        self._host = host
        self.over = False
        super().__init__(*arguments)

    def _begin(self, jump: Jump) -> None:
        self.rerun = self._arrange(jump)

    def _debugger_of(self, rerun: Rerun, since: int) -> TravelDebugger:
        return HostedDebugger(rerun, since, self._host)

    def run(self) -> None:
        """Run the machines; return at the end."""
        self._run(self.rerun)
        self.over = True

    def wait(self) -> str:
        """Return why the machines are paused; "" at the end. Raise what ended them."""
        if self.over:
            if self._error is not None:
                raise self._error
            return ""
        if not self.debugger.paused:
            raise GoneOn
        return self.debugger.paused

    def break_at(self, *texts: str) -> None:
        """Replace all breakpoints; raise `BreakpointError`."""
        super().break_at(*texts)
        self._host.counts = self.debugger.moment == 1

    def back_to_breakpoint(self) -> str:
        """Leave this to another process."""
        raise GoneElsewhere(None)

    def _go_to(self, jump: Jump) -> str:
        raise GoneElsewhere(jump._replace(breakpoints=self.debugger.breakpoints))

    _go_on_to = _go_to


class _Released:
    """The event that lets machines go on; to wait for it is to serve."""

    def __init__(self, serve: Callable[[], None]):
        self._serve = serve
        self._is_set = False

    def is_set(self) -> bool:
        return self._is_set

    def set(self) -> None:
        self._is_set = True

    def clear(self) -> None:
        self._is_set = False

    def wait(self, _: float) -> bool:
        self._serve()
        return True


class HostedDebugger(TravelDebugger):
    """A debugger whose process is kept at some turns, and asked while it is paused."""

    def __init__(self, rerun: Rerun, since: int, host: TravelHost):
        super().__init__(rerun, since)
        self._host = host
        self._go = _Released(host.serve)  # type: ignore[assignment]  # it is used as an Event

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, Turn) and self._rerun.difference is None:
            self._host.pass_by(event)
        super().__call__(event)

    def jump(self, jump: Jump) -> None:
        """Run to a moment, in a process that was kept while machines ran to another one."""
        self.passed, self.fired, self.place = 0, None, None
        self.run_to(jump.goal(self), jump.since)

    def _open_pdb(self, event: Section) -> None:
        place = self.place
        super()._open_pdb(event)
        if self.place is not place:
            self._host.is_touched = True
