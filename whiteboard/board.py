"""The interface of all whiteboards, wherever their messages are.

A board binds slots: a bound slot is a handle by which one process adds to the slot and reads it.
Code that uses a slot often keeps the handle, and so saves a look-up a call. The contract is
stated here, and tested on every kind of board (``tests/whiteboard/test_contract*.py``): an add
never blocks, a slot keeps its latest message only, and counts go up by one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol

from llfsm.whiteboard.closing import ClosedOnExit
from llfsm.whiteboard.errors import BoardClosedError, MessageTypeError, WhiteboardError
from llfsm.whiteboard.message import M, type_from_schema
from llfsm.whiteboard.schema import Schema
from llfsm.whiteboard.slot_names import is_users
from llfsm.whiteboard.slots import Sample, Slot

if TYPE_CHECKING:
    from llfsm.whiteboard.subscription import Stream, Subscription


_LONGEST = 200  # characters of a message in a notebook


class SlotInfo(NamedTuple):
    """A slot as its board lists it, for tools that do not have its class."""

    name: str
    type_name: str
    schema: Schema
    capacity: int
    """The longest encoded message, in bytes."""
    problem: str = ""
    """Why it is unusable (its record is damaged, or holds no valid schema), else empty. An
    unusable slot's schema is empty."""

    def slot(self) -> Slot[Any]:
        """Make the slot, with a class made from its schema.

        Raise :class:`.MessageTypeError` for an unusable schema and :class:`.SlotNameError` for an
        invalid name.
        """
        if self.problem:
            raise MessageTypeError(f"slot {self.name!r}: {self.problem}")
        return Slot(self.name, type_from_schema(self.schema), self.capacity)


