"""What an exchange hands to the network: for whom it is, and the bytes."""

from __future__ import annotations

from typing import NamedTuple

from .peers import Source

__all__ = ["EVERY_HOST", "Packet", "Query"]

EVERY_HOST = Source("", -1)
"""In place of a host: all of them."""


class Packet(NamedTuple):
    """A batch or a heartbeat for all that read a group."""

    group: str
    data: bytes


class Query(NamedTuple):
    """A query to another host, or to all that have slots of a group."""

    source: Source
    gaps: int  # of that host; passed back at the end of the reply
    data: bytes
