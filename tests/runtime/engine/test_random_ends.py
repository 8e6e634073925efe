"""Random requests to machines inside each other: nothing drives that no machine commands."""

from __future__ import annotations

from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from llfsm.runtime import Arrangement, ManualClock
from llfsm.whiteboard.local import LocalBoard
from thoroughness import examples

from .commands import ARM, LAMP, WHEEL
from .test_nesting import Alternates, Arm, Mission, Wheel


class Ends(RuleBasedStateMachine):
    """No slot has a value that no living machine commands."""

    def __init__(self) -> None:
        super().__init__()
        self.board = LocalBoard()
        self.arrangement = Arrangement(
            [Mission(to=5), Alternates],
            whiteboard=self.board,
            clock=ManualClock(),
            on_error="suspend",
        )

    @precondition(lambda self: self.arrangement.machines)
    @rule(
        data=st.data(),
        how=st.sampled_from(
            ["suspend", "resume", "restart", "unload", "abandon", "stop_machine", "bad", "flag"]
        ),
    )
    def ask(self, data: st.DataObject, how: str) -> None:
        machine: Any = data.draw(st.sampled_from(self.arrangement.machines))
        flag = next((each for each in ("away", "enough") if hasattr(machine, each)), None)
        if how == "bad":
            if hasattr(machine, "bad"):
                machine.bad = not machine.bad
        elif how == "flag":
            if flag is not None:
                setattr(machine, flag, not getattr(machine, flag))
        else:
            getattr(self.arrangement.control, how)(machine.name)

    @rule(number=st.integers(1, 3))
    def turn(self, number: int) -> None:
        for _ in range(number):
            self.arrangement.round()

    @invariant()
    def nothing_moves_without_a_machine(self) -> None:
        roster = self.arrangement.roster
        for kind, slot in ((Wheel, WHEEL), (Arm, ARM), (Mission, LAMP)):
            seats = [seat for seat in roster if isinstance(seat.machine, kind)]
            asked = [
                seat for seat in seats if not seat.suspended or seat.previous is not seat.current
            ]
            found = self.board.get_message(slot)
            if found is not None and found.value:
                assert asked, f"{kind.__name__} is gone, and {slot.name} has {found}"

    @invariant()
    def inner_machines_belong_to_the_current_state(self) -> None:
        for seat in self.arrangement.roster:
            if seat.inner:
                outer = seat.caller
                assert outer is not None
                assert outer.taken
                assert outer.children is not None
                assert seat in outer.children
                assert "work" in (outer.current.name, outer.suspended and outer.remembered.name)


TestEnds = Ends.TestCase
TestEnds.settings = settings(max_examples=examples(60), stateful_step_count=30, deadline=None)
