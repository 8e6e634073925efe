"""A board in shared memory: one file that every process of this host maps.

The protocol is in C, ``include/llfsm_whiteboard.h``, for programs without Python, too; it needs
memory orders and system calls that Python lacks. The extension ``_shm`` puts a handle of Python on
it. In an add or a get it runs all of the common path without a call of Python: it compares the
message's fields with the kinds that `_fields` has listed once for the slot, has msgspec encode the
message into a buffer of the slot, and returns the object of the last get while the count is the
same. All that is rare, as errors and the schemas of other processes, is left to Python: a status
becomes an exception in :func:`.errors.raise_status`, and a slot's schema is compared there.

What another process has written is never trusted: a record of the file may be damaged, a schema may
be any text. Listing slots therefore describes an unusable one by its `problem`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
from msgspec import inspect as mi

from llfsm.whiteboard.board import Board, BoundSlot, SlotInfo, Waiter
from llfsm.whiteboard.board_files import (
    DIRECTORY,
    board_files,
    board_path,
    default_name,
    group_id,
    remove_board,
)
from llfsm.whiteboard.errors import SchemaClash, SharedMemoryUnavailableError, SlotNotFoundError
from llfsm.whiteboard.message import M, Message
from llfsm.whiteboard.schema import Schema, excess
from llfsm.whiteboard.slots import Slot

try:
    import llfsm.whiteboard._shm as _shm
except ImportError as error:  # no Linux, or no compiler when it was installed
    _MISSING: ImportError | None = error
else:
    _MISSING = None
    BoundSlot.register(_shm.Port)

if TYPE_CHECKING:
    from llfsm.whiteboard.local import LocalBoard


_MOST_SLOTS = 4096  # LWB_MAX_SLOTS

Field = tuple[str, int, int, int, Any, tuple["Field", ...]]
"""Name, kind, least and largest value or length, class of a message, fields within."""


class Whiteboard(Board):
    """A whiteboard that every process of this user on this host shares by its name.

    Args:
        name: letters, digits, ``_ . -``; by default ``$WHITEBOARD_NAME``, else ``whiteboard``.
        directory: the folder of its file; by default the host's shared memory, ``/dev/shm``.
        create: make the board if it does not exist; else raise :class:`.BoardNotFoundError`.
        group: a group of users, by its name or id: who is in it may use the board, as other
            users and containers do. By default ``$WHITEBOARD_GROUP``, else it is for this user
            alone. A board that is not of the group, with mode 0660, is refused.

    All threads of a process may use one object; a forked child may continue to use it. Messages
    live as long as the board's file, until :meth:`remove` or a reboot; closing only releases it.

    Raises:
        SharedMemoryUnavailableError: this installation has no shared memory.
        SlotNameError: the name is invalid.
        BoardError: the file cannot be used; which error of the tree says why.

    """

    def __init__(
        self,
        name: str | None = None,
        *,
        directory: str | os.PathLike[str] = DIRECTORY,
        create: bool = True,
        group: str | int | None = None,
    ) -> None:
        super().__init__(default_name() if name is None else name)
        self.path = board_path(self.name, directory)
        require_shared_memory()
        self._group = group_id(group)
        self._core = _shm.Board(str(self.path), create, self._group)

    def __reduce__(self) -> tuple[Any, ...]:
        """Open the same board where this one is unpickled, as in a process of `multiprocessing`."""
        how: dict[str, Any] = {"directory": str(self.path.parent), "create": False}
        how["group"] = "" if self._group < 0 else self._group
        return partial(Whiteboard, **how), (self.name,)

    @staticmethod
    def local(name: str = "local") -> LocalBoard:
        """Make a new, empty board for this process only, with the same interface."""
        from llfsm.whiteboard.local import LocalBoard

        return LocalBoard(name)

    @staticmethod
    def connect(
        endpoint: str,
        name: str | None = None,
        *,
        zenoh: str | None = None,
        as_: str = "",
        fleet: Sequence[str] = (),
    ) -> Board:
        """Open a board of other hosts, for a process without shared memory or a daemon.

        Args:
            endpoint: the Zenoh endpoint on which a daemon listens: ``tcp/robot:7447``.
            name: the board's name; by default that of a board in shared memory.
            zenoh: a Zenoh configuration file, for TLS.
            as_: this process's name among the hosts: they have its own slots in a folder of that
                name. By default, all hosts have all slots under the same names.
            fleet: globs of the other hosts' names, for a process with a name.

        Raise :class:`.NetworkError` if no daemon of that board answers within five seconds, or
        `as_` is no name of a host.

        """
        from llfsm.whiteboard.mirror.remote_board import RemoteBoard

        return RemoteBoard(endpoint, default_name() if name is None else name, zenoh, as_, fleet)

    def publisher(self, slot: Slot[M], *, make: bool = True) -> BoundSlot[M]:
        """Bind a slot to a new handle; see :meth:`.Board.publisher`."""
        try:
            return _shm.Port(
                self._core,
                slot.name,
                slot.type_name,
                msgspec.json.encode(slot.schema).decode(),
                slot.fingerprint,
                slot.capacity,
                slot.type,
                _fields(mi.type_info(slot.type)),
                slot.encoder.encode_into,
                slot.decoder.decode,
                make,
            )
        except LookupError:
            raise SlotNotFoundError(self.name, slot.name, self.living()) from None
        except SchemaClash as clash:
            raise slot.clash(_schema(clash.schema)[0]) from None

    def slots(self) -> list[SlotInfo]:
        """Return the slots on the board, in the order in which they were made."""
        return [_info(*record) for record in self._core.slots()]

    def find(self, name: str) -> Slot[Message]:
        """Return a slot, with a class made from its schema; see :meth:`.Board.find`."""
        record = self._core.find(name)
        if record is not None:
            return _info(*record).slot()
        slots = {info.name: info for info in self.slots()}
        if name in slots:  # as it is listed: its name is damaged
            return slots[name].slot()
        raise SlotNotFoundError(self.name, name, slots)

    def watcher(self) -> Callable[[float], list[str]]:
        """Make a function that waits for a new message in any slot; see :meth:`.Board.watcher`."""
        words, readings = bytearray(8 * _MOST_SLOTS), self._core.readings()

        def wait(timeout: float) -> list[str]:
            nonlocal readings
            changed = self._core.watch(words, timeout, readings)
            readings = self._core.readings()
            return changed

        return wait

    @property
    def readings(self) -> int:
        """A number that grows when :meth:`read_slots` does."""
        return self._core.readings()

    def read_slots(self) -> set[str]:
        """Return the names of the slots that any process reads."""
        return set(self._core.read())

    def living(self) -> list[str]:
        """Return the names of the slots that were not given up; see :meth:`.Board.living`."""
        return self._core.living()

    def vacate(self, slot: Slot[Any]) -> None:
        """Give up the slot's name; see :meth:`.Board.vacate`."""
        super().vacate(slot)
        self._core.vacate(slot.name)

    def waiter(self) -> Waiter:
        """Make a waiter for new messages in any of several slots; see :meth:`.Board.waiter`."""
        return _SharedWaiter(self._core)

    @property
    def alive(self) -> bool:
        """False once the board is closed here or removed by any process."""
        return self._core.linked()

    def close(self) -> None:
        """Release the board; its messages stay for other processes. Closing twice is fine."""
        self._core.close()

    def remove(self) -> None:
        """Remove the board for all processes and close it here; do nothing if it is closed."""
        if self.alive:
            remove_board(self.name, self.path.parent)
        self.close()


