"""Notices: events of a transport outside any call, each fault reported once."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import TypeVar

from llfsm.bridges.ros2.errors import CdrError
from llfsm.bridges.ros2.graph import Endpoint, qos_conflict, type_conflict
from llfsm.bridges.ros2.transport import Notice, NoticeKind

T = TypeVar("T")

_LOG = logging.getLogger("llfsm.bridges.ros2")


def log_notice(notice: Notice) -> None:
    """Log a notice as a warning; :attr:`.NoticeKind.UP` as information."""
    level = logging.INFO if notice.kind is NoticeKind.UP else logging.WARNING
    _LOG.log(level, "%s", ": ".join(part for part in (notice.name, notice.text) if part))


class Notifier:
    """Passes notices to the function that a transport was opened with.

    An error of that function does not break the transport: it is logged.
    """

    def __init__(self, notify: Callable[[Notice], None]) -> None:
        self._notify = notify
        self._reported: set[tuple[NoticeKind, str, str]] = set()
        self._lock = threading.Lock()

    def notify(self, kind: NoticeKind, text: str, name: str = "") -> None:
        """Report an event each time."""
        try:
            self._notify(Notice(kind, name, text))
        except Exception:
            _LOG.exception("a function that gets notices failed")

    def once(self, kind: NoticeKind, name: str, text: str, about: str = "") -> None:
        """Report an event the first time for this kind, name and ``about``."""
        with self._lock:
            if (kind, name, about) in self._reported:
                return
            self._reported.add((kind, name, about))
        self.notify(kind, text, name)

    def bad_message(self, name: str, error: object) -> None:
        """Report that a message cannot be decoded."""
        self.once(NoticeKind.BAD_MESSAGE, name, f"{error}; further ones are dropped silently")

    def callback_failed(self, name: str, error: Exception) -> None:
        """Report that a callback raised ``error``; its traceback is logged each time."""
        _LOG.error("%s: a callback failed", name, exc_info=error)
        self.once(NoticeKind.CALLBACK_FAILED, name, f"a callback failed: {error!r}")

    def deliver(self, name: str, callback: Callable[[T], None], thing: T) -> None:
        """Call a callback, and report an error that it raises."""
        try:
            callback(thing)
        except CdrError as error:
            self.bad_message(name, error)
        except Exception as error:
            self.callback_failed(name, error)

    def compare(self, ours: Endpoint, theirs: Endpoint) -> None:
        """Report once why two endpoints of one name are incompatible."""
        if theirs.role not in (ours.role, ours.role.partner):
            return  # a topic and a service may have the same name
        for kind, conflict in (
            (NoticeKind.TYPE_MISMATCH, type_conflict(ours, theirs)),
            (NoticeKind.QOS_MISMATCH, qos_conflict(ours, theirs)),
        ):
            if conflict:
                self.once(kind, ours.name, conflict, about=conflict)
