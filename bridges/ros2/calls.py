"""Calls and requests that wait for their response, whatever carries them.

A call may end in several ways at once: a response, a timeout, the loss of the server, the close of
the client, ``cancel``. The first one ends it, and the others find it ended. Each of the two ends
keeps only what is open:

* a client the futures of its calls; done futures leave by themselves;
* a server weak references to its requests: one that its handler drops without an answer is
  collected, and fails at that moment instead of leaving the caller to its timeout.
"""

from __future__ import annotations

import logging
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from llfsm.bridges.ros2.errors import (
    AlreadyAnsweredError,
    CallFailedError,
    CallTimeoutError,
    CdrError,
    NoServerError,
    TransportClosedError,
)
from llfsm.bridges.ros2.threads import Put
from llfsm.bridges.ros2.transport import Handler, MessageInfo, Notifier, ServiceRequest
from llfsm.bridges.ros2.types import RosMessage, RosService

_LOG = logging.getLogger("llfsm.bridges.ros2")


def through(put: Put, handle: Handler) -> Handler:
    """Make a server's handler that queues requests for ``handle``; an error fails the request."""

    def work(request: ServiceRequest[Any, Any]) -> None:
        try:
            handle(request)
        except Exception as error:
            with suppress(AlreadyAnsweredError):
                request.fail(f"the server failed: {error}")
            raise

    return lambda request: put(partial(work, request))


def answering(of: RosService, respond: Callable[[Any], dict[str, Any]]) -> Handler:
    """Make a server's handler that answers with the fields that ``respond`` returns."""
    response = of.response.message
    return lambda request: request.answer(response(**respond(request.message)))


class PendingCalls:
    """A client's open calls. Of the methods that take a call, the first one called ends it."""

    def __init__(self, service: str, response: RosMessage[Any], notifier: Notifier) -> None:
        self._service = service
        self._decode = response.decode
        self._notifier = notifier
        self._pending: set[Future[Any]] = set()

    def begin(self) -> Future[Any]:
        """Open a call; return its future."""
        call: Future[Any] = Future()
        self._pending.add(call)
        call.add_done_callback(self._pending.discard)
        return call

    def answered(self, call: Future[Any], data: bytes) -> None:
        """End a call with its response."""
        try:
            response = self._decode(data)
        except CdrError as error:
            self._notifier.bad_message(self._service, error)
            _end(call, error)
        else:
            with suppress(InvalidStateError):
                call.set_result(response)

    def failed(self, call: Future[Any], reason: str) -> None:
        """End a call that the server refused or can no longer answer."""
        _end(call, CallFailedError(f"{self._service}: {reason}"))

    def timed_out(self, call: Future[Any]) -> None:
        """End a call that took too long."""
        _end(call, CallTimeoutError(f"{self._service}: no answer in time"))

    def unserved(self, call: Future[Any], reason: str) -> None:
        """End a call that reached no server."""
        _end(call, NoServerError(reason))

    def close(self) -> None:
        """End all open calls."""
        why = f"{self._service}: the client was closed before an answer"
        for call in list(self._pending):
            _end(call, TransportClosedError(why))


def _end(call: Future[Any], error: Exception) -> None:
    with suppress(InvalidStateError):  # it has ended already, or was cancelled
        call.set_exception(error)


class Responder(Protocol):
    """Sends the response to the caller. At most one of its methods is called, once."""

    def answer(self, data: bytes) -> None:
        """Send a response, as CDR."""

    def fail(self, reason: str) -> None:
        """Let the caller know that there is no response."""


class PendingRequests:
    """Passes requests to a server's handler, and keeps those that are open."""

    def __init__(self, name: str, of: RosService, handler: Handler, notifier: Notifier) -> None:
        self._name = name
        self._decode = of.request.decode
        self._encode = of.response.encode
        self._handler = handler
        self._notifier = notifier
        self._open: weakref.WeakSet[_Request] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._closed = False

    def take(self, data: bytes, info: MessageInfo | None, back: Responder) -> None:
        """Decode a request and pass it on; ``info`` is None if it came without metadata."""
        try:
            if info is None:
                raise CdrError("a request without the attachment of ROS 2")
            message = self._decode(data)
        except CdrError as error:
            self._notifier.bad_message(self._name, error)
            back.fail(str(error))
            return
        request = _Request(self._name, message, info, self._encode, back)
        with self._lock:
            if self._closed:
                back.fail("the server is closed")
                return
            self._open.add(request)
        try:
            self._handler(request)
        except Exception as error:
            self._notifier.callback_failed(self._name, error)
            request.fail_if_open(f"the server failed: {error}")

    def close(self) -> None:
        """Accept no more requests, and fail the open ones."""
        with self._lock:
            self._closed = True
            still_open = list(self._open)
        for request in still_open:
            request.fail_if_open("the server was closed")


@dataclass(eq=False)
class _Request(ServiceRequest[Any, Any]):
    service: str
    message: Any
    info: MessageInfo
    encode: Callable[[Any], bytes]
    back: Responder | None
    taking: threading.Lock = field(default_factory=threading.Lock)

    def answer(self, response: Any) -> None:
        data = self.encode(response)
        self._take_back().answer(data)

    def fail(self, reason: str) -> None:
        self._take_back().fail(reason)

    def fail_if_open(self, reason: str) -> None:
        with suppress(AlreadyAnsweredError):
            self.fail(reason)

    def _take_back(self) -> Responder:
        with self.taking:
            back, self.back = self.back, None
        if back is None:
            raise AlreadyAnsweredError(f"this request of {self.service} is already answered")
        return back

    def __del__(self) -> None:
        # Others may still find it (a weak reference lives until this returns): take turns.
        self.fail_if_open("the server gave no answer")
