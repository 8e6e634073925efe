"""What ends an idle sleep early: news on a whiteboard for the machines of an arrangement.

News is a message in a slot that one of them reads, added since their last round began. What they
post themselves does not count: else a machine that posts at every turn what another one reads
would never let the arrangement sleep.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from llfsm.whiteboard.errors import BoardClosedError

from .clock import SimulatedClock

if TYPE_CHECKING:
    from llfsm.whiteboard import Board, BoundSlot

    from .clock import Clock

__all__ = ["News"]


class News:
    """Sleep until there is news; `clock` is that of the host, or a simulated one.

    A simulated clock ends the sleep each time it is set, and how long that takes nobody knows.
    """

    def __init__(self, board: Board, clock: Clock):
        self._waiter = board.waiter()
        self._clock = clock
        self._nap_s: float | None = None
        if isinstance(clock, SimulatedClock):
            self._nap_s = clock.nap_s
            clock.listen(self._waiter.wake)
        self._readers: dict[str, dict[str, BoundSlot[Any]]] = {}  # by machine, by name of the slot
        self._publishers: dict[str, list[tuple[str, BoundSlot[Any]]]] = {}
        self._heeded: set[BoundSlot[Any]] = set()
        self._seen: dict[BoundSlot[Any], int] = {}  # all of these slots, and what is no news there
        self._own: list[
            tuple[BoundSlot[Any], BoundSlot[Any]]
        ] = []  # of one slot: reader, publisher
        self._is_current = True  # whether the last two are those of the machines
        self._woken = False

    def reads(self, machine: str, slot: str, reader: BoundSlot[Any]) -> None:
        """Note that a machine reads a slot."""
        self._readers.setdefault(machine, {})[slot] = reader
        self._seen.setdefault(reader, reader.count)
        self._is_current = False

    def posts(self, machine: str, slot: str, publisher: BoundSlot[Any]) -> None:
        """Note that a machine posts to a slot, by a handle of its own."""
        self._publishers.setdefault(machine, []).append((slot, publisher))
        self._is_current = False

    def heed(self, slot: BoundSlot[Any]) -> None:
        """Return early for a message in that slot, too, which is no news by itself."""
        self._heeded.add(slot)
        self._seen.setdefault(slot, slot.count)

    def retire(self, machine: str) -> None:
        """Forget what a machine reads, and retire its handles."""
        self._readers.pop(machine, None)
        for _, publisher in self._publishers.pop(machine, ()):
            publisher.retire()
        self._is_current = False

    def sleep_until_ns(self, deadline_ns: int) -> bool:
        """Sleep until then or until there is news or a `wake`, and return whether there was.

        The end of the board is news, but ends no sleep.
        """
        if not self._is_current:
            self._update()
        seen = self._seen
        for reader, publisher in self._own:
            seen[reader] = max(seen[reader], publisher.added)
        left_s = max(deadline_ns - self._clock.now_ns(), 0) / 1e9
        if self._nap_s is not None and left_s:
            left_s = self._nap_s
        try:
            newer = self._waiter.wait(seen, left_s)
        except BoardClosedError:  # which stops the arrangement, when it looks
            self._clock.sleep_until_ns(deadline_ns)
            return True
        woken, self._woken = self._woken, False
        return woken or not self._heeded.issuperset(newer)

    def doze(
        self, duration_ns: int, until_ns: int, otherwise: Callable[[int], bool]
    ) -> Callable[[], bool]:
        """Return what sleeps again and again as `Environment.doze` says."""
        if not self._is_current:
            self._update()
        own = tuple(self._own)
        return self._waiter.doze(self._seen, own, duration_ns, until_ns, otherwise)

    def wake(self) -> None:
        """End the sleep, or the next one; from any thread, and from a signal's handler."""
        self._woken = True
        self._waiter.wake()

    def _update(self) -> None:
        """Find the slots again after machines have come or gone."""
        self._is_current = True
        readers = {(name, slot) for each in self._readers.values() for name, slot in each.items()}
        slots = {*self._heeded, *(slot for _, slot in readers)}
        self._seen = {slot: count for slot, count in self._seen.items() if slot in slots}
        by_name: dict[str, list[BoundSlot[Any]]] = {}
        for name, reader in readers:
            by_name.setdefault(name, []).append(reader)
        self._own = [
            (reader, publisher)
            for publishers in self._publishers.values()
            for name, publisher in publishers
            for reader in by_name.get(name, ())
        ]
