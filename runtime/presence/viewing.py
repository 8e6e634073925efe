"""What an arrangement publishes while somebody looks: variables, and why states are kept."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING

from llfsm.whiteboard.messages.llfsm import VIEWER

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from llfsm.whiteboard import Board

    from ..engine.arrangement import Arrangement
    from .published import PublishedMachine

__all__ = ["Viewing"]

_VIEW_NS = 2_000_000_000  # a viewer that has posted its presence looks for so long
_PERIOD_NS = 100_000_000


class Viewing:
    """Post the variables of an arrangement's machines, and why they are in their states.

    `tolerating` is entered for each post: what it raises must not stop a robot.
    """

    def __init__(
        self,
        arrangement: Arrangement,
        board: Board,
        now_ns: int,
        machine_now: Callable[[], int],
        tolerating: AbstractContextManager[object],
    ):
        self._arrangement = arrangement
        self._machine_now = machine_now
        self._tolerating = tolerating
        self._viewer = board[VIEWER]
        self._seen = self._viewer.count
        self._ends_ns = self._why_ends_ns = self._due_ns = now_ns
        self._is_sampled = False  # whether a round was to be seen since somebody asks why

    @property
    def due_ns(self) -> int | None:
        """When there is something to post; None while nobody looks."""
        return self._due_ns if self._due_ns < self._ends_ns else None

    def hurry(self, now_ns: int) -> None:
        """Post at the next look, though time may stand still."""
        self._due_ns = now_ns

    def look(self, entries: Collection[PublishedMachine], now_ns: int) -> None:
        """Post what is due."""
        if self._viewer.count != self._seen:
            self._seen = self._viewer.count
            self._ends_ns = now_ns + _VIEW_NS
            viewer = self._viewer.get()
            if viewer is not None and viewer.why:
                self._is_sampled = self._is_sampled and now_ns < self._why_ends_ns
                self._why_ends_ns = self._ends_ns
        if not self._due_ns <= now_ns < self._ends_ns:
            return
        self._due_ns = now_ns + _PERIOD_NS
        for entry in entries:
            with self._tolerating:
                entry.post_variables()
        if now_ns < self._why_ends_ns:
            self._post_whys(entries)

    def _post_whys(self, entries: Collection[PublishedMachine]) -> None:
        """Post what the machines saw in a round since the last time, and have the next one seen."""
        # here, because few look
        from ..debugging.debugger import Debugger
        from ..debugging.published_causes import why_of

        is_paused = bool(self._arrangement.paused)  # then no round comes
        is_ready, self._is_sampled = self._is_sampled or is_paused, not is_paused
        for entry in entries if is_ready else ():
            with self._tolerating:
                entry.post_why(why_of(self._arrangement, entry.name, self._machine_now()))
        Debugger.of(self._arrangement).turns.sample()
