"""Cycles: messages that relays would pass on for ever."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

__all__ = ["RelayEdge", "find_cycle"]


class RelayEdge(NamedTuple):
    """A relay in one of its directions."""

    relay: int
    """Its index in the configuration."""
    source: str
    target: str


class _Stop(NamedTuple):
    """A message at a place, with the relay that brought it, which does not take it back."""

    place: str
    relay: int


def find_cycle(edges: Iterable[RelayEdge]) -> tuple[int, list[str]] | None:
    """Return a relay and the places of a cycle that it is part of, or None."""
    edges = list(edges)
    harmless: set[_Stop] = set()
    for first in edges:
        found = _follow(edges, [_Stop(first.target, first.relay)], harmless)
        if found:
            return found[0].relay, [stop.place for stop in found]
    return None


def _follow(edges: list[RelayEdge], way: list[_Stop], harmless: set[_Stop]) -> list[_Stop] | None:
    here = way[-1]
    if here in harmless:
        return None
    if here in way[:-1]:
        return way[way.index(here) :]
    for edge in edges:
        if edge.source == here.place and edge.relay != here.relay:
            found = _follow(edges, [*way, _Stop(edge.target, edge.relay)], harmless)
            if found:
                return found
    harmless.add(here)
    return None
