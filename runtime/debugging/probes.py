"""Where breakpoints are in machines' tables: wrapped sections and sensors, nothing elsewhere.

A state is entered after a transition to it has fired, so the probe of one is in the OnExit of the
states before it: machines are paused before OnEntry runs. Where a request or the start leads to the
state, the probe is in its OnEntry, and the pause comes after that turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from .breakpoints import Breakpoint
from .harmless import UnseenError

if TYPE_CHECKING:
    from llfsm.runtime.engine.binding import BoundState
    from llfsm.runtime.engine.environment import Read
    from llfsm.runtime.engine.seat import Seat
    from llfsm.runtime.engine.state import SectionCode

__all__ = ["Probes"]


class Probes:
    """The breakpoints of an arrangement; those that were there `before` go on counting hits.

    `hit` is called with one, what was wrong with its condition, the machine, and the state that
    this has left, if any.
    """

    def __init__(
        self,
        breakpoints: Iterable[Breakpoint],
        hit: Callable[[Breakpoint, str, Seat, str], None],
        before: Probes | None = None,
    ):
        self.breakpoints = tuple(breakpoints)
        self._hit = hit
        known = {} if before is None else before._hits
        self._hits: dict[str, int] = {
            each.text: known.get(each.text, 0) for each in self.breakpoints
        }

    def wrap(self, seat: Seat) -> None:
        """Wrap sections of a machine that has just been bound."""
        mine = [each for each in self.breakpoints if each.machine == seat.name and each.state]
        entered = {each.state for each in mine if not each.leaves}
        for state in (*seat.states.values(), seat.suspension) if mine else ():
            if state.name in entered:
                code = None if state.name not in seat.states else state.on_entry
                here = [each for each in mine if not each.leaves and each.state == state.name]
                state.on_entry = self._entering(seat, here, code)
            targets = {target.name for *_, target in state.transitions if target is not state}
            if entered & targets or any(each.leaves and each.state == state.name for each in mine):
                state.on_exit = self._leaving(seat, state, mine, state.on_exit)

    def reading(self, seat: Seat, slot: str, read: Read) -> Read:
        """Return what reads a sensor of `slot`, and tests each message that is another one."""
        here = [each for each in self.breakpoints if each.slot == slot]
        latest: object = None

        def read_and_test() -> object:
            nonlocal latest
            message = read()
            if message is not latest:
                latest = message
                for each in here:
                    if message is not None:
                        self.test(each, seat, message, "")
            return message

        return read_and_test if here else read

    def test_failures(self, seat: Seat) -> None:
        """Test the breakpoints of a failure of a machine, whose code has raised."""
        for each in self.breakpoints:
            if each.fails and each.machine == seat.name:
                self.test(each, seat, seat.machine, "")

    def test(self, breakpoint: Breakpoint, seat: Seat, owner: object, source: str) -> None:
        """Count a hit, if the condition holds; one that cannot be evaluated is one, too."""
        try:
            if not breakpoint.holds(owner):
                return
        except Exception as error:
            what = (
                f"{error}" if isinstance(error, UnseenError) else f"{type(error).__name__}: {error}"
            )
            self._hit(breakpoint, f": its condition cannot be evaluated: {what}", seat, source)
            return
        self._hits[breakpoint.text] += 1
        if self._hits[breakpoint.text] >= breakpoint.least:
            self._hit(breakpoint, "", seat, source)

    def _entering(
        self,
        seat: Seat,
        here: list[Breakpoint],
        code: SectionCode | None,
    ) -> SectionCode:
        def test_and_run(machine: Any) -> None:
            if not seat.arrival().source:  # else it is announced by the probe in an OnExit
                for each in here:
                    self.test(each, seat, machine, "")
            if code is not None:
                code(machine)

        return test_and_run

    def _leaving(
        self,
        seat: Seat,
        state: BoundState,
        mine: list[Breakpoint],
        code: SectionCode | None,
    ) -> SectionCode:
        def test_and_run(machine: Any) -> None:
            target = seat.current
            for each in mine:
                if each.leaves:
                    hits = each.state == state.name and each.target in ("", target.name)
                else:
                    hits = each.state == target.name and target is not state
                if hits:
                    self.test(each, seat, machine, state.name)
            if code is not None:
                code(machine)

        return test_and_run
