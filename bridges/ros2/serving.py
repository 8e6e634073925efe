"""Requests that wait for their answer, whatever carries them."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from .errors import AlreadyAnsweredError, CdrError
from .telling import Teller
from .transport import MessageInfo, Request
from .types import RosMessage, RosService

__all__ = ["Counter", "WayBack"]


class WayBack(Protocol):
    """How an answer reaches who asked. Exactly one of these is called, at most once."""

    def answer(self, data: bytes) -> None:
        """Send a response, as CDR."""

    def fail(self, reason: str) -> None:
        """Say that there is none."""


class Counter:
    """Takes a server's requests in, and remembers those that are open."""

    def __init__(
        self,
        name: str,
        of: RosService,
        handler: Callable[[Request[Any, Any]], None],
        teller: Teller,
    ) -> None:
        self._name = name
        self._of = of
        self._handler = handler
        self._teller = teller
        self._open: weakref.WeakSet[_Request] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._closed = False

    def take(self, data: bytes, info: MessageInfo | None, back: WayBack) -> None:
        """Have a request handled. ``info`` is None if it came without."""
        try:
            if info is None:
                raise CdrError("a request without the attachment of ROS 2")
            message = self._of.request.decode(data)
        except CdrError as error:
            self._teller.bad_message(self._name, error)
            back.fail(str(error))
            return
        request = _Request(self._name, message, info, self._of.response, back)
        with self._lock:
            if self._closed:
                back.fail("the server is closed")
                return
            self._open.add(request)
        try:
            self._handler(request)
        except Exception as error:
            self._teller.callback_failed(self._name, error)
            request.fail_if_open(f"the server failed: {error}")

    def close(self) -> None:
        """Take no more, and fail what is open."""
        with self._lock:
            self._closed = True
            still_open = list(self._open)
        for request in still_open:
            request.fail_if_open("the server was closed")


class _Request(Request[Any, Any]):
    def __init__(
        self,
        service: str,
        message: Any,
        info: MessageInfo,
        response: RosMessage[Any],
        back: WayBack,
    ) -> None:
        self.message = message
        self.info = info
        self._service = service
        self._response = response
        self._back: WayBack | None = back
        self._taking = threading.Lock()

    def answer(self, response: Any) -> None:
        data = self._response.encode(response)
        self._take_back().answer(data)

    def fail(self, reason: str) -> None:
        self._take_back().fail(reason)

    def fail_if_open(self, reason: str) -> None:
        with suppress(AlreadyAnsweredError):
            self.fail(reason)

    def _take_back(self) -> WayBack:
        with self._taking:
            back, self._back = self._back, None
        if back is None:
            raise AlreadyAnsweredError(f"this request of {self._service} has its answer")
        return back

    def __del__(self) -> None:
        # Others may still find it (a weak reference lives until this returns): take turns.
        self.fail_if_open("the server gave no answer")
