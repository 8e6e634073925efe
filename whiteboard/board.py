"""The interface that every whiteboard has, wherever its messages are.

A board binds slots; a bound slot is what a hot path keeps.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Self

from .errors import MessageTypeError
from .message import M
from .schema import Schema, type_from_schema
from .slots import Sample, Slot

if TYPE_CHECKING:
    from .stream import Stream
    from .subscription import Subscription

__all__ = ["Board", "BoundSlot", "SlotInfo"]


class SlotInfo(NamedTuple):
    """A slot as the board describes it."""

    name: str
    type_name: str
    schema: Schema
    capacity: int
    """Bytes of the longest encoded message."""
    problem: str = ""
    """Why nobody can use it: what some process wrote of it is damaged, or no schema. Then the
    schema is empty."""

    def slot(self) -> Slot[Any]:
        """Return the slot, with a class made from its schema.

        Raise :class:`.MessageTypeError` if there is none, :class:`.SlotNameError` for its name.
        """
        if self.problem:
            raise MessageTypeError(f"slot {self.name!r}: {self.problem}")
        return Slot(self.name, type_from_schema(self.schema), self.capacity)


class BoundSlot(ABC, Generic[M]):
    """A slot on a board: what to keep where a slot is used often."""

    __slots__ = ()

    @property
    @abstractmethod
    def count(self) -> int:
        """Messages added so far; each completed add makes it one more."""

    @property
    @abstractmethod
    def capacity(self) -> int:
        """Bytes of the longest encoded message."""

    @abstractmethod
    def add(self, message: M, /) -> int:
        """Make this the slot's latest message, without ever blocking; return its count.

        Raise :class:`.SlotTypeError` if it is not exactly of the slot's type,
        :class:`.MessageFieldError` if a field's value is not, and
        :class:`.MessageTooLargeError` if it exceeds the capacity; then nothing was added.
        """

    @abstractmethod
    def add_after(self, message: M, count: int, /) -> int:
        """Add the message if the slot's count is `count`, else return 0: someone was faster.

        So what is based on a message replaces no newer one. Raise as :meth:`add` does.
        """

    @abstractmethod
    def get(self) -> M | None:
        """Return the latest message, or None before the first.

        While no newer one was added it is the same object, at the cost of a comparison.
        """

    @abstractmethod
    def sample(self) -> Sample[M] | None:
        """Return the latest message with its count, time and writer, or None before the first."""

    @abstractmethod
    def encoded(self) -> tuple[bytes, int, int, int] | None:
        """Return what :meth:`sample` does, but the message as its bytes, and those unchecked."""

    @abstractmethod
    def wait(self, *, after: int, timeout: float | None = None) -> Sample[M] | None:
        """Block until a message newer than number ``after`` is there, and return the latest.

        ``timeout`` is in seconds, None for ever; None is returned when it has passed. Raise
        :class:`.BoardClosedError` if the board is closed or removed meanwhile.
        """

    # Every board does what follows in the same way; imported when used, as few programs do.

    def subscribe(
        self,
        callback: Callable[[Sample[M]], object],
        *,
        after: int | None = None,
        backlog: int = 1,
        on_error: Callable[[Exception], object] | None = None,
    ) -> Subscription[M]:
        """Call ``callback`` with each newer sample, in a thread of its own, until closed.

        It begins with the latest message if there is one, or with the first one newer than number
        ``after``. Writers never wait for it: while it runs, messages wait in a ``backlog`` of at
        most so many, and the oldest one makes room. With 1, the newest alone waits; with more,
        every message that could be observed does. Messages that it did not get are counted as
        ``missed``; a gap between two samples' counts shows where.

        What it raises is given to ``on_error`` and logged, unless that returns True; so is a
        message that cannot be read. The subscription goes on. It ends with the board, and does not
        keep the process alive.
        """
        from .subscription import Subscription

        return Subscription(self, callback, after=after, backlog=backlog, on_error=on_error)

    def stream(self, *, after: int | None = None, backlog: int = 1) -> Stream[M]:
        """Return an asynchronous iterator over newer samples: ``async for sample in ...``.

        ``after`` and ``backlog`` are as for :meth:`subscribe`. Needs a running event loop.
        """
        from .stream import Stream

        return Stream(self, after=after, backlog=backlog)


class _Bound(dict[Slot[Any], BoundSlot[Any]]):
    """The slots bound so far; looking up another one binds it."""

    def __init__(self, bind: Callable[[Slot[Any]], BoundSlot[Any]]) -> None:
        super().__init__()
        self._bind = bind

    def __missing__(self, slot: Slot[Any]) -> BoundSlot[Any]:
        bound = self[slot] = self._bind(slot)
        return bound


class Board(ABC):
    """A whiteboard. Bind a slot with ``board[slot]``, or use the two methods by name."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._bound = _Bound(self._bind)

    def __getitem__(self, slot: Slot[M]) -> BoundSlot[M]:
        """Bind a slot, making it on the board if it is not there.

        Raise :class:`.SlotTypeError` if the board has it with another type.
        """
        return self._bound[slot]

    def add_message(self, slot: Slot[M], message: M) -> int:
        """Make ``message`` the slot's latest; see :meth:`BoundSlot.add`."""
        return self._bound[slot].add(message)

    def get_message(self, slot: Slot[M]) -> M | None:
        """Return the slot's latest message, or None before the first."""
        return self._bound[slot].get()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @abstractmethod
    def _bind(self, slot: Slot[M]) -> BoundSlot[M]: ...

    @abstractmethod
    def slots(self) -> list[SlotInfo]:
        """Describe the slots on the board, in the order in which they were made."""

    @abstractmethod
    def find(self, name: str) -> Slot[Any]:
        """Return the slot of that name, for those who do not have its class.

        Raise :class:`.SlotNotFoundError`.
        """

    @abstractmethod
    def watcher(self) -> Callable[[float], list[str]]:
        """Return a function that waits, so many seconds at most, until any slot has news.

        It returns the names of the slots with messages added since it was called last.
        """

    @property
    @abstractmethod
    def alive(self) -> bool:
        """False once the board is closed here or removed by anybody."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the board; its messages stay for other processes. Closing twice is fine."""

    @abstractmethod
    def remove(self) -> None:
        """Remove the board for everybody: who has it open sees ``alive`` become False."""
