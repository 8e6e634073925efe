"""The route of each slot between the board and the other hosts: its directions and its rate."""

from __future__ import annotations

from .merge import Version
from .refusals import Refusals, Refused
from .settings import Settings, matcher
from .store import Cell, Store

__all__ = ["RateLimit", "Route", "Routes"]

_EARLY_NS = 5_000_000
_BURST = 2  # arrivals may come at this multiple of the slot's rate; more are held back


class RateLimit:
    """When the next message may pass.

    One message may pass each period, up to 5 ms early if the previous one was not: the generic cell
    rate algorithm of ITU-T I.371. So messages that come at the permitted rate, but with jitter, do
    not wait each time.

    Args:
        period_ns: nanoseconds from one message to the next.

    """

    __slots__ = ("_least_ns", "_period_ns", "due_ns")

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._least_ns = max(0, period_ns - _EARLY_NS)
        self.due_ns = 0
        """When the next message may pass."""

    def record(self, now_ns: int) -> None:
        """Record that a message passes now."""
        self.due_ns = max(self.due_ns + self._period_ns, now_ns + self._least_ns)


class Route:
    """Whether and when messages of a slot leave the board and enter it."""

    __slots__ = ("arrivals", "cell", "departures", "enters", "leaves", "sent")

    def __init__(self, cell: Cell, leaves: bool, enters: bool, period_ns: int) -> None:
        self.cell = cell
        self.leaves = leaves
        self.enters = enters
        self.departures = RateLimit(period_ns)
        self.arrivals = RateLimit(period_ns // _BURST)
        self.sent: Version | None = None


class Routes:
    """The routes of the slots that are on a board."""

    def __init__(self, store: Store, settings: Settings, refusals: Refusals) -> None:
        self._store = store
        self._refusals = refusals
        self._period_ns = settings.period_ns()
        self._leaves = matcher(settings.leave)
        self.enters = matcher(() if settings.read_only else settings.enter)
        """Returns whether other hosts may add to a slot."""
        self._routes: dict[str, Route] = {}

    def known(self, name: str) -> Route | None:
        """Return the route of a slot that was asked for before."""
        return self._routes.get(name)

    def get(self, name: str) -> Route:
        """Return the route of a slot; raise `Refused` if its record on the board is unusable."""
        route = self._routes.get(name)
        if route is None:
            leaves, enters, period = self._leaves(name), self.enters(name), self._period_ns(name)
            route = self._routes[name] = Route(self._store.cell(name), leaves, enters, period)
        return route

    def usable(self, name: str) -> Route | None:
        """Return the route of a slot, or None, counted, if its record is unusable."""
        try:
            return self.get(name)
        except Refused as refused:
            self._refusals.add(f"unusable: {name}", str(refused))
            return None

    def all(self) -> list[tuple[str, Route]]:
        """Return the usable routes of all slots, with their names."""
        routes = ((of.name, self.usable(of.name)) for of in self._store.board.slots())
        return [(name, route) for name, route in routes if route is not None]
