"""The rotation: the machines' turns in a round, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from .errors import ExecutionError

if TYPE_CHECKING:
    from .seat import Seat

__all__ = ["Rotation"]


class Rotation:
    """Give seats their turns. The arrangement, which is one, says what comes of them."""

    _turn: Callable[[Seat], bool]
    """A ringlet; another one when an observer comes or goes, also during a round."""
    _leaving: list[Seat]
    """To be unloaded when their ringlet is over."""

    def _give_turns(self, seats: Iterable[Seat | None]) -> bool:
        """Give each seat its turn, and return whether a transition fired in any."""
        fired = False
        for seat in seats:
            if seat is None:
                continue
            turn = self._turn
            try:
                if turn(seat):
                    fired = True
                elif not seat.current.transitions:
                    self._accept(seat)
            except ExecutionError as error:
                self._fail(seat, error)
            if self._leaving:
                self._let_go()
        return fired

    # The arrangement's part: what comes of a turn. The twin in C calls the same names.

    def _accept(self, seat: Seat) -> None:
        raise NotImplementedError

    def _fail(self, seat: Seat, error: ExecutionError) -> None:
        raise NotImplementedError

    def _let_go(self) -> None:
        raise NotImplementedError
