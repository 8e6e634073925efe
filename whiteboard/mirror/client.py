"""A board of other hosts, for a process without shared memory or a daemon beside it."""

from __future__ import annotations

import atexit
import threading

from ..errors import BoardClosedError, NetworkError
from ..local import LocalBoard
from .journal import NoJournal
from .mirror import Mirror
from .settings import Settings

__all__ = ["RemoteBoard"]

_PATIENCE_S = 5.0


class RemoteBoard(LocalBoard):
    """A whiteboard that daemons of other hosts mirror, kept up to date in this process.

    Reading costs what it costs on a local board. What is added here is on the others' boards soon
    after; a message's count and stamp are those of this process.

    Args:
        endpoint: where a daemon listens, in Zenoh's words: ``tcp/robot:7447``.
        name: the board's.
        zenoh: a file of Zenoh's configuration, for TLS.

    Raise :class:`.NetworkError` if no daemon answers there.

    """

    def __init__(self, endpoint: str, name: str, zenoh: str | None = None) -> None:
        super().__init__(name)
        settings = Settings(listen=(), connect=(endpoint,), zenoh=zenoh)
        self._mirror = Mirror(self, settings, NoJournal(), mode="client")
        self._thread = threading.Thread(target=self._run, name=f"mirror {name}", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # in time: Zenoh's threads must not outlive the interpreter
        if not self._mirror.wait_for_answer(_PATIENCE_S):
            self.close()
            raise NetworkError(
                f"{endpoint}: no answer for the whiteboard {name!r}; start "
                f"`llfsm whiteboard daemon` there, with an endpoint that is reached from here"
            )

    def _run(self) -> None:
        try:
            self._mirror.run()
        except BoardClosedError:  # by a user who has closed it twice, at once
            return

    def close(self) -> None:
        """Send what is left and let go of the board; its messages stay for the others."""
        if self.alive:
            atexit.unregister(self.close)
            self._mirror.stop()
            self.call_watchers()
            self._thread.join()
            super().close()
            self._mirror.close()
