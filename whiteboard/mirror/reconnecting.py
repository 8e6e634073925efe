"""Links to hosts that were found through others, made again after they broke.

A peer of Zenoh connects again to the endpoints that it is configured to connect to, and to no
others. Two hosts that met through a third one stay apart once their link is broken: the third has
nothing new to report about either. So whoever had connected to the other introduces the two: a
session that lives for a moment connects to both. As it is new to both, each learns from it where
the other listens, and connects as it did at first. No link that stands is touched.

The other host is introduced only once it listens: until then, a connection of TCP is tried about
once a second. One that refuses these for a minute has ended. If it starts again, it is found as all
new hosts are.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass, field
from threading import Condition, Thread
from typing import TYPE_CHECKING

from llfsm.whiteboard.errors import WhiteboardError
from llfsm.whiteboard.mirror.zenoh_internals import port_of

if TYPE_CHECKING:
    import zenoh

_SETTLE_S = 0.1  # after which a session's links are those that it still has
_INTERVAL_S = 1.0
_PROBE_S = 1.0
_INTRODUCTION_S = 2.0
_LONGEST_S = 30.0  # between introductions that come to nothing
_ENDED_S = 60.0
_MAX_LOST = 1000  # hosts; of more, those that were lost last
_PROBED_A_SECOND = 100
_NOBODY: dict[str, list[str]] = {"router": [], "peer": [], "client": []}
_log = logging.getLogger("llfsm.mirror")


@dataclass
class _Lost:
    """A host whose link broke: where it listens, and when it is tried next."""

    endpoint: str
    since_s: float
    is_sure: bool = False
    """False until its session is known to have no other link."""
    refused_s: float | None = None  # since when it refuses connections
    due_s: float = 0.0
    pause_s: float = field(default=_INTERVAL_S)  # after the next introduction


class Reconnector:
    """Makes the links of a session again that its configuration does not.

    `copy` makes a configuration like the session's; `listens` and `connects` are its endpoints.
    `linked` returns the ids of the sessions with which it has a link.
    """

    def __init__(
        self,
        copy: Callable[[], zenoh.Config],
        listens: Iterable[str],
        connects: Iterable[str],
        linked: Callable[[], set[str]],
    ):
        self._copy = copy
        self._linked = linked
        self._own = [_reached_here(endpoint) for endpoint in listens]
        self._ports = {port_of(endpoint) for endpoint in self._own}
        self._configured = {_plain(endpoint) for endpoint in connects}
        self._endpoints: dict[str, str] = {}  # by the ids of sessions
        self._lost: dict[str, _Lost] = {}
        self._closed = False
        self._changed = Condition()
        self._thread: Thread | None = None

    def add(self, link: zenoh.Link) -> None:
        """Note a link that was made."""
        zid, ends = str(link.zid), (str(link.src), str(link.dst))
        with self._changed:
            has_connected = port_of(ends[0]) not in self._ports  # else the other one has
            if self._own and has_connected and _plain(ends[1]) not in self._configured:
                self._endpoints[zid] = _plain(ends[1])
            lost = self._lost.pop(zid, None)
            for other in [o for o, its in self._lost.items() if its.endpoint == _plain(ends[1])]:
                del self._lost[other], self._endpoints[other]  # it has started again
            self._changed.notify()
        if lost is not None and lost.is_sure:
            _log.warning(
                "connected again to %s, after %.1f s",
                lost.endpoint,
                time.monotonic() - lost.since_s,
            )

    def remove(self, link: zenoh.Link) -> None:
        """Note a link that broke; make it again if it was the last one, and nobody else does."""
        zid, now_s = str(link.zid), time.monotonic()
        with self._changed:
            endpoint = self._endpoints.get(zid)
            if zid in self._lost or endpoint is None or self._closed:
                return
            self._lost[zid] = _Lost(endpoint, now_s, due_s=now_s + _SETTLE_S)
            if len(self._lost) > _MAX_LOST:
                del self._endpoints[first := next(iter(self._lost))], self._lost[first]
            if self._thread is None:
                self._thread = Thread(target=self._run, name="mirror reconnect", daemon=True)
                self._thread.start()
            self._changed.notify()

    @property
    def lost(self) -> tuple[str, ...]:
        """Where the hosts listen to which this one has no link, though it had connected."""
        with self._changed:
            return tuple(lost.endpoint for lost in self._lost.values())

    @property
    def refusing(self) -> tuple[str, ...]:
        """Those of them that refuse connections: their daemons have ended, or are not ready."""
        with self._changed:
            found = [lost for lost in self._lost.values() if lost.refused_s is not None]
            return tuple(lost.endpoint for lost in found)

    def _run(self) -> None:
        import zenoh

        while (due := self._wait()) is not None:
            try:
                listening = self._probe(self._without_link(due))
                if listening:
                    self._introduce(listening)
            except (OSError, WhiteboardError, zenoh.ZError) as error:  # too many files, for example
                _log.debug("no connection is made again for now: %s", error)

    def _wait(self) -> dict[str, _Lost] | None:
        """Wait until hosts are due, and return them; None at the end."""
        with self._changed:
            while not self._closed:
                now_s = time.monotonic()
                due = {z: lost for z, lost in self._lost.items() if lost.due_s <= now_s}
                if due:
                    for lost in due.values():
                        lost.due_s = now_s + max(_INTERVAL_S, len(self._lost) / _PROBED_A_SECOND)
                    return due
                next_s = min((lost.due_s for lost in self._lost.values()), default=None)
                self._changed.wait(None if next_s is None else next_s - now_s)
        return None

    def _without_link(self, due: dict[str, _Lost]) -> dict[str, _Lost]:
        """Leave out the hosts with which there is another link, and log what is lost."""
        linked = self._linked()
        with self._changed:
            for zid in due.keys() & linked:
                self._lost.pop(zid, None)
            left = {zid: lost for zid, lost in due.items() if zid in self._lost}
        for lost in left.values():
            if not lost.is_sure:
                lost.is_sure = True
                _log.warning("lost the connection to %s; trying to make it again", lost.endpoint)
        return left

    def _probe(self, due: dict[str, _Lost]) -> dict[str, _Lost]:
        """Find out which of the hosts that are due listen, and forget those that have ended."""
        import asyncio  # which only a broken link needs

        async def probe_all() -> list[bool | None]:
            return await asyncio.gather(*(_listens(lost.endpoint) for lost in due.values()))

        found = dict(zip(due, asyncio.run(probe_all()), strict=True))
        with self._changed:
            now_s = time.monotonic()
            for zid, lost in due.items():
                if found[zid] is not False:
                    lost.refused_s = None
                elif lost.refused_s is None:
                    lost.refused_s = now_s
                elif now_s - lost.refused_s > _ENDED_S:
                    self._lost.pop(zid, None)
                    self._endpoints.pop(zid, None)
            return {zid: lost for zid, lost in due.items() if found[zid] and zid in self._lost}

    def _introduce(self, hosts: dict[str, _Lost]) -> None:
        """Let a session that connects to them and to this host introduce them to each other."""
        import zenoh

        config = self._copy()
        endpoints = [self._own[0], *dict.fromkeys(lost.endpoint for lost in hosts.values())]
        for key, value in (
            ("mode", "peer"),
            ("listen/endpoints", []),
            ("connect/endpoints", endpoints),
            ("connect/exit_on_failure", False),
            ("scouting/multicast/enabled", False),
            ("scouting/gossip/autoconnect", _NOBODY),
            # Nothing but where hosts listen passes through it, and each checks the other's name.
            ("transport/link/tls/verify_name_on_connect", False),
        ):
            config.insert_json5(key, json.dumps(value))
        with closing(zenoh.open(config)), self._changed:
            self._changed.wait_for(
                lambda: self._closed or not hosts.keys() & self._lost.keys(), _INTRODUCTION_S
            )
        with self._changed:
            for zid in hosts.keys() & self._lost.keys():
                lost = self._lost[zid]
                lost.due_s = time.monotonic() + lost.pause_s
                lost.pause_s = min(2 * lost.pause_s, _LONGEST_S)

    def close(self) -> None:
        """Make no more links."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()


async def _listens(endpoint: str) -> bool | None:
    """Check that a host listens: None if that is not known, as it cannot be reached."""
    import asyncio

    protocol, _, where = endpoint.partition("/")
    if protocol != "tcp":  # which would report a refused connection; the introduction finds out
        return True
    address = where.rpartition(":")[0].strip("[]")
    try:
        opening = asyncio.open_connection(address, port_of(endpoint))
        _, writer = await asyncio.wait_for(opening, _PROBE_S)
    except ConnectionRefusedError:
        return False
    except (TimeoutError, OSError):
        return None
    writer.transport.abort()
    return True


def _plain(endpoint: str) -> str:
    """Return an endpoint without its options."""
    return endpoint.partition("?")[0].partition("#")[0]


def _reached_here(endpoint: str) -> str:
    """Return the endpoint by which this host reaches itself."""
    return endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