class _SharedWaiter:
    """A :class:`.Waiter`; a wake from another thread is one byte, which the C code looks at."""

    def __init__(self, core: _shm.Board) -> None:
        self._core = core
        self._woken = bytearray(1)
        self.wait = partial(_shm.wait_any, core, self._woken)

    def doze(self, *what: Any) -> Callable[[], bool]:
        return _shm.Doze(self._core, self._woken, *what).sleep

    def wake(self) -> None:
        self._woken[0] = 1
        self._core.raise_alarm()


def _info(
    name: str, type_name: str, text: bytes | None, _fingerprint: int, capacity: int
) -> SlotInfo:
    """Describe a slot from its record; one without `text` is damaged."""
    schema: Schema = {}
    problem = "its record in the board's file is damaged"
    if text is not None:
        schema, problem = _schema(text)
    if not name.isprintable():  # for example bytes that are not UTF-8
        name = name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
        problem = "its name is not valid text"
    return SlotInfo(name, type_name, schema, capacity, problem)


@lru_cache(maxsize=1024)  # slots are listed again and again, and many have the same type
def _schema(text: bytes) -> tuple[Schema, str]:
    """Decode a schema; return it and "", or an empty one and the reason why it is invalid."""
    try:
        schema = msgspec.json.decode(text, type=Schema)
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        return {}, f"its schema is not a JSON object: {error}"
    too_much = excess(schema)
    return ({} if too_much else schema), too_much


