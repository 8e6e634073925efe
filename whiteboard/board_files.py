"""The files of boards: their folder, their names, and the log of a daemon beside each."""

from __future__ import annotations

import os
import re
from pathlib import Path
from stat import S_ISREG

from llfsm.whiteboard.errors import (
    BoardNotFoundError,
    BoardPermissionError,
    SlotNameError,
    from_errno,
)

DIRECTORY = Path("/dev/shm")
"""The folder of boards unless another is given: the host's shared memory, gone at a reboot."""

_PREFIX = "llfsm."
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,199}")


def default_name() -> str:
    """Return the name of a board if none is given: ``$WHITEBOARD_NAME``, or ``whiteboard``."""
    return os.environ.get("WHITEBOARD_NAME") or "whiteboard"


def group_id(group: str | int | None = None) -> int:
    """Return the id of a group: by default ``$WHITEBOARD_GROUP``; -1 for none.

    Raise :class:`.BoardPermissionError` if there is none of that name, or this user is not in it.
    """
    if group is None:
        group = os.environ.get("WHITEBOARD_GROUP", "")
    if group == "":
        return -1
    found = int(group) if str(group).isdecimal() else _group_called(str(group))
    if found not in (os.getegid(), *os.getgroups()) and os.geteuid():
        raise BoardPermissionError(
            f"this user is not in the group {group}; root can add it: usermod -aG {group} USER"
        )
    return found


def _group_called(name: str) -> int:
    import grp  # here, as Windows lacks it

    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        raise BoardPermissionError(f"no group of this host is called {name!r}") from None


def board_path(name: str, directory: str | os.PathLike[str] = DIRECTORY) -> Path:
    """Return the path of a board's file; raise :class:`.SlotNameError` for an invalid name."""
    if not _NAME.fullmatch(name):
        raise SlotNameError(
            f"{name!r} is not a valid whiteboard name: use 1 to 200 letters, digits, '_', '.' "
            f"and '-', not beginning with '.' or '-'"
        )
    return Path(directory, _PREFIX + name)


def board_files(directory: str | os.PathLike[str] = DIRECTORY) -> list[tuple[str, Path]]:
    """List the name and path of each file that may be a board, sorted by name."""
    paths = sorted(Path(directory).glob(f"{_PREFIX}*"))
    return [(path.name.removeprefix(_PREFIX), path) for path in paths]


def version_log_path(board: Path) -> Path:
    """Return the path of the file in which a daemon keeps the versions of a board's messages.

    It is beside the board's file, and has a name that no board's file has.
    """
    return board.with_name("llfsm-mirror." + board.name.removeprefix(_PREFIX))


def open_own(path: Path, flags: int = 0) -> int:
    """Open a file of this user, to read and write it; return its descriptor.

    With ``O_CREAT`` it is made for this user alone.
    For files whose owner could put messages on a board. Raise ``OSError``, also for a link, and
    :class:`.BoardPermissionError` if it belongs to another user, or is another kind of file.
    """
    file = os.open(path, os.O_RDWR | os.O_NOFOLLOW | flags, 0o600)
    status = os.fstat(file)
    if status.st_uid != os.geteuid() or not S_ISREG(status.st_mode):
        os.close(file)
        raise BoardPermissionError(
            f"{path}: belongs to another user, or is not a regular file; remove it, or choose "
            f"another name"
        )
    return file


def lock(file: int) -> bool:
    """Lock an open file until it is closed; return False if another process has locked it."""
    import fcntl  # here, as Windows lacks it, where boards of other hosts can be read

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def sync_folder(folder: Path) -> None:
    """Bring the names of a folder's files to the disk, as after one has taken another's place."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_board(name: str, directory: str | os.PathLike[str] = DIRECTORY) -> None:
    """Remove a board's file, damaged or not, in use or not, and the version log beside it.

    Raise :class:`.SlotNameError` for an invalid name, :class:`.BoardNotFoundError` if there is no
    such file, and another :class:`.BoardError` if the system refuses it.
    """
    path = board_path(name, directory)
    try:
        path.unlink()
        version_log_path(path).unlink(missing_ok=True)
    except FileNotFoundError:
        raise BoardNotFoundError(
            f"{path}: no such whiteboard; see `llfsm whiteboard list`"
        ) from None
    except OSError as error:
        raise from_errno(error.errno or 0, str(path)) from error
