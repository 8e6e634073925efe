"""The route of each slot between the board and the other hosts: its directions and its rate."""

from __future__ import annotations

from collections.abc import Iterable

from ..own_slots import OWN
from .groups import EVERY_GROUP, group_of
from .merge import Version
from .naming import Naming
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

    __slots__ = ("arrivals", "cell", "departures", "enters", "group", "leaves", "sent", "wire")

    def __init__(self, cell: Cell, wire: str, leaves: bool, enters: bool, period_ns: int) -> None:
        self.cell = cell
        self.wire = wire
        """The slot's name for other hosts."""
        self.group = group_of(wire)
        self.leaves = leaves
        self.enters = enters
        self.departures = RateLimit(period_ns)
        self.arrivals = RateLimit(period_ns // _BURST)
        self.sent: Version | None = None


class Routes:
    """The routes of the slots that are on a board."""

    def __init__(self, store: Store, settings: Settings, refusals: Refusals) -> None:
        self._store = store
        self.naming = Naming(settings.as_, settings.fleet)
        """The names of slots here and elsewhere."""
        self._refusals = refusals
        self._period_ns = settings.period_ns()
        self._leaves = matcher(settings.leave)
        self.enters = matcher(() if settings.read_only else settings.enter)
        """Returns whether other hosts may add to a slot."""
        self._routes: dict[str, Route] = {}
        self._groups: dict[str, list[tuple[str, Route]]] = {}
        self.offered: dict[str, bool] = {}
        """The groups that have messages which may leave, and which of them are about machines."""

    def to_receive(self, read: Iterable[str]) -> set[str]:
        """Return the groups of slots that are read and may enter, and of a named host's own.

        What is for it arrives, also in slots that have no message yet.
        """
        if self.naming.host:
            names = (info.name for info in self._store.board.slots())
            read = {*read, *filter(self.naming.is_own, names)}
        wires = map(self.naming.wire, filter(self.enters, read))
        return {group_of(wire) for wire in wires if wire is not None}

    def known(self, name: str) -> Route | None:
        """Return the route of a slot that was asked for before."""
        return self._routes.get(name)

    def get(self, name: str) -> Route:
        """Return the route of a slot; raise `Refused` if its record on the board is unusable."""
        route = self._routes.get(name)
        if route is None:
            leaves, enters = self._leaves(name), self.enters(name)
            wire = self.naming.wire(name)
            if wire is None:
                if leaves or enters:
                    self._refusals.add(f"no name for others: {name}", self.naming.why_none(name))
                wire, leaves, enters = name, False, False
            cell, period = self._store.cell(name), self._period_ns(name)
            route = self._routes[name] = Route(cell, wire, leaves, enters, period)
            self._groups.setdefault(route.group, []).append((name, route))
        return route

    def usable(self, name: str) -> Route | None:
        """Return the route of a slot, or None, counted, if its record is unusable."""
        try:
            return self._routes.get(name) or self.get(name)
        except Refused as refused:
            self._refusals.add(f"unusable: {name}", str(refused))
            return None

    def offered_by(self, name: str) -> Route | None:
        """Return the route of a slot with a message, whose group is offered if it may leave."""
        route = self._routes.get(name) or self.usable(name)
        if route is not None and route.leaves:
            self.offered[route.group] = name.startswith(OWN)
        return route

    def in_order(self, groups: Iterable[str]) -> list[str]:
        """Return groups with those first that are about machines.

        A machine leaves its will before it commands anything; so it does on other hosts.
        """
        return sorted(groups, key=lambda group: not self.offered[group])

    def of(self, group: str) -> list[tuple[str, Route]]:
        """Return the usable routes of a group, with the slots' names: those asked for before."""
        if group != EVERY_GROUP:
            return list(self._groups.get(group, ()))
        routes = ((of.name, self.usable(of.name)) for of in self._store.board.slots())
        return [(name, route) for name, route in routes if route is not None]
