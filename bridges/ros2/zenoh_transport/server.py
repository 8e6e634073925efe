"""Servers over Zenoh: queryables that answer with the number and the sender of the request."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import zenoh
import zenoh.handlers

from ..lifetime import Closable
from ..serving import Counter
from ..transport import MessageInfo, Request, Server
from ..types import RosService
from .attachment import pack, unpack
from .endpoint import Place
from .receiving import receive

__all__ = ["ZenohServer"]

_WAITING = 256  # requests that may wait for the handler; more, and who asks is held up


class ZenohServer(Server):
    """Serves a service as a queryable, on a thread of its own."""

    def __init__(
        self,
        owner: Closable,
        place: Place,
        of: RosService,
        handler: Callable[[Request[Any, Any]], None],
    ) -> None:
        super().__init__(owner)
        self.name = place.name
        self._place = place
        self._counter = Counter(place.name, of, handler, place.wire.teller)
        channel: zenoh.handlers.FifoChannel[zenoh.Query] = zenoh.handlers.FifoChannel(_WAITING)
        self._queryable = place.wire.session.declare_queryable(place.key, channel, complete=True)
        receive(self._queryable.handler.recv, self._on_query, place.name)
        place.show()

    def _on_query(self, query: zenoh.Query) -> None:
        attachment, payload = query.attachment, query.payload
        info = unpack(attachment.to_bytes()) if attachment is not None else None
        data = payload.to_bytes() if payload is not None else b""
        self._counter.take(data, info, _Reply(query, self._place.key, info))

    def _close(self) -> None:
        self._place.hide()
        self._queryable.undeclare()
        self._counter.close()


class _Reply:
    """A way back that ends the query. If who asked or the session is gone, nothing happens."""

    def __init__(self, query: zenoh.Query, key: str, info: MessageInfo | None) -> None:
        self._query = query
        self._key = key
        self._info = info

    def answer(self, data: bytes) -> None:
        assert self._info is not None
        attachment = pack(self._info.sequence, time.time_ns(), self._info.gid)
        with self._query as query, suppress(zenoh.ZError):
            query.reply(self._key, data, attachment=attachment)

    def fail(self, reason: str) -> None:
        with self._query as query, suppress(zenoh.ZError):
            query.reply_err(reason)
