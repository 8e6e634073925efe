"""A board in shared memory: one file that every process of this host maps."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect as mi

from .board import Board, BoundSlot, SlotInfo
from .errors import (
    BoardNotFoundError,
    SchemaClash,
    SharedMemoryUnavailableError,
    SlotNameError,
    SlotNotFoundError,
    from_errno,
)
from .local import LocalBoard
from .message import M, Message
from .schema import Schema
from .slots import Slot

try:
    from . import _shm
except ImportError as error:  # no compiler at the installation, or no Linux
    _MISSING: ImportError | None = error
else:
    _MISSING = None
    BoundSlot.register(_shm.Port)

__all__ = ["BoardInfo", "Whiteboard", "boards", "default_name", "journal_path", "remove_board"]

_DIRECTORY = Path("/dev/shm")
_PREFIX = "llfsm."
_MOST_SLOTS = 4096
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,199}")

Field = tuple[str, int, int, int, Any, tuple["Field", ...]]


class Whiteboard(Board):
    """A whiteboard that every process of this user on this host shares by its name.

    Args:
        name: letters, digits, ``_ . -``; by default ``$WHITEBOARD_NAME``, else ``whiteboard``.
        directory: where its file is; by default the shared memory of the host, ``/dev/shm``.
        create: make the board if it is not there; else raise :class:`.BoardNotFoundError`.

    One object may be used by all threads of a process; a forked child may go on using it.
    Messages live as long as the board's file, until :meth:`remove`; closing only lets go.

    """

    def __init__(
        self,
        name: str | None = None,
        *,
        directory: str | os.PathLike[str] = _DIRECTORY,
        create: bool = True,
    ) -> None:
        super().__init__(default_name() if name is None else name)
        self.path = _path(self.name, directory)
        if _MISSING:
            raise SharedMemoryUnavailableError(
                "this installation of llfsm has no shared memory (Linux and a C compiler when it "
                "is installed are needed); use Whiteboard.local()"
            ) from _MISSING
        self._core = _shm.Board(str(self.path), create)

    @staticmethod
    def local(name: str = "local") -> LocalBoard:
        """Return a new, empty board for this process only, with the same interface."""
        return LocalBoard(name)

    @staticmethod
    def connect(endpoint: str, name: str | None = None, *, zenoh: str | None = None) -> Board:
        """Return a board of other hosts, for a process without shared memory or a daemon.

        Args:
            endpoint: where a daemon listens, in Zenoh's words: ``tcp/robot:7447``.
            name: of the board; by default as that of one in shared memory.
            zenoh: a file of Zenoh's configuration, for TLS.

        Raise :class:`.NetworkError` if no daemon of such a board answers within five seconds.

        """
        from .mirror.client import RemoteBoard

        return RemoteBoard(endpoint, default_name() if name is None else name, zenoh)

    def _bind(self, slot: Slot[M]) -> BoundSlot[M]:
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
            )
        except SchemaClash as clash:
            raise slot.clash(_schema(clash.schema)[0]) from None

    def slots(self) -> list[SlotInfo]:
        """Describe the slots on the board, in the order in which they were made."""
        return [_info(*told) for told in self._core.slots()]

    def find(self, name: str) -> Slot[Message]:
        """Return a slot that is on the board, with a class made from its schema.

        For tools that do not have the slot's own class. Raise :class:`.SlotNotFoundError`, or
        :class:`.MessageTypeError` if its schema is none.
        """
        for info in self.slots():
            if info.name == name:
                return info.slot()
        there = ", ".join(info.name for info in self.slots()) or "none"
        raise SlotNotFoundError(f"board {self.name!r} has no slot {name!r}; its slots: {there}")

    def watcher(self) -> Callable[[float], list[str]]:
        """Return a function that waits until any slot has news."""
        words = bytearray(8 * _MOST_SLOTS)
        names: list[str] = []

        def wait(timeout: float) -> list[str]:
            changed = self._core.watch(words, timeout)
            if changed and changed[-1] >= len(names):
                names[:] = [name for name, *_ in self._core.slots()]
            return list(map(names.__getitem__, changed))

        return wait

    @property
    def alive(self) -> bool:
        """False once the board is closed here or removed by anybody."""
        return self._core.linked()

    def close(self) -> None:
        """Let go of the board; its messages stay for other processes. Closing twice is fine."""
        self._core.close()

    def remove(self) -> None:
        """Remove the board for everybody and close it here; nothing if it is closed."""
        if self.alive:
            remove_board(self.name, self.path.parent)
        self.close()


def _info(
    name: str, type_name: str, text: bytes | None, _fingerprint: int, capacity: int
) -> SlotInfo:
    """Describe a slot; one whose record makes no sense is no reason to refuse the others."""
    damaged: Schema = {}
    schema, problem = damaged, "what the board's file says of it is damaged"
    if text is not None:
        schema, problem = _schema(text)
    if not name.isprintable():  # as bytes that are no UTF-8
        name = name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
        problem = "its name is no text"
    return SlotInfo(name, type_name, schema, capacity, problem)


@lru_cache(maxsize=1024)  # slots are listed again and again, and many have the same type
def _schema(text: bytes) -> tuple[Schema, str]:
    """Return a schema, or an empty one and why it is none."""
    try:
        return msgspec.json.decode(text, type=Schema), ""
    except (msgspec.DecodeError, RecursionError) as error:
        return {}, f"its schema is no JSON object: {error}"


class BoardInfo(NamedTuple):
    """A board as the tools list it."""

    name: str
    used: bool
    """Some process has it open; False for one that a crash left behind."""


def boards(directory: str | os.PathLike[str] = _DIRECTORY) -> list[BoardInfo]:
    """List this user's boards, damaged ones included (as not used)."""
    found = []
    for path in sorted(Path(directory).glob(f"{_PREFIX}*")):
        with suppress(FileNotFoundError):  # removed since it was listed
            if path.lstat().st_uid == os.geteuid() and not path.is_symlink():
                found.append(BoardInfo(path.name.removeprefix(_PREFIX), _is_used(path)))
    return found


