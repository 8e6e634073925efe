"""Requests in a slot become calls of a ROS service; responses go to the answer slot."""

from __future__ import annotations

from typing import Any

from llfsm.whiteboard import Board, BoundSlot, Sample
from llfsm.whiteboard.errors import WhiteboardError

from ..errors import Ros2Error
from ..transport import Client
from .link import BridgeLink, LinkFaults
from .service_slots import ServiceSlots

__all__ = ["SlotClient", "unanswered"]


class SlotClient:
    """Calls a service for the requests in a slot, one call at a time.

    A request from before the bridge started may or may not have been carried out: it is answered
    with a failure, so that nothing is done twice.
    """

    def __init__(
        self,
        board: Board,
        slots: ServiceSlots,
        client: Client[Any, Any],
        timeout: float,
        link: BridgeLink,
        faults: LinkFaults,
    ) -> None:
        self._slots = slots
        self._client = client
        self._timeout = timeout
        self._link = link
        self._faults = faults
        requests: BoundSlot[Any] = board[slots.request]
        self._answers: BoundSlot[Any] = board[slots.answer]
        self._seen = requests.count
        old = unanswered(requests, self._answers)
        if old is not None:
            self._fail(old, "it was requested before the bridge started")
        self._subscription = requests.subscribe(self._call, after=self._seen, on_error=self._failed)

    def finish(self) -> None:
        """Ask for the end."""
        self._subscription.finish()

    def close(self) -> None:
        """Wait for the end; an open call ends with its client."""
        self._client.close()
        self._subscription.close()

    def _call(self, sample: Sample[Any]) -> None:
        lost, self._seen = sample.count - self._seen - 1, sample.count
        if lost:
            text = f"{lost} of the requests were replaced by newer ones before they were sent"
            self._faults.report(self._link, text, "lost")
        number = sample.message.number
        try:
            request = self._slots.ros_request(sample.message)
            call = self._client.call(request, timeout=self._timeout)
            self._answers.add(self._slots.answered(number, call.result()))
        except (Ros2Error, WhiteboardError) as error:
            self._fail(number, str(error))
        else:
            self._link.count()

    def _fail(self, number: int, why: str) -> None:
        self._link.failed += 1
        self._answers.add(self._slots.failed(number, why))

    def _failed(self, error: Exception) -> bool:
        self._faults.count(self._link, error)
        return True


def unanswered(requests: BoundSlot[Any], answers: BoundSlot[Any]) -> int | None:
    """Return the number of the request that waits for an answer, if any."""
    request, answer = requests.get(), answers.get()
    if request is None or (answer is not None and answer.number >= request.number):
        return None
    number: int = request.number
    return number
