"""Clients over Zenoh: a call is a query to all servers, and the first reply counts."""

from __future__ import annotations

import itertools
import time
from concurrent.futures import Future
from functools import partial
from typing import Any

import zenoh
import zenoh.handlers

from ..calling import Calls
from ..lifetime import Closable
from ..transport import Client
from ..types import RosService
from .attachment import pack
from .endpoint import Place
from .receiving import hand_over

__all__ = ["ZenohClient"]


class ZenohClient(Client[Any, Any]):
    """Calls a service whose servers are queryables."""

    def __init__(self, owner: Closable, place: Place, of: RosService) -> None:
        super().__init__(owner)
        self.name = place.name
        self._place = place
        self._of = of
        self._soon = place.wire.answers.soon
        self._sequence = itertools.count(1)
        self._calls = Calls(place.name, of.response, place.wire.teller)
        # It knows whether a queryable is there, which a server's token may tell too early.
        self._querier = place.wire.session.declare_querier(
            place.key, target=zenoh.QueryTarget.ALL_COMPLETE
        )
        discovery = place.wire.discovery
        self._listener: zenoh.MatchingListener[None] = self._querier.declare_matching_listener(
            hand_over(discovery.look_again, place.wire.events)
        )
        place.show()

    @property
    def ready(self) -> bool:
        """Whether a server with our type can be asked."""
        if self._closed:
            return False
        status: Any = self._querier.matching_status  # its stub says bool
        return bool(status.matching)

    def call(self, request: Any, *, timeout: float) -> Future[Any]:
        """Send a query; Zenoh watches the time."""
        data = self._of.request.encode(request)
        with self._lifetime:
            self._check_open()
            call = self._calls.begin()
        deadline = time.monotonic() + timeout
        served = self.ready

        def on_reply(reply: zenoh.Reply) -> None:
            self._soon(partial(self._on_reply, call, deadline, reply))

        def on_end() -> None:
            self._soon(partial(self._on_end, call, served))

        try:
            self._place.wire.session.get(
                self._place.key,
                zenoh.handlers.Callback(on_reply, on_end, indirect=False),  # else a thread a call
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=timeout,
                payload=data,
                attachment=pack(next(self._sequence), time.time_ns(), self._place.gid),
            )
        except zenoh.ZError as error:
            self._calls.failed(call, str(error))
        return call

    def _on_reply(self, call: Future[Any], deadline: float, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._calls.answered(call, reply.ok.payload.to_bytes())
        elif reply.err is not None:
            reason = reply.err.payload.to_bytes().decode(errors="replace")
            if reason == "Timeout" and time.monotonic() >= deadline:  # Zenoh's own reply
                self._calls.timed_out(call)
            else:
                self._calls.failed(call, reason)

    def _on_end(self, call: Future[Any], served: bool) -> None:
        """Conclude that no reply will come any more."""
        if call.done():
            return
        if served or self.ready:
            self._calls.failed(call, "the server gave no answer")
        else:
            self._calls.unserved(call, self._place.wire.discovery.why_unserved(self.name))

    def _close(self) -> None:
        self._place.hide()
        self._calls.close()
        self._listener.undeclare()
        self._querier.undeclare()

    def __str__(self) -> str:
        return f"the client of {self.name}"