class BoundSlot(ABC, Generic[M]):
    """A slot on a board; keep it where a slot is used often."""

    __slots__ = ()

    @property
    @abstractmethod
    def count(self) -> int:
        """The number of messages added so far; each completed add increments it by one."""

    @property
    @abstractmethod
    def added(self) -> int:
        """The count of the last message that was added by this handle; 0 before the first."""

    @property
    @abstractmethod
    def capacity(self) -> int:
        """The longest encoded message, in bytes."""

    @abstractmethod
    def add(self, message: M, /) -> int:
        """Make this the slot's latest message and return its count, 1 or more; never block.

        Raise :class:`.SlotTypeError` if the message is not exactly of the slot's type,
        :class:`.MessageFieldError` if a field's value is not of its type, and
        :class:`.MessageTooLargeError` if it exceeds the capacity; nothing was added then.
        """

    @abstractmethod
    def add_after(self, message: M, count: int, /) -> int:
        """Add the message if the slot's count still is `count`, else return 0.

        So a message derived from an older one never replaces a newer one. Raise as :meth:`add`
        does.
        """

    @abstractmethod
    def get(self) -> M | None:
        """Return the latest message, or None before the first.

        Until a newer one is added, this returns the same object, at the cost of a comparison.
        """

    @abstractmethod
    def sample(self) -> Sample[M] | None:
        """Return the latest message with its count, time and writer, or None before the first."""

    @abstractmethod
    def encoded(self) -> tuple[bytes, int, int, int] | None:
        """Return the latest message's bytes, not validated, its count, stamp and writer.

        None before the first. It does not count as reading; see :meth:`Board.read_slots`.
        """

    @abstractmethod
    def wait(self, *, after: int, timeout: float | None = None) -> Sample[M] | None:
        """Block until there is a message newer than number ``after``, and return the latest.

        Return None after ``timeout`` seconds; with None, wait without limit. Raise
        :class:`.BoardClosedError` if the board is closed or removed while waiting.
        """

    @abstractmethod
    def wait_count(self, *, after: int, timeout: float | None = None) -> int | None:
        """Wait as :meth:`wait` does, but return only the message's number: nothing is decoded."""

    @abstractmethod
    def reserve(self) -> None:
        """Reserve what this process needs to add, so that an add cannot find the board full.

        Raise :class:`.BoardFullError`. Without this, the first add reserves it. A handle that was
        bound without making the slot reserves nothing in one whose name was given up.
        """

    @abstractmethod
    def retire(self) -> None:
        """End adding by this handle: from now on an add raises :class:`.SlotRetiredError`.

        For a handle of one's own, of :meth:`Board.publisher`; others are shared.
        """

    def recent(self) -> list[tuple[int, int, int]]:
        """Return count, stamp and writer of the latest messages, in no order.

        Up to four of each process that adds to the slot; only the latest one on a board that is
        not in shared memory. Stamps and writers are those of :class:`.Sample`.
        """
        latest = self.encoded()
        return [] if latest is None else [latest[1:]]

    def on_add(self, callback: Callable[[int], None]) -> None:
        """Call a method with the count of each message, within the add; held by a weak reference.

        Only a board in one process can: on others nothing is called.
        """

    # The same for every board; imported when used, because few programs use them.

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
        ``after``. Writers never wait for it: while the callback runs, up to ``backlog`` messages
        are queued, and a new one replaces the oldest. With 1, only the newest is kept. Messages
        that the callback never receives are counted as ``missed``; gaps in the samples' counts
        show where.

        An exception from the callback, and a message that cannot be decoded, are passed to
        ``on_error``, and logged unless that returns True; the subscription continues. It ends with
        the board, and does not keep the process alive.
        """
        from llfsm.whiteboard.subscription import Subscription

        return Subscription(self, callback, after=after, backlog=backlog, on_error=on_error)

    def stream(self, *, after: int | None = None, backlog: int = 1) -> Stream[M]:
        """Iterate asynchronously over newer samples: ``async for sample in bound.stream()``.

        ``after`` and ``backlog`` are as in :meth:`subscribe`. Needs a running event loop.
        """
        from llfsm.whiteboard.subscription import Stream

        return Stream(self, after=after, backlog=backlog)


class Waiter(Protocol):
    """Waits for new messages in any of several slots; see :meth:`Board.waiter`."""

    def wait(self, seen: dict[BoundSlot[Any], int], timeout: float) -> list[BoundSlot[Any]]:
        """Block until a slot has a message newer than its number; return all slots that have.

        Their numbers in ``seen`` become those of the newest messages. Return none after
        ``timeout`` seconds, and at a :meth:`wake`. Raise :class:`.BoardClosedError` if the board
        is closed, or was removed and there is no message.
        """

    def doze(
        self,
        seen: dict[BoundSlot[Any], int],
        own: tuple[tuple[BoundSlot[Any], BoundSlot[Any]], ...],
        duration_ns: int,
        until_ns: int,
        otherwise: Callable[[int], bool],
        /,
    ) -> Callable[[], bool]:
        """Make a function that sleeps for ``duration_ns``, for a loop that calls it each round.

        It returns True if there was no message newer than in ``seen``, no :meth:`wake` and no end
        of the board. What the second handle of a pair in ``own`` adds is no new message of the
        first. Otherwise it ends early and returns the result of ``otherwise``, which gets the time
        at which the sleep was to end (by CLOCK_MONOTONIC), and may :meth:`wait` to find out what
        has happened. It gets 0 if no sleep has begun: from the time ``until_ns`` on none does. A
        board that gains nothing by it always leaves the sleep to ``otherwise``.
        """

    def wake(self) -> None:
        """End the wait, or the next one if none is under way; from any thread."""


class _Bound(dict[Slot[Any], BoundSlot[Any]]):
    """The bound slots of a board; looking up a slot binds it.

    Only the first slot of a name and type is kept, so that a program may make a new one for each
    message. Finding the first one by itself costs one look-up, without a comparison of names.
    """

    def __init__(self, bind: Callable[[Slot[Any]], BoundSlot[Any]]) -> None:
        super().__init__()
        self._bind = bind
        self._alike: dict[tuple[str, type], BoundSlot[Any]] = {}
        self._present: dict[tuple[str, type], BoundSlot[Any]] = {}  # which make no slot

    def __missing__(self, slot: Slot[Any]) -> BoundSlot[Any]:
        alike = slot.name, slot.type
        bound = self._alike.get(alike)
        if bound is None:
            bound = self[slot] = self._alike[alike] = self._bind(slot)
        return bound

    def present(self, slot: Slot[Any], bind: Callable[[], BoundSlot[Any]]) -> BoundSlot[Any]:
        """Bind a slot of this name and type by `bind`, unless that was done before."""
        alike = slot.name, slot.type
        bound = self._present.get(alike)
        if bound is None:
            bound = self._present[alike] = bind()
        return bound

    def forget(self, slot: Slot[Any]) -> None:
        """Release what is bound to slots of this name and type."""
        self._present.pop((slot.name, slot.type), None)
        bound = self._alike.pop((slot.name, slot.type), None)
        for each in [each for each, of_it in self.items() if of_it is bound]:
            del self[each]


class Board(ClosedOnExit):
    """A whiteboard. Bind a slot with ``board[slot]``, or use the methods that take a slot.

    After :meth:`close`, adding, reading and listing raise :class:`.BoardClosedError`.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._bound = _Bound(self.publisher)

    def __getitem__(self, slot: Slot[M]) -> BoundSlot[M]:
        """Bind a slot; make it if the board does not have it.

        Raise :class:`.SlotTypeError` if it has another type on the board, and
        :class:`.BoardFullError` if there is no room to make it.
        """
        return self._bound[slot]

    def present(self, slot: Slot[M]) -> BoundSlot[M]:
        """Bind a slot of others, to look at it: it is not made anew when its name was given up.

        Raise :class:`.SlotNotFoundError` if it is not on the board, and :class:`.SlotTypeError` if
        it has another type there.
        """
        return self._bound.present(slot, lambda: self.publisher(slot, make=False))

    def add_message(self, slot: Slot[M], message: M) -> int:
        """Make ``message`` the slot's latest; see :meth:`BoundSlot.add`."""
        return self._bound[slot].add(message)

    def get_message(self, slot: Slot[M]) -> M | None:
        """Return the slot's latest message, or None before the first."""
        return self._bound[slot].get()

    def living(self) -> list[str]:
        """Return the names of the slots that were not given up."""
        return [info.name for info in self.slots()]

    def vacate(self, slot: Slot[Any]) -> None:
        """Give up the slot's name, if nobody needs it any more; its last message may be lost.

        In shared memory, another name of the same type may take its room, so a board does not fill
        up with names that come and go. Until then the slot stays as it is, and an add or a
        :meth:`BoundSlot.reserve` keeps it. Handles of any process notice when its room was taken:
        they read nothing, and an add makes the slot anew, from 1.
        """
        self.forget(slot)

    def forget(self, slot: Slot[Any]) -> None:
        """Release what this process has bound to the slot, other than handles kept elsewhere."""
        self._bound.forget(slot)

    def _repr_html_(self) -> str:
        """Show the users' slots with their latest messages, in a notebook."""
        from llfsm.whiteboard.message_text import html_table  # here, as few boards are in one

        rows = (self._row(info) for info in self.slots() if is_users(info.name))
        return html_table(("slot", "type", "messages", "latest"), rows)

    def _row(self, info: SlotInfo) -> tuple[object, ...]:
        from llfsm.whiteboard.message_text import message_json

        count, text = 0, ""
        try:
            bound = self.present(info.slot())
            count, sample = bound.count, bound.sample()
            if sample is not None:
                count, text = sample.count, message_json(sample.message)
        except BoardClosedError:
            raise
        except WhiteboardError as error:
            text = str(error)
        shown = text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
        return info.name, info.type_name, count, shown

    @abstractmethod
    def publisher(self, slot: Slot[M], *, make: bool = True) -> BoundSlot[M]:
        """Bind a slot as ``board[slot]`` does, but to a new handle, which can be retired.

        Unless `make`, raise :class:`.SlotNotFoundError` if the board does not have it.
        """

    @abstractmethod
    def slots(self) -> list[SlotInfo]:
        """Return the slots on the board, in the order in which they were made."""

    @abstractmethod
    def find(self, name: str) -> Slot[Any]:
        """Return the slot of that name, for tools that do not have its class.

        Raise :class:`.SlotNotFoundError`, and :class:`.MessageTypeError` if it is unusable.
        """

    @abstractmethod
    def watcher(self) -> Callable[[float], list[str]]:
        """Make a function `wait(seconds)` that waits until any slot has a new message.

        It returns the names of the slots with messages added since its last call; none when the
        time has passed, or :meth:`read_slots` has changed.
        """

    @property
    @abstractmethod
    def readings(self) -> int:
        """A number that grows when :meth:`read_slots` does."""

    @abstractmethod
    def read_slots(self) -> set[str]:
        """Return the names of the slots that are read: by a get, a sample or a wait of a handle.

        A handle of any process counts from its first read on, for as long as it exists. Reading
        by :meth:`BoundSlot.encoded` does not count. A daemon brings messages of other hosts here
        that are read here.
        """

    @abstractmethod
    def waiter(self) -> Waiter:
        """Make a :class:`Waiter`, by which one thread waits for several slots of this board.

        Messages in other slots do not wake it, and adding them costs nothing more.
        """

    @property
    @abstractmethod
    def alive(self) -> bool:
        """False once the board is closed here or removed by any process."""

    @abstractmethod
    def close(self) -> None:
        """Release the board; its messages stay for other processes. Closing twice is fine."""

    @abstractmethod
    def remove(self) -> None:
        """Remove the board for all processes; where it is open, ``alive`` becomes False."""
