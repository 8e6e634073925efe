"""A board of other hosts, for a process without shared memory or without a daemon on its host."""

from __future__ import annotations

import atexit
import threading
from collections.abc import Sequence

from llfsm.whiteboard.errors import BoardClosedError, NetworkError
from llfsm.whiteboard.local import LocalBoard
from llfsm.whiteboard.mirror.mirror import Mirror
from llfsm.whiteboard.mirror.settings import Settings
from llfsm.whiteboard.mirror.store import VersionLog

_TIMEOUT_S = 5.0


class RemoteBoard(LocalBoard):
    """A whiteboard that daemons on other hosts mirror, kept up to date in this process.

    Reading costs as much as on a local board. A message added here is on the other hosts' boards
    soon after, mostly within 10 ms and a network's delay; counts and stamps are this process's.

    The arguments are those of :meth:`.Whiteboard.connect`, which makes it.
    """

    def __init__(
        self,
        endpoint: str,
        name: str,
        zenoh: str | None = None,
        as_: str = "",
        fleet: Sequence[str] = (),
    ) -> None:
        super().__init__(name)
        try:
            settings = Settings(
                listen=(), connect=(endpoint,), zenoh=zenoh, as_=as_, fleet=tuple(fleet)
            )
        except ValueError as error:
            raise NetworkError(str(error)) from error
        self._mirror = Mirror(self, settings, VersionLog(), mode="client")
        self._thread = threading.Thread(target=self._run, name=f"mirror {name}", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # Zenoh's threads must not outlive the interpreter
        if not self._mirror.wait_for_reply(_TIMEOUT_S):
            refusals = "".join(f"; refused: {what}" for what in self._mirror.refusals())
            self.close()
            raise NetworkError(
                f"{endpoint}: no answer for the whiteboard {name!r}; start `llfsm whiteboard "
                f"daemon` there, with an endpoint that is reachable from this host{refusals}"
            )

    def _run(self) -> None:
        try:
            self._mirror.run()
        except BoardClosedError:  # closed twice at the same time
            return

    def close(self) -> None:
        """Send what is left and release the board; its messages stay for the other hosts."""
        if self.alive:
            atexit.unregister(self.close)
            self._mirror.stop()
            self.wake_watchers()
            self._thread.join()
            super().close()
            self._mirror.close()
