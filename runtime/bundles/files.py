"""The files of a bundle, which may come from anybody."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from ..engine.errors import BundleError

__all__ = ["read_file"]


def read_file(file: Path) -> bytes | None:
    """Return what is in the file; None if it does not exist.

    Raise `BundleError` if it cannot be read, or is a pipe or device, which may never end.
    """
    try:
        with open(file, "rb", opener=_open) as opened:
            if not stat.S_ISREG(os.fstat(opened.fileno()).st_mode):
                raise BundleError("not a regular file", file)
            return opened.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise BundleError(error.strerror or str(error), file) from error


def _open(path: str, flags: int) -> int:
    # Without this, a pipe would be opened when somebody writes to it. Windows has neither.
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
