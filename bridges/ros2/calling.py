"""Calls that wait for their response, whatever carries them."""

from __future__ import annotations

from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from typing import Any

from .errors import CallFailedError, CallTimeoutError, CdrError, NoServerError, TransportClosedError
from .telling import Teller
from .types import RosMessage

__all__ = ["Calls"]


class Calls:
    """A client's calls; each ends in the first way that is told."""

    def __init__(self, service: str, response: RosMessage[Any], teller: Teller) -> None:
        self._service = service
        self._decode = response.decode
        self._teller = teller
        self._pending: set[Future[Any]] = set()

    def begin(self) -> Future[Any]:
        """Return the future of a new call."""
        call: Future[Any] = Future()
        self._pending.add(call)
        call.add_done_callback(self._pending.discard)
        return call

    def answered(self, call: Future[Any], data: bytes) -> None:
        """End a call with its response."""
        try:
            response = self._decode(data)
        except CdrError as error:
            self._teller.bad_message(self._service, error)
            _end(call, error)
        else:
            with suppress(InvalidStateError):
                call.set_result(response)

    def failed(self, call: Future[Any], reason: str) -> None:
        """End a call that the server refused, or cannot answer any more."""
        _end(call, CallFailedError(f"{self._service}: {reason}"))

    def timed_out(self, call: Future[Any]) -> None:
        """End a call that took too long."""
        _end(call, CallTimeoutError(f"{self._service}: no answer in time"))

    def unserved(self, call: Future[Any], reason: str) -> None:
        """End a call that nobody got."""
        _end(call, NoServerError(reason))

    def close(self) -> None:
        """End all calls that are open."""
        for call in list(self._pending):
            _end(
                call,
                TransportClosedError(f"{self._service}: the client was closed before an answer"),
            )


def _end(call: Future[Any], error: Exception) -> None:
    with suppress(InvalidStateError):  # it has ended already, or was cancelled
        call.set_exception(error)
