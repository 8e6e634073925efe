"""The files of boards: where they are, and which names they have."""

from __future__ import annotations

import os
import re
from pathlib import Path

from llfsm.whiteboard.errors import BoardNotFoundError, SlotNameError, from_errno

DIRECTORY = Path("/dev/shm")
_PREFIX = "llfsm."
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,199}")


def default_name() -> str:
    """Return ``$WHITEBOARD_NAME``, or ``whiteboard``."""
    return os.environ.get("WHITEBOARD_NAME") or "whiteboard"


def board_path(name: str, directory: str | os.PathLike[str] = DIRECTORY) -> Path:
    """Return the path of a board's file; raise :class:`.SlotNameError` for an invalid name."""
    if not _NAME.fullmatch(name):
        raise SlotNameError(
            f"{name!r} is not a valid whiteboard name: use 1 to 200 letters, digits, '_', '.' "
            f"and '-', not beginning with '.' or '-'"
        )
    return Path(directory, _PREFIX + name)


def board_files(directory: str | os.PathLike[str] = DIRECTORY) -> list[tuple[str, Path]]:
    """Return the name and path of each file that may be a board, sorted."""
    paths = sorted(Path(directory).glob(f"{_PREFIX}*"))
    return [(path.name.removeprefix(_PREFIX), path) for path in paths]


def version_log_path(board: Path) -> Path:
    """Return where a daemon keeps the versions of a board's messages; never a board's path."""
    return board.with_name("llfsm-mirror." + board.name.removeprefix(_PREFIX))


def remove_board(name: str, directory: str | os.PathLike[str] = DIRECTORY) -> None:
    """Remove a board's file, damaged or not, in use or not."""
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
