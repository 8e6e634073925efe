"""A link between the board and ROS: its counts of messages, and its faults."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from llfsm.bridges.ros2.actions import ActionClient
from llfsm.bridges.ros2.errors import Ros2Error
from llfsm.bridges.ros2.transport import (
    Client,
    Notice,
    NoticeKind,
    Notifier,
    Publisher,
    TopicSubscription,
)
from llfsm.whiteboard.errors import MessageTooLargeError, WhiteboardError


class BridgeLink:
    """One direction of a relay, or a service: its two ends and its counts.

    One thread counts; any thread may read.
    """

    def __init__(self, slot: str, arrow: str, name: str, type_name: str) -> None:
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


class LinkFaults:
    """Counts the faults of links, and reports each kind once, as a transport reports notices."""

    def __init__(self, notify: Callable[[Notice], None]) -> None:
        self._notifier = Notifier(notify)
        self._lock = threading.Lock()

    def count(self, link: BridgeLink, error: Exception) -> None:
        """Count a failure, and report it if it is the link's first of its kind."""
        with self._lock:
            link.failed += 1
        if not isinstance(error, Ros2Error | WhiteboardError):
            self._notifier.callback_failed(link.name, error)
            return
        text = f"{error}; further ones are only counted"
        if isinstance(error, MessageTooLargeError):
            text = f"{error} (`capacity` makes a new slot larger); further ones are only counted"
        self.report(link, text, type(error).__name__)

    def report(self, link: BridgeLink, text: str, kind: str) -> None:
        """Report a fault of a link, the first time for this kind."""
        text = f"slot {link.slot}: {text}"
        self._notifier.once(NoticeKind.BAD_MESSAGE, link.name, text, about=f"{link} {kind}")
