"""A service through slots: requests in a slot are calls in ROS, or requests of ROS go to a slot.

A slot shows one request, so both ends work at one request at a time: a client's calls are made one
after the other, a server's requests wait in a queue. What is on the slots when a bridge starts is
from another bridge, and answered with a failure, so that nothing is done twice.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, NamedTuple

from llfsm.bridges.ros2.bridging.link import BridgeLink
from llfsm.bridges.ros2.bridging.service_slots import ServiceSlots, from_slot, into_slot
from llfsm.bridges.ros2.errors import CdrError, Ros2Error
from llfsm.bridges.ros2.transport import Client, ServiceRequest
from llfsm.whiteboard import Board, BoundSlot, Sample
from llfsm.whiteboard.errors import MessageUnreadableError, WhiteboardError
from llfsm.whiteboard.subscription import POLL_S, Cursor


@dataclass(eq=False)
class SlotClient:
    """Calls a service for the requests in a slot, one call at a time.

    A request from before the bridge started may or may not have been carried out: it is answered
    with a failure, so that nothing is done twice.
    """

    board: Board
    slots: ServiceSlots
    client: Client[Any, Any]
    timeout: float
    link: BridgeLink

    def __post_init__(self) -> None:
        requests: BoundSlot[Any] = self.board[self.slots.request]
        self._answers: BoundSlot[Any] = self.board[self.slots.answer]
        self._seen = requests.count
        old = unanswered(requests, self._answers)
        if old is not None:
            self._fail(old, "it was requested before the bridge started")
        self._subscription = requests.subscribe(
            self._call, after=self._seen, on_error=self.link.count_fault
        )

    def finish(self) -> None:
        """Stop after the request that is on the slot by now."""
        self._subscription.finish()

    def close(self) -> None:
        """Wait for that; an open call ends with its client."""
        self.client.close()
        self._subscription.close()

    def _call(self, sample: Sample[Any]) -> None:
        lost, self._seen = sample.count - self._seen - 1, sample.count
        if lost:
            text = f"{lost} of the requests were replaced by newer ones before they were sent"
            self.link.report_fault(text, "lost")
        number = sample.message.number
        try:
            request = from_slot(self.slots.of.request, sample.message)
            call = self.client.call(request, timeout=self.timeout)
            self._answers.add(into_slot(self.slots.answer, number, call.result()))
        except (Ros2Error, WhiteboardError) as error:
            self._fail(number, str(error))
        else:
            self.link.count()

    def _fail(self, number: int, why: str) -> None:
        self.link.failed += 1
        self._answers.add(self.slots.failed(number, why))


def unanswered(requests: BoundSlot[Any], answers: BoundSlot[Any]) -> int | None:
    """Find the request that waits for an answer; return its number or None."""
    request, answer = requests.get(), answers.get()
    if request is None or (answer is not None and answer.number >= request.number):
        return None
    number: int = request.number
    return number


_MOST = 10  # requests that may wait, the depth of ROS 2's profile for services


class _Waiting(NamedTuple):
    request: ServiceRequest[Any, Any]
    until: float


class SlotServer:
    """Posts requests one after the other, each when the one before it was answered or has failed.

    :meth:`asked` is a server's handler. A program answers by adding to the answer slot with the
    request's number; with a ``failure`` the call fails.
    """

    def __init__(self, board: Board, slots: ServiceSlots, timeout: float, link: BridgeLink) -> None:
        """``timeout`` is how many seconds a request may wait for its answer from its arrival."""
        self._slots = slots
        self._timeout = timeout
        self._link = link
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
        """Serve no more; open requests fail."""
        self._over.set()
        self._waiting.put(None)

    def close(self) -> None:
        """Wait until they have failed."""
        self._thread.join()

    def _run(self) -> None:
        while (waiting := self._waiting.get()) is not None:
            request, until = waiting
            try:
                answer = self._ask(request, until)
                if isinstance(answer, str):
                    self._fail(request, answer)
                else:
                    request.answer(from_slot(self._slots.of.response, answer))
                    self._link.count()
            except (CdrError, WhiteboardError) as error:
                self._link.count_fault(error)
                request.fail(str(error))

    def _ask(self, request: ServiceRequest[Any, Any], until: float) -> Any:
        """Post a request; return the answer, or the reason why there is none."""
        answers = Cursor(self._answers, after=self._answers.count)
        self._number += 1
        if time.monotonic() < until:
            self._requests.add(into_slot(self._slots.request, self._number, request.message))
        while (left := until - time.monotonic()) > 0:
            if self._over.is_set():
                return "the bridge has ended"
            try:
                sample = answers.next(min(left, POLL_S))
            except MessageUnreadableError as error:
                self._link.count_fault(error)
                continue
            if sample is not None and sample.message.number == self._number:
                return sample.message.failure or sample.message
        return f"no answer in slot {self._slots.answer.name} within {self._timeout:g} s"

    def _fail(self, request: ServiceRequest[Any, Any], why: str) -> None:
        self._link.failed += 1
        request.fail(why)
