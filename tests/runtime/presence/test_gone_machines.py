"""Machines that have left are gone for those of their arrangement, published or not."""

from __future__ import annotations

from llfsm.runtime import Arrangement, Machine, State, UnknownMachineError
from llfsm.whiteboard import Whiteboard


class Brief(Machine):
    """Leaves in its first turn."""

    only = State()


class Asking(Machine):
    """Notes in each turn what it learns of Brief."""

    found: tuple[str, ...] = ()
    ask, end = State(), State()

    @ask.internal
    def _(self) -> None:
        try:
            self.found = (*self.found, self.state_name_of("Brief"))
        except UnknownMachineError:
            self.found = (*self.found, "gone")

    ask.to(end, when=lambda self: len(self.found) == 3)


def test_a_machine_that_has_just_left_is_not_found_elsewhere() -> None:
    asking = Asking()
    Arrangement([Brief, asking], whiteboard=Whiteboard.local()).run()
    assert asking.found == ("gone", "gone", "gone")
