"""An asynchronous iterator over the messages added to a slot."""

from __future__ import annotations

import asyncio
import weakref
from typing import Generic, Self

from .errors import BoardClosedError
from .message import M
from .slots import Sample
from .subscription import Backlog, Cursor, Waitable

__all__ = ["Stream"]


class Stream(Generic[M]):
    """Iterates over a slot's samples in the running event loop; see :meth:`.BoundSlot.stream`.

    A thread waits for messages, and wakes the loop only if all earlier ones were taken. It ends
    with the stream: at :meth:`aclose`, when there is no reference to the stream any more, with
    the board, or with the loop.
    """

    def __init__(self, slot: Waitable[M], *, after: int | None, backlog: int) -> None:
        loop = asyncio.get_running_loop()
        arrived = self._arrived = asyncio.Event()

        # The thread refers to this function, which therefore must not refer to the stream.
        def wake(kept: Backlog[M]) -> None:
            try:
                loop.call_soon_threadsafe(arrived.set)
            except RuntimeError:  # the loop was closed
                kept.stop()

        self._backlog = Backlog(Cursor(slot, after), backlog, wake)
        weakref.finalize(self, self._backlog.stop)

    @property
    def missed(self) -> int:
        """The number of messages that the iteration did not, and will not, return."""
        return self._backlog.missed

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Sample[M]:
        """Wait for a sample. If the wait is cancelled, no sample is lost.

        Raise :class:`.MessageUnreadableError` for a message that cannot be decoded; the iteration
        may continue.
        """
        try:
            while (sample := self._backlog.take()) is None:
                self._arrived.clear()  # not too late: a wake-up is a call in this loop
                await self._arrived.wait()
        except BoardClosedError:
            raise StopAsyncIteration from None
        return sample

    async def aclose(self) -> None:
        """End the iteration and its thread; closing twice is fine."""
        self._backlog.stop()
        while not self._backlog.ended:
            self._arrived.clear()
            await self._arrived.wait()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.aclose()