def require_shared_memory() -> None:
    """Raise :class:`.SharedMemoryUnavailableError` if this installation has no such boards."""
    if _MISSING:
        raise SharedMemoryUnavailableError(
            "this installation of llfsm has no shared memory (it needs Linux, and a C compiler "
            "at installation); use Whiteboard.local(), or --local with `llfsm run` and `llfsm demo`"
        ) from _MISSING


class BoardInfo(NamedTuple):
    """A board as tools list it."""

    name: str
    used: bool
    """True while a process has it open; False for one that a crash has left."""


def boards(directory: str | os.PathLike[str] = DIRECTORY) -> list[BoardInfo]:
    """List the boards of this user, or of ``$WHITEBOARD_GROUP``, by name.

    Damaged ones are listed as not used.
    """
    require_shared_memory()
    found, group = [], group_id()
    for name, path in board_files(directory):
        with suppress(FileNotFoundError):  # removed since it was listed
            status = path.lstat()
            own = (status.st_gid, status.st_mode & 0o777) == (group, 0o660)
            if group < 0:
                own = status.st_uid == os.geteuid()
            if own and not path.is_symlink():
                found.append(BoardInfo(name, _is_used(path, group)))
    return found


def _is_used(path: Path, group: int) -> bool:
    try:
        core = _shm.Board(str(path), create=False, group=group)
    except Exception:  # damaged, of another version, or gone since it was listed
        return False
    try:
        return core.shared()
    finally:
        core.close()


# The kinds of _fields.h, in its order.
_FLOAT, _INT, _BOOL, _STR, _BYTES, _MESSAGE, _TUPLE, _OTHER = range(8)
_SMALLEST, _LARGEST = -(2**63), 2**63 - 1


def _fields(node: mi.Type) -> tuple[Field, ...]:
    """List a message's fields for the extension, which by them recognises an obviously valid one.

    A field of kind `_OTHER` is decoded to be checked. ``_fields.h`` is the other side of this.
    """
    assert isinstance(node, mi.StructType)
    return tuple(_field(f.name, f.type) for f in node.fields)


def _field(name: str, node: mi.Type) -> Field:
    kind, least, most = _OTHER, 0, 0
    match node:
        case mi.FloatType(gt=None, ge=None, lt=None, le=None, multiple_of=None):
            kind = _FLOAT
        case mi.IntType(gt=None, lt=None, multiple_of=None):
            kind = _INT
            least = _SMALLEST if node.ge is None else max(node.ge, _SMALLEST)
            most = _LARGEST if node.le is None else min(node.le, _LARGEST)
        case mi.BoolType():
            kind = _BOOL
        case mi.StrType(min_length=None, max_length=None, pattern=None):
            kind = _STR
        case mi.BytesType(min_length=None, max_length=None):
            kind = _BYTES
        case mi.StructType():
            return name, _MESSAGE, 0, 0, node.cls, _fields(node)
        case mi.VarTupleType():
            most = _LARGEST if node.max_length is None else node.max_length
            return name, _TUPLE, node.min_length or 0, most, None, (_field("", node.item_type),)
    return name, kind, least, most, None, ()
