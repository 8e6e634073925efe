"""Tells what happens to a transport outside any call, and each fault once."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import TypeVar

from .errors import CdrError
from .graph import Endpoint, qos_conflict, type_conflict
from .transport import Notice, NoticeKind

__all__ = ["Notifier", "log_notice"]

T = TypeVar("T")

_LOG = logging.getLogger("llfsm.bridges.ros2")


def log_notice(notice: Notice) -> None:
    """Log a notice as a warning (coming up again: as information)."""
    level = logging.INFO if notice.kind is NoticeKind.UP else logging.WARNING
    _LOG.log(level, "%s", ": ".join(part for part in (notice.name, notice.text) if part))


class Notifier:
    """Gives notices to the function that a transport was opened with.

    That function cannot break a transport: what it raises is logged.
    """

    def __init__(self, notify: Callable[[Notice], None]) -> None:
        self._notify = notify
        self._reported: set[tuple[NoticeKind, str, str]] = set()
        self._lock = threading.Lock()

    def notify(self, kind: NoticeKind, text: str, name: str = "") -> None:
        """Tell something that is news each time."""
        try:
            self._notify(Notice(kind, name, text))
        except Exception:
            _LOG.exception("a function that gets notices failed")

    def once(self, kind: NoticeKind, name: str, text: str, about: str = "") -> None:
        """Tell something that is news only the first time for this name and what it is about."""
        with self._lock:
            if (kind, name, about) in self._reported:
                return
            self._reported.add((kind, name, about))
        self.notify(kind, text, name)

    def bad_message(self, name: str, error: object) -> None:
        """Tell that what arrived could not be decoded."""
        self.once(NoticeKind.BAD_MESSAGE, name, f"{error}; further ones are dropped silently")

    def callback_failed(self, name: str, error: Exception) -> None:
        """Tell that a callback raised ``error``; its traceback is logged each time."""
        _LOG.error("%s: a callback failed", name, exc_info=error)
        self.once(NoticeKind.CALLBACK_FAILED, name, f"a callback failed: {error!r}")

    def deliver(self, name: str, callback: Callable[[T], None], thing: T) -> None:
        """Call a callback, and tell what it raises."""
        try:
            callback(thing)
        except CdrError as error:
            self.bad_message(name, error)
        except Exception as error:
            self.callback_failed(name, error)

    def compare(self, ours: Endpoint, theirs: Endpoint) -> None:
        """Tell, once, why two endpoints of one name do not fit each other."""
        if theirs.role not in (ours.role, ours.role.partner):
            return  # a topic and a service, which may have one name
        for kind, conflict in (
            (NoticeKind.TYPE_MISMATCH, type_conflict(ours, theirs)),
            (NoticeKind.QOS_MISMATCH, qos_conflict(ours, theirs)),
        ):
            if conflict:
                self.once(kind, ours.name, conflict, about=conflict)
