"""A link between the board and ROS: its counts of messages, and its faults."""

from __future__ import annotations

import threading
import time
from typing import Any

from llfsm.bridges.ros2.actions import ActionClient
from llfsm.bridges.ros2.errors import Ros2Error
from llfsm.bridges.ros2.transport import Client, NoticeKind, Notifier, Publisher, TopicSubscription
from llfsm.whiteboard.errors import MessageTooLargeError, WhiteboardError


class BridgeLink:
    """One direction of a relay, or a service: its two ends, its counts and its faults.

    One thread counts; any thread may read, and count faults.
    """

    def __init__(
        self, slot: str, arrow: str, name: str, type_name: str, notifier: Notifier
    ) -> None:
        self.slot = slot
        self.arrow = arrow
        self.name = name
        """The topic's or service's full name."""
        self.type_name = type_name
        self.passed = 0
        """Messages, or answered requests."""
        self.failed = 0
        """Messages that could not be passed on, or requests without an answer."""
        self.end: Publisher[Any] | TopicSubscription | None = None
        """A topic's end, if it is one."""
        self.client: Client[Any, Any] | ActionClient | None = None
        """The client of a server in ROS, if the link has one: `ready` when a server is known."""
        self._last: float | None = None
        self._notifier = notifier
        self._lock = threading.Lock()

    def __str__(self) -> str:
        return f"{self.slot} {self.arrow} {self.name}"

    def count(self) -> None:
        """Count a message that was passed on now."""
        self.passed += 1
        self._last = time.monotonic()

    @property
    def broken(self) -> int:
        """Missed deadlines and signs of life, where the middleware reports them."""
        return 0 if self.end is None else self.end.broken

    @property
    def age(self) -> float | None:
        """Seconds since the last message was passed on, or None before the first."""
        last = self._last
        return None if last is None else time.monotonic() - last

    def count_fault(self, error: Exception) -> bool:
        """Count a failure, and report it if it is the first of its kind; return True: go on."""
        with self._lock:
            self.failed += 1
        if isinstance(error, Ros2Error | WhiteboardError):
            enlarge = " (`capacity` makes a new slot larger)"
            how = enlarge if isinstance(error, MessageTooLargeError) else ""
            self.report_fault(f"{error}{how}; further ones are only counted", type(error).__name__)
        else:
            self._notifier.callback_failed(self.name, error)
        return True

    def report_fault(self, text: str, kind: str) -> None:
        """Report a fault as a transport reports notices, the first time for this kind."""
        text = f"slot {self.slot}: {text}"
        self._notifier.once(NoticeKind.BAD_MESSAGE, self.name, text, about=f"{self} {kind}")
