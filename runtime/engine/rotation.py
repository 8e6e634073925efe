"""The rotation: the machines' turns in a round, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from llfsm.runtime.engine.errors import ExecutionError

if TYPE_CHECKING:
    from llfsm.runtime.engine.seat import Seat
    from llfsm.runtime.engine.twin import Timing


class Rotation:
    """Give seats their turns. The arrangement, which is one, says what comes of them."""

    _turn: Callable[[Seat], bool]
    """A ringlet; another one when an observer comes or goes, also during a round."""
    _leaving: list[Seat]
    """To be unloaded when their ringlet is over."""
    stopwatch: Timing | None
    """What times the turns, if anything does."""
    _gate: Callable[[], bool] | None
    """A round begins when this returns True: at its time, or at once; after the end it raises."""
    rounds: int
    """The number of rounds so far."""
    marks: Callable[[], object]
    """Return where the machines stand; equal as long as they do. The twin looks by itself."""

    def give_turns(self, seats: Iterable[Seat | None]) -> bool:
        """Give each seat its turn, and return whether a transition fired in any."""
        any_fired = False
        for seat in seats:
            if seat is None:
                continue
            turn, stopwatch, fired = self._turn, self.stopwatch, False
            try:
                try:
                    fired = turn(seat)
                finally:
                    if stopwatch is not None:
                        stopwatch.take(seat, fired)
                if fired:
                    any_fired = True
                elif not seat.current.transitions:
                    self._accept(seat)
            except ExecutionError as error:
                self.fail(seat, error)
            if self._leaving:
                self._let_go()
        return any_fired

    def give_round(self, seats: Iterable[Seat | None]) -> bool:
        """Give a round that nobody observes, and for whose time nobody waits."""
        self.rounds += 1
        return self.give_turns(seats)

    def give_rounds(self, seats: list[Seat | None], sleep: Callable[[], bool]) -> bool:
        """Give rounds, and sleep after each, until one changes where a machine stands.

        Or until `sleep` returns False, or an observer comes: `_turn` is what it was when it began.
        Return whether a transition fired in the last round. A round that changes nothing is what a
        machine that waits has most of: so here it costs its turns, and little else.
        """
        turn, before = self._turn, self.marks()
        while self._gate is None or self._gate():
            fired = self.give_round(seats)
            is_same = self._turn is turn and self.marks() == before
            if fired or not is_same or not sleep():
                return fired
        return False

    # The arrangement's part: what comes of a turn. The twin in C calls the same names.

    def _accept(self, seat: Seat) -> None:
        raise NotImplementedError

    def fail(self, seat: Seat, error: ExecutionError) -> None:
        """Do what is to be done about a machine whose code raised, within its turn."""
        raise NotImplementedError

    def _let_go(self) -> None:
        raise NotImplementedError
