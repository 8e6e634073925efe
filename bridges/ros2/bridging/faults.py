"""Tells what goes wrong in a link: each kind once, all of them counted."""

from __future__ import annotations

import threading
from collections.abc import Callable

from llfsm.whiteboard.errors import MessageTooLargeError, WhiteboardError

from ..errors import Ros2Error
from ..telling import Teller
from ..transport import Notice, NoticeKind
from .tally import Link

__all__ = ["Faults"]


class Faults:
    """Gives notices of links to the function that a transport gives its own to."""

    def __init__(self, notify: Callable[[Notice], None]) -> None:
        self._teller = Teller(notify)
        self._lock = threading.Lock()

    def tell(self, link: Link, error: Exception) -> None:
        """Count a failure, and tell it if it is the link's first of its kind."""
        with self._lock:
            link.failed += 1
        if not isinstance(error, Ros2Error | WhiteboardError):
            self._teller.callback_failed(link.name, error)
            return
        text = f"{error}; more of this is only counted"
        if isinstance(error, MessageTooLargeError):
            text = f"{error} (`capacity` makes a new slot larger); more of this is only counted"
        self.say(link, text, type(error).__name__)

    def say(self, link: Link, text: str, kind: str) -> None:
        """Tell something of a link, the first time for this kind."""
        text = f"slot {link.slot}: {text}"
        self._teller.once(NoticeKind.BAD_MESSAGE, link.name, text, about=f"{link} {kind}")