def _is_used(path: Path) -> bool:
    try:
        core = _shm.Board(str(path), create=False)
    except Exception:  # damaged, of another version, or gone since it was listed
        return False
    try:
        return core.shared()
    finally:
        core.close()


def remove_board(name: str, directory: str | os.PathLike[str] = _DIRECTORY) -> None:
    """Remove a board's file, damaged or not, used or not."""
    path = _path(name, directory)
    try:
        path.unlink()
        journal_path(path).unlink(missing_ok=True)
    except FileNotFoundError:
        raise BoardNotFoundError(
            f"{path}: no such whiteboard; see `llfsm whiteboard list`"
        ) from None
    except OSError as error:
        raise from_errno(error.errno or 0, str(path)) from error


def journal_path(board: Path) -> Path:
    """Return where a daemon keeps what it knows of a board: by a name that is no board's."""
    return board.with_name("llfsm-mirror." + board.name.removeprefix(_PREFIX))


def default_name() -> str:
    """Return ``$WHITEBOARD_NAME``, or ``whiteboard``."""
    return os.environ.get("WHITEBOARD_NAME") or "whiteboard"


def _path(name: str, directory: str | os.PathLike[str]) -> Path:
    if not _NAME.fullmatch(name):
        raise SlotNameError(
            f"{name!r} cannot name a whiteboard: 1 to 200 letters, digits, '_', '.' and '-', "
            f"not beginning with '.' or '-'"
        )
    return Path(directory, _PREFIX + name)


# The kinds of _fields.h, in its order.
_FLOAT, _INT, _BOOL, _STR, _BYTES, _MESSAGE, _OTHER = range(7)
_SMALLEST, _LARGEST = -(2**63), 2**63 - 1


def _fields(node: mi.Type) -> tuple[Field, ...]:
    """Tell the extension how to recognise a plainly right message (see ``_fields.h``)."""
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
    return name, kind, least, most, None, ()
