"""A callback that is told of what is added to a slot: PUSH, for those who must."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Generic, Self

from .board import BoundSlot, Sample
from .errors import BoardClosedError, MessageUnreadableError
from .feed import Backlog, Feed
from .message import M

__all__ = ["Subscription"]

_log = logging.getLogger(__name__)


class Subscription(Generic[M]):
    """Call back in a thread of its own, until closed; see :meth:`.BoundSlot.subscribe`."""

    def __init__(
        self,
        slot: BoundSlot[M],
        callback: Callable[[Sample[M]], object],
        *,
        after: int | None,
        backlog: int,
        on_error: Callable[[Exception], object] | None,
    ) -> None:
        self._slot = slot
        self._callback = callback
        self._on_error = on_error
        self._over = False
        feed = Feed(slot, after)
        # With a backlog of one, the slot itself is it.
        self._source = feed if backlog == 1 else Backlog(feed, backlog)
        self._thread = threading.Thread(target=self._run, name=f"{self}", daemon=True)
        self._thread.start()

    def __repr__(self) -> str:
        return f"subscription of {getattr(self._callback, '__qualname__', self._callback)}"

    @property
    def missed(self) -> int:
        """Messages added since the beginning that the callback was not, and will not be, told."""
        return self._source.missed

    @property
    def active(self) -> bool:
        """False once the subscription was closed, or has ended with its board."""
        return not self._over and self._thread.is_alive()

    def close(self) -> None:
        """End the subscription; closing twice is fine.

        Once this returns the callback does not run and will not be called again, except that the
        callback itself may call this: then the call that it is in is the last one. It waits for a
        callback that runs, so hold no lock that the callback takes.
        """
        self._over = True
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        try:
            while not self._over:
                try:
                    sample = self._source.next()
                except MessageUnreadableError as error:
                    self._report(error)
                    continue
                if sample is not None and not self._over:
                    self._tell(sample)
        except BoardClosedError:
            pass
        except Exception as error:
            self._report(error)
        finally:
            if isinstance(self._source, Backlog):
                self._source.stop()
                self._source.join()

    def _tell(self, sample: Sample[M]) -> None:
        try:
            self._callback(sample)
        except Exception as error:
            # What a board that was closed meanwhile refuses is the end, and no error.
            if not (isinstance(error, BoardClosedError) and self._is_board_closed()):
                self._report(error)

    def _is_board_closed(self) -> bool:
        try:
            self._slot.count  # noqa: B018  asked for what it raises
        except BoardClosedError:
            return True
        return False

    def _report(self, error: Exception) -> None:
        _log.error("%s: %s: %s", self, type(error).__name__, error, exc_info=error)
        if self._on_error is not None:
            try:
                self._on_error(error)
            except Exception:
                _log.exception("%s: its on_error failed, too", self)
