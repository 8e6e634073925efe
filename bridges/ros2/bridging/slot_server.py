"""Requests of a ROS service go to a slot; an answer there is the response in ROS."""

from __future__ import annotations

import threading
import time
from queue import SimpleQueue
from typing import Any, NamedTuple

from llfsm.whiteboard import Board, BoundSlot
from llfsm.whiteboard.errors import MessageUnreadableError, WhiteboardError
from llfsm.whiteboard.subscription import POLL_S, Cursor

from ..errors import CdrError
from ..transport import ServiceRequest
from .link import BridgeLink, LinkFaults
from .service_slots import ServiceSlots

__all__ = ["SlotServer"]

_MOST = 10  # requests that may wait, the depth of ROS 2's profile for services


class _Waiting(NamedTuple):
    request: ServiceRequest[Any, Any]
    until: float


class SlotServer:
    """Posts requests one after the other, each when the one before it was answered or has failed.

    :meth:`asked` is a server's handler. A program answers by adding to the answer slot with the
    request's number; with a ``failure`` the call fails.
    """

    def __init__(
        self,
        board: Board,
        slots: ServiceSlots,
        timeout: float,
        link: BridgeLink,
        faults: LinkFaults,
    ) -> None:
        """``timeout`` is how many seconds a request may wait for its answer from its arrival."""
        self._slots = slots
        self._timeout = timeout
        self._link = link
        self._faults = faults
        self._over = threading.Event()
        self._requests: BoundSlot[Any] = board[slots.request]
        self._answers: BoundSlot[Any] = board[slots.answer]
        before = (self._requests.get(), self._answers.get())
        self._number: int = max((message.number for message in before if message), default=0)
        self._waiting: SimpleQueue[_Waiting | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=f"slot {link.slot}", daemon=True)
        self._thread.start()

    def asked(self, request: ServiceRequest[Any, Any]) -> None:
        """Queue a request."""
        if self._waiting.qsize() < _MOST:
            self._waiting.put(_Waiting(request, time.monotonic() + self._timeout))
        else:
            self._fail(request, f"{_MOST} requests are waiting already")

    def finish(self) -> None:
        """Ask for the end; open requests fail."""
        self._over.set()
        self._waiting.put(None)

    def close(self) -> None:
        """Wait for the end."""
        self._thread.join()

    def _run(self) -> None:
        while (waiting := self._waiting.get()) is not None:
            request, until = waiting
            try:
                answer = self._ask(request, until)
                if isinstance(answer, str):
                    self._fail(request, answer)
                else:
                    request.answer(self._slots.ros_response(answer))
                    self._link.count()
            except (CdrError, WhiteboardError) as error:
                self._faults.count(self._link, error)
                request.fail(str(error))

    def _ask(self, request: ServiceRequest[Any, Any], until: float) -> Any:
        """Post a request; return the answer, or the reason why there is none."""
        answers = Cursor(self._answers, after=self._answers.count)
        self._number += 1
        if time.monotonic() < until:
            self._requests.add(self._slots.asked(self._number, request.message))
        while (left := until - time.monotonic()) > 0:
            if self._over.is_set():
                return "the bridge has ended"
            try:
                sample = answers.next(min(left, POLL_S))
            except MessageUnreadableError as error:
                self._faults.count(self._link, error)
                continue
            if sample is not None and sample.message.number == self._number:
                return sample.message.failure or sample.message
        return f"no answer in slot {self._slots.answer.name} within {self._timeout:g} s"

    def _fail(self, request: ServiceRequest[Any, Any], why: str) -> None:
        self._link.failed += 1
        request.fail(why)
