"""The daemon that mirrors a board in shared memory: one on each host of the board."""

from __future__ import annotations

import ctypes
import logging
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from typing import TYPE_CHECKING

from llfsm.whiteboard.errors import WhiteboardError
from llfsm.whiteboard.messages.llfsm import MIRROR, MirrorStatus
from llfsm.whiteboard.mirror.keeper import Keeper
from llfsm.whiteboard.mirror.mirror import Mirror
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.store import FileVersionLog

if TYPE_CHECKING:
    from llfsm.whiteboard.shared import Whiteboard


_log = logging.getLogger("llfsm.mirror")
_TRIM_S = 30.0


@contextmanager
def daemon(board: Whiteboard, settings: Settings) -> Iterator[Mirror]:
    """Mirror the board within the context, once :meth:`.Mirror.run` is called.

    Raise :class:`.BoardMirroredError` if another daemon mirrors it, :class:`.NetworkError`, and the
    errors of a :class:`.Keeper`.
    """
    with ExitStack() as stack:
        log = FileVersionLog(board.path, lambda: [info.name for info in board.slots()])
        versions = stack.enter_context(closing(log))
        keeper = None
        if settings.keep is not None:
            keeper = stack.enter_context(closing(Keeper(settings.keep, board.name)))
        mirror = Mirror(board, settings, versions, host=versions.host, keeper=keeper)
        stack.enter_context(closing(mirror))
        notify_supervisor("READY=1")
        stack.callback(notify_supervisor, "STOPPING=1")
        yield mirror


def status_publisher(board: Whiteboard) -> Callable[[MirrorStatus], None]:
    """Make a function that publishes a status on the board, for `llfsm whiteboard status`.

    With each, it feeds the supervisor's watchdog, which restarts a daemon that publishes none, and
    from time to time, it gives memory back to the system.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", lambda _: None)  # glibc's
    due_s = 0.0

    def publish(status: MirrorStatus) -> None:
        nonlocal due_s
        notify_supervisor("WATCHDOG=1")
        if time.monotonic() >= due_s:
            due_s = time.monotonic() + _TRIM_S
            trim(0)  # hosts and names that come and go leave holes of 20 KiB each
        try:
            board.add_message(MIRROR, status)
        except WhiteboardError as error:  # mirroring goes on without
            _log.debug("the status cannot be published: %s", error)

    return publish


def notify_supervisor(state: str) -> None:
    """Notify systemd, as sd_notify(3) does, if it has started this process with ``Type=notify``."""
    address = os.environ.get("NOTIFY_SOCKET")
    if address:
        if address.startswith("@"):  # the name of a socket without a file
            address = f"\0{address[1:]}"
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
            supervisor.sendto(state.encode(), address)
