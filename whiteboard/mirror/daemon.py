"""What mirrors a board in shared memory, one for a board on each host."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from ..errors import WhiteboardError
from ..messages.llfsm import MIRROR, MirrorStatus
from ..shared import Whiteboard
from .journal import FileJournal
from .mirror import Mirror
from .refusals import logger
from .settings import Settings

__all__ = ["daemon"]


@contextmanager
def daemon(board: Whiteboard, settings: Settings) -> Iterator[Mirror]:
    """Mirror the board within the context, once :meth:`.Mirror.run` is called.

    Raise :class:`.BoardMirroredError` if another daemon does, and :class:`.NetworkError`.
    """
    journal = FileJournal(board.path)
    try:
        mirror = Mirror(board, settings, journal, host=journal.host)
        tell_supervisor("READY=1")
        try:
            yield mirror
        finally:
            tell_supervisor("STOPPING=1")
            mirror.close()
    finally:
        journal.close()


def teller(board: Whiteboard) -> Callable[[MirrorStatus], None]:
    """Return what posts how the daemon is on its board, where `llfsm whiteboard status` reads."""

    def tell(status: MirrorStatus) -> None:
        try:
            board.add_message(MIRROR, status)
        except WhiteboardError as error:  # mirroring is more than telling of it
            logger.debug("the status cannot be told: %s", error)

    return tell


def tell_supervisor(state: str) -> None:
    """Tell systemd, if it started this process with ``Type=notify``."""
    address = os.environ.get("NOTIFY_SOCKET")
    if address:
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
            supervisor.sendto(state.encode(), address.replace("@", "\0", 1))
